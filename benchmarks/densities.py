"""The nanoseconds of log densities, draws and noise in compiled code, on one core.

Every argument of a function differs from particle to particle. A parameter that is the same for all
particles costs less, because its part of the formula is computed once.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numba import njit

from benchmarks.measure import Say, one_core, take_turns
from benchmarks.results import Tables, markdown
from pfdist.densities import DENSITIES
from pfdist.kernels.formulas import formula
from pfdist.kernels.noise import FILL, padded
from pfdist.plots.style import BLUE, COLUMN_INCHES, RED

TITLE = "Densities and draws"
TABLES: tuple[str, ...] = ("densities",)

REPEATS = 9
PARTICLES = 2000
CALLS = 50
_COUNT, _POSITIVE, _SHARE, _ANY = (0, 30), (0.5, 30), (0.05, 0.95), (-3, 3)
RANGES = {
    "normal": (_ANY, _ANY, _POSITIVE),
    "student_t": (_ANY, _POSITIVE, _ANY, _POSITIVE),
    "laplace": (_ANY, _ANY, _POSITIVE),
    "lognormal": (_POSITIVE, _ANY, _POSITIVE),
    "gamma": (_POSITIVE, _POSITIVE, _POSITIVE),
    "beta": (_SHARE, _POSITIVE, _POSITIVE),
    "von_mises": (_ANY, _ANY, _POSITIVE),
    "poisson": (_COUNT, _POSITIVE),
    "binomial": (_COUNT, (30, 60), _SHARE),
    "negative_binomial": (_COUNT, _POSITIVE, _POSITIVE),
    "categorical": ((0, 3), _SHARE, _SHARE, _SHARE),
    "mixture": (_ANY, _ANY, _SHARE, _SHARE),
}
"""Ranges of y and of the parameters; of a mixture, two log densities or draws and two weights."""


def measure(quick: bool, say: Say) -> Tables:
    """Give the times of all log densities, draws and kinds of noise, measured in turns.

    Parameters
    ----------
    quick : bool
        Few densities, two repeats.
    say : callable
        Receives a line about the progress.

    Returns
    -------
    dict of DataFrames
        densities: a row for each density, with ns_log_density and ns_draw, and for each kind of
        noise, with ns_draw.
    """
    names = ["normal", "poisson"] if quick else list(DENSITIES)
    functions: dict[tuple[str, str], Callable[[], object]] = {}
    for kind in ("normal", "uniform", "centred"):
        functions[f"noise: {kind}", "ns_draw"] = _filling(kind)
    for name in names:
        functions[name, "ns_log_density"] = _looping(name, draws=False)
        functions[name, "ns_draw"] = _looping(name, draws=True)
    say(f"{len(functions)} functions")
    with one_core():
        timings = take_turns(functions, 2 if quick else REPEATS, say)
    rows: dict[str, dict[str, Any]] = {}
    for (name, column), timing in timings.items():
        row = rows.setdefault(name, {"name": name, "ns_log_density": np.nan})
        row[column] = timing.nanoseconds(PARTICLES * CALLS)["ns"]
    return {"densities": pd.DataFrame(list(rows.values()))}


def _looping(name: str, *, draws: bool) -> Callable[[], None]:
    """A function that calls a log density or a draw for each particle."""
    density, rng = DENSITIES[name], np.random.default_rng(0)
    first, *others = RANGES[name]
    parts = [f"a{i}[i]" for i in range(len(others))]
    ranges: list[tuple[float, float]] = [first, *others]
    y = ["y[i]"]
    if name == "mixture":
        y, parts = [], ["(y[i], a0[i])", "(a1[i], a2[i])"]
    elif name == "categorical":
        parts = [f"({', '.join(parts)})"]
    if draws:
        y = ["u[i]", "v[i]"][: len(density.noise)]
    names = ", ".join(["u", "v", "y", *(f"a{i}" for i in range(len(others)))])
    scope: dict[str, Any] = {"function": density.draw if draws else density.log_density}
    entries = ", ".join([*y, *parts]).replace("[i]", "")
    exec(f"def call({names}):\n    return function({entries})", scope)  # noqa: S102  our own names
    scope["call"] = formula(scope["call"])
    each = ", ".join(f"{name}[i]" for name in names.split(", "))
    exec(  # noqa: S102
        f"def loop(out, {names}):\n    for i in range(out.size):\n        out[i] = call({each})",
        scope,
    )
    loop = njit(scope["loop"], error_model="numpy")
    arrays = [rng.uniform(*bounds, PARTICLES) for bounds in [(0, 1), (0, 1), *ranges]]
    if first in (_COUNT, (0, 3)):
        arrays[2] = np.floor(arrays[2])
    if name == "binomial":
        arrays[3] = np.floor(arrays[3])
    out = np.empty(PARTICLES)

    def call() -> None:
        for _ in range(CALLS):
            loop(out, *arrays)

    return call


def _filling(kind: str) -> Callable[[], None]:
    out = np.empty((1, padded(PARTICLES)), np.float32)

    def call() -> None:
        for draw in range(CALLS):
            FILL[kind](out, 0, PARTICLES, np.uint64(1), draw, 0, 0, 0)

    return call


def summary(tables: Tables) -> str:
    """Give a summary in Markdown: the nanoseconds of each function."""
    rows = tables["densities"]
    table = markdown(
        ["ns a particle", "log density", "draw"],
        (
            [row["name"], _formatted(row["ns_log_density"]), _formatted(row["ns_draw"])]
            for _, row in rows.iterrows()
        ),
    )
    return (
        f"One core, {PARTICLES:,} particles, processor time, least of {REPEATS} repeats in turns. "
        f"All arguments differ from particle to particle.\n\n{table}"
    )


def _formatted(nanoseconds: float) -> str:
    if np.isnan(nanoseconds):
        return ""
    return f"{nanoseconds:.1f}" if nanoseconds < 10 else f"{nanoseconds:.0f}"


def plot(tables: Tables) -> Figure:
    """Draw the nanoseconds of log densities and draws, on a logarithmic axis."""
    rows = tables["densities"].iloc[::-1]
    figure = Figure(figsize=(COLUMN_INCHES, 1.1 * COLUMN_INCHES), layout="constrained")
    axes = figure.subplots()
    for column, colour, marker in (("ns_log_density", BLUE, "o"), ("ns_draw", RED, "s")):
        label = column.removeprefix("ns_").replace("_", " ")
        axes.plot(rows[column], rows["name"], marker, color=colour, ms=3, label=label)
    axes.set_xscale("log")
    axes.set_xlabel("ns a particle")
    axes.legend(loc="lower right")
    return figure
