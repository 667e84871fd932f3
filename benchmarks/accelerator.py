"""The engine `jax` beside the compiled one: the time of a particle-step, and the expected MSE.

Both filter the paper's problem, in one process that has one core: draws with regular times, and few
draws with many random sets, as a search does. An instant that sets share counts once. JAX takes a
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
from pfdist.common.measurement_times import Times, random, regular
from pfdist.filters.evaluator import recorded_evaluator
from pfdist.filters.work import Estimation
from pfdist.pages.style import BLUE, COLUMN_INCHES, RED

TITLE = "The engine jax"
TABLES: tuple[str, ...] = ("accelerator",)

HORIZON, BUDGET, REPEATS = 60, 21, 3
ENGINES = {"compiled": BLUE, "jax": RED}
SIZES = ((1, 1000, 500), (1, 20_000, 500), (30, 100, 200))  # sets, draws and particles
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
        accelerator: a row for each engine, resampling and size, with device, sets, draws,
        particles, ns (of the processor), ns_wall, seconds_first (with compiling), expected_mse of
        all sets and its standard_error.
    """
    rows, model = [], load_model("ungm")
    sizes, repeats = (((1, 40, 100), (3, 20, 100)), 1) if quick else (SIZES, REPEATS)
    with one_core():
        device = {"compiled": "cpu", "jax": import_module("jax").default_backend()}
        for (sets, draws, particles), scheme in product(sizes, SCHEMES):
            calls, estimation = {}, Estimation(particles, scheme)
            times: list[Times] = [regular(HORIZON, BUDGET)]
            if sets > 1:
                some = random(HORIZON, BUDGET, sets, np.random.default_rng(1))
                times = [tuple(each) for each in some.tolist()]
            for engine in ENGINES:
                evaluator = recorded_evaluator(model, model, horizon=HORIZON, engine=engine)
                work = evaluator.work(times, 3, 4, (0, draws), estimation)
                calls[engine] = partial(evaluator, work)
            timings = take_turns(calls, repeats, say)
            for engine, timing in timings.items():
                mse = calls[engine]().mse.mean(axis=1)
                own: dict[str, Any] = {"engine": engine, "device": device[engine]}
                own |= {"resampling": scheme, "sets": sets, "draws": draws, "particles": particles}
                taken = timing.nanoseconds(work.steps)
                own |= {name: taken[name] for name in ("ns", "ns_wall")}
                own |= {"seconds_first": timing.first, "expected_mse": mse.mean()}
                rows.append(own | {"standard_error": mse.std(ddof=1) / np.sqrt(draws)})
                say(f"{engine}, {scheme}, {sets} x {draws:,} draws: {taken['ns']:.3g} ns")
    return {"accelerator": pd.DataFrame(rows)}


def summary(tables: Tables) -> str:
    """Give the table in Markdown."""
    head = ["engine", "device", "resampling", "sets", "draws", "particles", "ns a particle-step",
            "first call, s", "expected MSE"]  # fmt: skip
    rows = [
        [
            str(row.engine), str(row.device), str(row.resampling), f"{row.sets}", f"{row.draws:,}",
            f"{row.particles}", f"{row.ns_wall:.3g}", f"{row.seconds_first:.1f}",
            f"{row.expected_mse:.2f} ± {row.standard_error:.2f}",
        ]
        for row in tables["accelerator"].itertuples()
    ]  # fmt: skip
    said = "The paper's problem: one set is the regular one, many are random."
    return f"{said}\n\n{markdown(head, rows)}"


def plot(tables: Tables) -> Figure:
    """Draw the time of a particle-step against the number of draws."""
    figure = Figure(figsize=(COLUMN_INCHES, 0.8 * COLUMN_INCHES), layout="constrained")
    axes = figure.subplots()
    rows = tables["accelerator"].query("sets == 1")
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
