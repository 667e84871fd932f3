"""The engine `jax` beside the compiled one: the time of a particle-step, and the expected MSE.

Both filter the paper's problem with regular times, in one process that has one core. JAX takes a
GPU if it finds one, unless the benchmark `peers` runs before it and chooses the processor. The
engines have noise of their own, so errors agree within standard errors.
"""

from functools import partial
from importlib import import_module
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from benchmarks.measure import Say, one_core, take_turns
from benchmarks.results import Tables, markdown
from pfdist import load_model
from pfdist.filters.evaluator import recorded_evaluator
from pfdist.filters.work import Estimation
from pfdist.pages.style import BLUE, COLUMN_INCHES, RED

TITLE = "The engine jax"
TABLES: tuple[str, ...] = ("accelerator",)

HORIZON, TIMES, REPEATS = 60, tuple(range(0, 61, 3)), 3
ENGINES = {"compiled": BLUE, "jax": RED}
SIZES = ((1000, 500), (20_000, 500))  # draws and particles
SCHEMES = ("systematic", "multinomial")


def measure(quick: bool, say: Say) -> Tables:
    """Filter in turns with both engines.

    Parameters
    ----------
    quick : bool
        Few draws, one repeat.
    say : callable
        Receives a line about the progress.

    Returns
    -------
    dict of DataFrames
        accelerator: a row for each engine, resampling and size, with device, draws, particles, ns
        (of the processor), ns_wall, seconds_first (with compiling), expected_mse and its
        standard_error.
    """
    rows, model = [], load_model("ungm")
    sizes, repeats = (((40, 100),), 1) if quick else (SIZES, REPEATS)
    with one_core():
        device = {"compiled": "cpu", "jax": import_module("jax").default_backend()}
        for (draws, particles), scheme in product(sizes, SCHEMES):
            calls, estimation = {}, Estimation(particles, scheme)
            for engine in ENGINES:
                evaluator = recorded_evaluator(model, model, horizon=HORIZON, engine=engine)
                work = evaluator.work([TIMES], 3, 4, (0, draws), estimation)
                calls[engine] = partial(evaluator, work)
            timings = take_turns(calls, repeats, say)
            for engine, timing in timings.items():
                mse = calls[engine]().mse[:, 0]
                own: dict[str, Any] = {"engine": engine, "device": device[engine]}
                own |= {"resampling": scheme, "draws": draws, "particles": particles}
                times = timing.nanoseconds(draws * (HORIZON + 1) * particles)
                own |= {name: times[name] for name in ("ns", "ns_wall")}
                own |= {"seconds_first": timing.first, "expected_mse": mse.mean()}
                rows.append(own | {"standard_error": mse.std(ddof=1) / np.sqrt(draws)})
                say(f"{engine}, {scheme}, {draws:,} draws: {times['ns']:.3g} ns")
    return {"accelerator": pd.DataFrame(rows)}


def summary(tables: Tables) -> str:
    """Give the table in Markdown."""
    head = ["engine", "device", "resampling", "draws", "ns a particle-step", "first call, s",
            "expected MSE"]  # fmt: skip
    rows = [
        [
            str(row.engine), str(row.device), str(row.resampling), f"{row.draws:,}",
            f"{row.ns_wall:.3g}", f"{row.seconds_first:.1f}",
            f"{row.expected_mse:.2f} ± {row.standard_error:.2f}",
        ]
        for row in tables["accelerator"].itertuples()
    ]  # fmt: skip
    return f"The paper's problem with regular times, 500 particles.\n\n{markdown(head, rows)}"


def plot(tables: Tables) -> Figure:
    """Draw the time of a particle-step against the number of draws."""
    figure = Figure(figsize=(COLUMN_INCHES, 0.8 * COLUMN_INCHES), layout="constrained")
    axes = figure.subplots()
    rows = tables["accelerator"]
    for (engine, scheme), own in rows.groupby(["engine", "resampling"], sort=False):
        line = "-" if scheme == SCHEMES[0] else "--"
        label, color = f"{engine}, {scheme}", ENGINES[str(engine)]
        axes.plot(own["draws"], own["ns_wall"], line, color=color, marker="o", label=label)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("draws")
    axes.set_ylabel("wall time of a particle-step [ns]")
    axes.legend()
    return figure
