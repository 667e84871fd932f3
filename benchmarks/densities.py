"""The nanoseconds of log densities, draws and noise in compiled code, on one core.

Every argument of a function differs from particle to particle. A parameter that is the same for all
particles costs less, because its part of the formula is computed once.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from benchmarks.measure import Say, one_core, take_turns
from benchmarks.results import Tables, markdown
from pfdist.densities import DENSITIES
from pfdist.kernels.blocks import Source, compile_blocks, run_block
from pfdist.kernels.cached import entry
from pfdist.kernels.memory import call, read
from pfdist.kernels.variates import (
    FILTER_PROCESS,
    KINDS,
    SPARE,
    Key,
    VariateRow,
    fill,
    number_of_words,
)
from pfdist.kernels.vectors import LANES
from pfdist.models.tracing import Formula, trace
from pfdist.pages.style import BLUE, COLUMN_INCHES, RED

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
    """A function that computes a log density or a draw for each particle."""
    density, rng = DENSITIES[name], np.random.default_rng(0)
    first, *others = RANGES[name]
    function = density.draw if draws else density.log_density
    noise = len(density.noise) if draws else 0

    def formula(x: Sequence[Any], p: Any) -> Any:
        """The noise or y first, then the parameters."""
        u, y, given = x[:noise], x[2], x[3:]
        begin: Sequence[Any] = u if draws else [y]
        if name == "mixture":
            return function(*u, (y, given[0]), (given[1], given[2]))
        if name == "categorical":
            return function(*begin, tuple(given))
        return function(*begin, *given)

    ranges: list[tuple[float, float]] = [(0, 1), (0, 1), first, *others]
    arrays = np.array([rng.uniform(*bounds, PARTICLES) for bounds in ranges])
    if first in (_COUNT, (0, 3)):
        arrays[2] = np.floor(arrays[2])
    if name == "binomial":
        arrays[3] = np.floor(arrays[3])
    arguments = {"x": len(arrays), "p": 0}
    traced = trace(Formula(formula, name, arguments, {}, "benchmark"), range(1))
    compiled = compile_blocks([Source(traced, {"x": ("slots", 0)}, {}, 1)], range(1))
    out = np.empty((1, PARTICLES))

    def call() -> None:
        blocks = compiled.blocks
        address, shared = int(blocks.addresses[0, 0]), blocks.table[blocks.places[0, 0] :]
        for _ in range(CALLS):
            run_block(compiled.code, address, out, arrays, shared)

    return call


class _Often(NamedTuple):
    row: VariateRow
    fill: int  # address of `fill`


def _filling(kind: str) -> Callable[[], None]:
    width = -(-PARTICLES // LANES) * LANES
    words = np.zeros(number_of_words(1, width), np.uint32)
    out, key = np.empty(width + SPARE, np.float32), Key(np.uint64(1), 0, int(FILTER_PROCESS), 0)
    often = _Often(VariateRow(words, out, width, KINDS.index(kind), key, 0, 1), fill.address)
    return lambda: _fill_often(often)


@entry(_Often)
def _fill_often(often):  # type: ignore[no-untyped-def]
    (words, out, width, kind, key, _, draws), address = read(often)
    for draw in range(CALLS):
        call(address, VariateRow(words, out, width, kind, key, draw, draws))


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
