"""Savings and bias if the variance of the particles estimates the MSE, on the paper's problem.

The benchmark compares two good sets that differ in a single time by one instant, because a search
must distinguish such sets. Both use common draws and noise. For each number of particles, all
estimators and schemes use the same draws, so biases are paired differences.
"""

import math
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from benchmarks.measure import Say, one_core, take_turns
from benchmarks.results import Tables, markdown
from pfdist import load_model
from pfdist.filters.particle_filter import filter_checked_sets
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation
from pfdist.kernels.estimators import FILTER_VARIANCE, SQUARED_ERROR
from pfdist.pages.style import COLUMN_INCHES, GREY, SERIES

TITLE = "Estimators"
TABLES: tuple[str, ...] = ("estimators",)

HORIZON = 60
GOOD = (1, 2, 3, 7, 11, 12, 16, 19, 20, 23, 24, 32, 33, 37, 41, 44, 45, 49, 53, 54, 58)
NEAR = tuple(15 if t == 16 else t for t in GOOD)
ESTIMATORS = (SQUARED_ERROR.name, FILTER_VARIANCE.name)
SCHEMES = ("multinomial", "systematic")
PARTICLES = (100, 200, 500)
DRAWS = 20_000
MARKS: dict[int, Any] = {
    count: {"marker": "o", "ms": 5, "ls": "", "fillstyle": style, "mfcalt": "white"}
    for count, style in zip(PARTICLES, ("none", "left", "full"), strict=True)
}
TIMED_STEPS = 10_000_000  # particle-steps of a measurement
REPEATS = 7
PRECISION = 0.1  # wanted standard error of a difference: half a percent of the cost


