"""The compiled kernel, a C program with the same arithmetic, and a bare loop, in turns on one core.

The C program (`beside_c.c`) is written for UNGM alone. It must give the MSE of the kernel for each
draw; only sines and cosines, which NumPy computes for it, may differ in the last digit. It is also
compiled so that GCC may reorder sums and fuse operations as it likes: the kernel may not, because
its bytes would then depend on the processor. The bare loop has the same noise and the same memory
traffic, and filters nothing.
"""

import ctypes
import math
import subprocess
import tempfile
from collections.abc import Callable
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from benchmarks.measure import Say, one_core, take_turns
from benchmarks.peers import STANDARD_ERRORS, PeerDisagreesError
from benchmarks.results import Tables, markdown
from pfdist import load_model
from pfdist.filters.draws import Draws
from pfdist.filters.particle_filter import filter_draws
from pfdist.filters.simulation import simulate
from pfdist.plots.style import BLUE, COLUMN_INCHES, GREY, RED
from pfdist.times.measurement_times import Times, regular

TITLE = "The kernel beside C"
TABLES: tuple[str, ...] = ("beside_c",)

SOURCE = Path(__file__).with_suffix(".c")
# Without traps and errno, GCC turns conditions and square roots into vectors; no value changes.
COMPILER = "gcc -O3 -march=native -fno-trapping-math -fno-math-errno -shared -fPIC"
ROUNDED = "-ffp-contract=off"
# -ffast-math less what would flush small numbers to 0, in the whole process
FREE = "-ffp-contract=fast -fassociative-math -freciprocal-math -fno-signed-zeros"
HORIZON, PARTICLES, DRAWS, STREAM = 30, 500, 1000, 2
BUDGETS = (11, HORIZON + 1)
SCHEMES = ("multinomial", "systematic")
REPEATS = 15
OURS, IN_C, FREELY, BARE = WHO = ("pfdist", "C", "C, rounded freely", "bare loop")