def measure(quick: bool, say: Say) -> Tables:
    """Give the table of both estimators and all schemes: times of the first set, figures of both.

    Parameters
    ----------
    quick : bool
        A twentieth of the draws, two repeats.
    say : callable
        Receives a line about the progress.

    Returns
    -------
    dict of DataFrames
        estimators: a row for each number of particles, estimator and scheme. Columns: ns,
        ns_median, ns_max and ns_wall of a particle-step; cost, and sd of a draw; bias, relative to
        the squared error with the same scheme, and bias_error; difference of the two sets,
        difference_error, and sd_difference of a draw; difference_bias and difference_bias_error;
        saved_cost and saved_difference, the variance of squared_error with multinomial resampling
        divided by the variance of this row, at equal work; milliseconds, the time of the filters of
        one set until the difference has a standard error of PRECISION.
    """
    model, rows = load_model("ungm"), []
    for particles in PARTICLES:
        draws = simulate(model, HORIZON, range(DRAWS // 20 if quick else DRAWS), 1)
        timed = draws[: max(1, TIMED_STEPS // (particles * (HORIZON + 1)))]
        turns: dict[Any, Any] = {}
        found: dict[tuple[str, str], NDArray[np.float64]] = {}
        for estimator in ESTIMATORS:
            for scheme in SCHEMES:
                settings, sets = Estimation(particles, scheme, estimator), [GOOD, NEAR]
                turns[estimator, scheme] = partial(
                    filter_checked_sets, model, timed, [GOOD], [HORIZON], 2, settings
                )
                found[estimator, scheme], *_ = filter_checked_sets(
                    model, draws, sets, [HORIZON] * 2, 2, settings
                )
                say(f"{particles} particles, {estimator}, {scheme}")
        with one_core():
            timings = take_turns(turns, 2 if quick else REPEATS, say)
        for (estimator, scheme), mse in found.items():
            steps = len(timed.index) * (HORIZON + 1) * particles
            rows.append(
                {"particles": particles, "estimator": estimator, "resampling": scheme}
                | timings[estimator, scheme].nanoseconds(steps)
                | _statistics(mse, found["squared_error", scheme])
            )
    table = pd.DataFrame(rows)
    for what, sd in (("cost", table["sd"]), ("difference", table["sd_difference"])):
        spent = table["ns"] * sd**2
        first = spent.groupby(table["particles"]).transform("first")
        table[f"saved_{what}"] = first / spent
    draws_wanted = (table["sd_difference"] / PRECISION) ** 2
    wanted = draws_wanted * (HORIZON + 1) * table["particles"]
    table["milliseconds"] = wanted * table["ns"] * 1e-6
    return {"estimators": table}


def _statistics(mse: NDArray[np.float64], squared_error: NDArray[np.float64]) -> dict[str, float]:
    """Give the statistical columns of a row, from estimates (D, 2) of both sets."""
    root = math.sqrt(len(mse))
    bias = (mse - squared_error)[:, 0] / squared_error[:, 0].mean()
    apart = mse[:, 1] - mse[:, 0]
    wrong = apart - (squared_error[:, 1] - squared_error[:, 0])
    return {
        "cost": float(mse[:, 0].mean()),
        "sd": float(mse[:, 0].std(ddof=1)),
        "bias": float(bias.mean()),
        "bias_error": float(bias.std(ddof=1) / root),
        "difference": float(apart.mean()),
        "difference_error": float(apart.std(ddof=1) / root),
        "sd_difference": float(apart.std(ddof=1)),
        "difference_bias": float(wrong.mean()),
        "difference_bias_error": float(wrong.std(ddof=1) / root),
    }


def summary(tables: Tables) -> str:
    """Give a summary of savings and biases in Markdown."""
    lines = []
    for row in _rows(tables):
        itself = row["estimator"] == "squared_error"
        lines.append(
            [
                f"{row['particles']}, {row['estimator']}, {row['resampling']}",
                f"{row['ns']:.2f}",
                f"{row['sd']:.2f}",
                f"{row['sd_difference']:.2f}",
                "" if itself else f"{100 * row['bias']:+.1f} ± {100 * row['bias_error']:.1f}",
                ""
                if itself
                else f"{row['difference_bias']:+.3f} ± {row['difference_bias_error']:.3f}",
                f"{row['saved_cost']:.1f}",
                f"{row['saved_difference']:.2f}",
                f"{row['milliseconds']:.1f}",
            ]
        )
    header = [
        "particles, estimator, resampling",
        "ns a particle",
        "sd of a draw",
        "sd of a draw's difference",
        "bias, %",
        "bias of the difference",
        "saved, one MSE",
        "saved, a difference",
        f"ms to ± {PRECISION}",
    ]
    return (
        "Two good sets of the paper's problem that differ in one time by one instant, under common "
        "draws and noise. ns a particle and instant. Biases "
        "are against the squared error by the same scheme with as many particles. Saved: variance "
        "at equal work of squared_error with multinomial resampling and as many particles, over "
        "this one's. The last column: how long one set's filters run until the difference is known "
        "to that standard error. ± is one standard error.\n\n" + markdown(header, lines)
    )


def _rows(tables: Tables) -> list[dict[str, Any]]:
    names = tables["estimators"].columns
    return [dict(zip(names, row, strict=True)) for row in tables["estimators"].to_numpy()]


def plot(tables: Tables) -> Figure:
    """Draw the variance saved at equal work, of one cost and of a difference."""
    figure = Figure(figsize=(COLUMN_INCHES, 1.25 * COLUMN_INCHES), layout="constrained")
    panels = figure.subplots(2, sharex=True)
    colours = dict(zip(SCHEMES, SERIES, strict=False))
    for axes, quantity, title in zip(
        panels, ("cost", "difference"), ("one cost", "difference of two sets"), strict=True
    ):
        for row in _rows(tables):
            scheme, size = SCHEMES.index(row["resampling"]), PARTICLES.index(row["particles"])
            axes.plot(
                ESTIMATORS.index(row["estimator"]) + 0.22 * (scheme - 0.5) + 0.06 * (size - 1),
                row[f"saved_{quantity}"],
                color=colours[row["resampling"]],
                **MARKS[row["particles"]],
            )
        axes.axhline(1, color=GREY, lw=0.6, ls=":")
        axes.set_yscale("log")
        ticks = (0.5, 1, 2, 5, 10) if quantity == "cost" else (0.5, 1, 2, 4)
        axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.minorticks_off()
        axes.set_ylabel("variance saved at equal work")
        axes.set_title(title)
    panels[1].set_xticks(range(len(ESTIMATORS)), [name.replace("_", " ") for name in ESTIMATORS])
    handles = [
        Line2D([], [], color=colour, label=scheme.replace("_", " "), **MARKS[PARTICLES[-1]])
        for scheme, colour in colours.items()
    ]
    handles += [
        Line2D([], [], color=GREY, label=f"{count} particles", **mark)
        for count, mark in MARKS.items()
    ]
    panels[0].legend(handles=handles, loc="upper left")
    return figure