def measure(quick: bool, say: Say) -> Tables:
    """Give the times of all programs, measured in turns.

    Parameters
    ----------
    quick : bool
        A tenth of the draws, two repeats.
    say : callable
        Receives a line about the progress.

    Returns
    -------
    dict of DataFrames
        beside_c: a row for each resampling scheme, measurement budget and program, with ns,
        ns_median, ns_max and ns_wall of a particle-step; ratio of the least time to that of the C
        program, with ratio_low and ratio_high of single rounds; repeats.

    Raises
    ------
    PeerDisagreesError
        The C program computes another MSE than the kernel for a draw; rounded freely, its mean
        lies more than four standard errors from that of the kernel.
    """
    draws = simulate(load_model("ungm"), HORIZON, range(DRAWS // 10 if quick else DRAWS), 1)
    repeats = 2 if quick else REPEATS
    cases = list(product(SCHEMES, BUDGETS))
    with tempfile.TemporaryDirectory() as folder, one_core():
        rounded, free = (_library(Path(folder), options) for options in (ROUNDED, FREE))
        in_c = (rounded.filter_draws, free.filter_draws, rounded.bare_loop)
        functions: dict[tuple[str, int, str], Callable[[], Any]] = {}
        for scheme, budget in cases:
            times = regular(HORIZON, budget)
            of_case = [partial(_filter, draws, scheme, times)]
            of_case += [partial(_called, function, draws, scheme, times) for function in in_c]
            functions |= {
                (scheme, budget, who): each for who, each in zip(WHO, of_case, strict=True)
            }
            _check(scheme, budget, *(each() for each in of_case[:3]))
        timings = take_turns(functions, repeats, say)
    steps = len(draws.index) * (HORIZON + 1) * PARTICLES
    rows = []
    for (scheme, budget, who), timing in timings.items():
        reference = timings[scheme, budget, IN_C].processor
        rounds = np.array(timing.processor) / reference
        rows.append(
            {"resampling": scheme, "measurement_budget": budget, "who": who}
            | timing.nanoseconds(steps)
            | {
                "ratio": min(timing.processor) / min(reference),
                "ratio_low": rounds.min(),
                "ratio_high": rounds.max(),
                "repeats": repeats,
            }
        )
    return {"beside_c": pd.DataFrame(rows)}


def _library(folder: Path, options: str) -> ctypes.CDLL:
    """Compile the C program with these options."""
    library = folder / f"{len(list(folder.iterdir()))}.so"
    command = [*COMPILER.split(), *options.split(), "-o", str(library), str(SOURCE)]
    subprocess.run(command, check=True)  # noqa: S603  our own text
    return ctypes.CDLL(str(library))


def _filter(draws: Draws, scheme: str, times: Times) -> Any:
    return filter_draws(draws.model, draws, times, PARTICLES, STREAM, scheme).mse


def _called(function: Any, draws: Draws, scheme: str, times: Times) -> Any:
    """Call a function of the C library; the mse (D,)."""
    instants, mse = np.arange(HORIZON + 1), np.empty(len(draws.index))
    arrays = (
        np.ascontiguousarray(draws.y[:, :, 0]),
        np.ascontiguousarray(draws.z[:, :, 0]),
        np.isin(instants, times),
        8 * np.cos(1.2 * instants),
        np.sin(0.25 * instants) + 2,
        mse,
    )
    sizes = map(ctypes.c_long, (mse.size, instants.size, PARTICLES))
    key = ctypes.c_uint64(STREAM), ctypes.c_int(scheme == "systematic")
    function(*sizes, *key, *(ctypes.c_void_p(array.ctypes.data) for array in arrays))
    return mse


def _check(scheme: str, budget: int, ours: Any, in_c: Any, freely: Any) -> None:
    difference = freely - ours
    error = difference.std(ddof=1) / math.sqrt(ours.size)
    for who, got, allowed in (
        (IN_C, np.abs(in_c / ours - 1).max(), 1e-9),
        (FREELY, abs(difference.mean()), STANDARD_ERRORS * error),
    ):
        if not got <= allowed:
            raise PeerDisagreesError(
                f"{who} ({scheme}, {budget} times) must have the MSE of pfdist within "
                f"{allowed:.1e}, got a difference of {got:.1e}: its time means nothing"
            )


def summary(tables: Tables) -> str:
    """Give a summary of the times in Markdown."""
    rows = tables["beside_c"]
    lines = [
        [f"{scheme}, {budget} times", *(_cell(chosen[chosen["who"] == who]) for who in WHO)]
        for (scheme, budget), chosen in rows.groupby(["resampling", "measurement_budget"])
    ]
    text = (
        f"UNGM, T = {HORIZON}, {PARTICLES} particles, {DRAWS:,} draws. Nanoseconds of a "
        f"particle-step, processor time, least of {rows['repeats'].iloc[0]} repeats in turns; in "
        "brackets the times in units of the C program's, with the least and largest ratio of "
        "single rounds. The C program has the kernel's arithmetic and its MSE for each draw. "
        "Rounded freely, GCC may reorder sums and fuse operations, as pfdist may not. The bare "
        f"loop has the same noise and memory traffic. `{COMPILER} {ROUNDED}`; freely `{FREE}`."
    )
    return f"{text}\n\n{markdown(['one core', *WHO], lines)}"


def _cell(row: pd.DataFrame) -> str:
    found = row.iloc[0]
    low, high = found["ratio_low"], found["ratio_high"]
    return f"{found['ns']:.2f} ({found['ratio']:.2f}, {low:.2f} to {high:.2f})"


def plot(tables: Tables) -> Figure:
    """Draw the nanoseconds of a particle-step of each program."""
    rows = tables["beside_c"]
    figure = Figure(figsize=(1.5 * COLUMN_INCHES, COLUMN_INCHES), layout="constrained")
    axes = figure.subplots()
    cases = rows[["resampling", "measurement_budget"]].drop_duplicates().to_numpy().tolist()
    for who, colour, place in zip(WHO, (RED, BLUE, GREY, "0.85"), range(4), strict=True):
        ns = rows.loc[rows["who"] == who, "ns"].to_numpy()
        axes.bar(np.arange(len(cases)) + 0.2 * (place - 1.5), ns, 0.2, color=colour, label=who)
    axes.set_xticks(range(len(cases)), [f"{scheme},\n{budget} times" for scheme, budget in cases])
    axes.set_ylabel("ns a particle-step")
    axes.set_ylim(top=math.ceil(rows["ns"].max()))
    axes.legend(loc="upper right")
    return figure
