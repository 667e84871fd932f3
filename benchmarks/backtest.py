"""How often a backtest says what is true, against the number of replicates, by simulated data.

Measurements are draws of a right model or of a wrong one. The filter is linear in the measurements,
so the true ratio of the found and the foreseen difference is exact.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from benchmarks.measure import Say
from benchmarks.results import Tables, markdown
from pfdist import StateSpaceModel
from pfdist.filters import kalman
from pfdist.filters.draws import Draws
from pfdist.filters.predicted import predicted
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation
from pfdist.pages.style import BLUE, COLUMN_INCHES, GREEN, GREY, OCHRE, PURPLE, RED
from pfdist.plugins.backtest.promise import (
    HALF,
    KEPT,
    NOT_DECIDED,
    NOT_KEPT,
    RelativeErrors,
    promise,
    real_over_foreseen,
)

TITLE = "Verdicts of a backtest"
TABLES: tuple[str, ...] = ("backtest",)

Array = NDArray[np.float64]
HORIZON, REPEATS, FORESEEN = 47, 200, 480
SETS = {"plan": (0, 11, 17, 24), "from_start": (0, 12, 24, 36), "centred": (6, 18, 30, 42)}
GRIDS = ("from_start", "centred")
REPLICATES = (20, 50, 100, 200, 400)
JUDGED = [t for t in range(HORIZON + 1) if t not in sum(SETS.values(), ())]
_SYSTEMS = 400  # groups of simulated systems, of which each replicate takes one
COLOURS = ("black", GREY, BLUE, RED, OCHRE, GREEN, PURPLE)
_INSTANTS = np.arange(HORIZON + 1)


def lake(**parameters: float) -> StateSpaceModel:
    """An hourly turbidity, which changes more by day than by night."""
    return StateSpaceModel(
        name="lake",
        initial=lambda w, p: (p.sd / np.sqrt(1 - p.a**2) * w[0],),
        transition=lambda x, t, w, p: (p.a * x[0] + _deviation(t, p.sd) * w[0],),
        measurement=lambda x, t, v, p: (x[0] + p.noise * v[0],),
        log_likelihood=lambda y, x, t, p: -0.5 * ((y[0] - x[0]) / p.noise) ** 2,
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("normal",),
        process_noise=("normal",),
        measurement_noise=("normal",),
        parameters={"a": 0.95, "sd": 0.3, "noise": 0.1} | parameters,
        linear_gaussian=True,
    )


def _deviation(t: Any, sd: float) -> Any:
    return sd * (1 + 0.8 * np.sin(2 * np.pi * t / 48))


def second_moments(model: StateSpaceModel) -> Array:
    """E[y(s) y(t)] of draws of the lake, (T+1, T+1)."""
    p = model.p
    moments = np.zeros((HORIZON + 1, HORIZON + 1))
    variance = p.sd**2 / (1 - p.a**2)
    for t in range(HORIZON + 1):
        later = variance * p.a ** _INSTANTS[: HORIZON + 1 - t]
        moments[t, t:] = moments[t:, t] = later
        variance = p.a**2 * variance + _deviation(t, p.sd) ** 2
    return np.asarray(moments + p.noise**2 * np.eye(HORIZON + 1))


def errors(y: Array) -> dict[str, Array]:
    """The error of measurements (D, T+1) with each set, (D,), by the filter of the model."""
    model = predicted(lake())
    draws = Draws(model, range(len(y)), np.empty((len(y), 0, 0)), y[..., None], y[..., None])
    found = {}
    for name, times in SETS.items():
        filtered = kalman.filter_checked_draws(model, draws, times, 0, Estimation(1), True)
        apart = y[:, JUDGED] - np.asarray(filtered.estimate)[:, JUDGED, 0]
        found[name] = np.mean(apart**2, axis=1)
    return found


def mean_errors(moments: Array) -> dict[str, float]:
    """The expected error of measurements with second moments (T+1, T+1), for each set.

    The filter is linear, and 0 for y = 0. Its matrix has the estimates of unit vectors.
    """
    model, units = predicted(lake()), np.eye(HORIZON + 1)[..., None]
    draws = Draws(model, range(HORIZON + 1), np.empty((HORIZON + 1, 0, 0)), units, units)
    means = {}
    for name, times in SETS.items():
        filtered = kalman.filter_checked_draws(model, draws, times, 0, Estimation(1), True)
        rest = (units - np.asarray(filtered.estimate))[:, JUDGED, 0]
        means[name] = float(np.trace(rest.T @ moments @ rest) / len(JUDGED))
    return means


class Case(NamedTuple):
    """Measurements: draws of a model, times a factor, and what the model lacks."""

    truth: StateSpaceModel
    factor: float = 1.0
    trend: Array = np.zeros(HORIZON + 1)
    shift: Array = np.zeros(HORIZON + 1)  # times a standard normal number for each system

    @property
    def moments(self) -> Array:
        """E[y(s) y(t)], (T+1, T+1)."""
        moments = self.factor**2 * second_moments(self.truth)
        return moments + np.outer(self.trend, self.trend) + np.outer(self.shift, self.shift)

    def measured(self, systems: int, stream: int) -> Array:
        """Measurements of some systems, (D, T+1)."""
        y = self.factor * simulate(self.truth, HORIZON, range(systems), stream).y[:, :, 0]
        size = np.random.default_rng(stream).normal(size=(systems, 1))
        return y + self.trend + size * self.shift


def ratios(case: Case) -> dict[str, float]:
    """The true ratio of the found and the foreseen difference, against each grid."""
    foreseen, found = mean_errors(second_moments(lake())), mean_errors(case.moments)
    return {
        name: (found[name] - found["plan"]) / (foreseen[name] - foreseen["plan"]) for name in GRIDS
    }


def without_gain(shape: Array) -> Array:
    """A shape of such a size that the plan is as good as centred times, if it is added."""
    difference = {
        name: each["centred"] - each["plan"]
        for name, each in (
            ("foreseen", mean_errors(second_moments(lake()))),
            ("shape", mean_errors(np.outer(shape, shape))),
        )
    }
    size = float(np.sqrt(-difference["foreseen"] / difference["shape"]))
    return size * shape


def cases() -> Mapping[str, Case]:
    """The right model, and wrong ones."""
    late = (_INSTANTS > 24).astype(np.float64)
    return {
        "right model": Case(lake()),
        "half of all errors": Case(lake(), factor=np.sqrt(HALF)),
        "shift in the second half": Case(lake(), shift=without_gain(late)),
        "trend": Case(lake(), trend=without_gain(_INSTANTS.astype(np.float64))),
        "measurement noise 50 % larger": Case(lake(noise=0.15)),
        "process noise 50 % larger": Case(lake(sd=0.45)),
        "rate 0.80 for 0.95": Case(lake(a=0.8)),
    }


def measure(quick: bool, say: Say) -> Tables:
    """Backtest the plan many times, with measurements of each case.

    Parameters
    ----------
    quick : bool
        Two cases, 20 repetitions of at most 50 replicates.
    say : callable
        Receives a line about the progress.

    Returns
    -------
    dict of DataFrames
        backtest: a row for each case, number of replicates and grid, with ratio (the true one),
        kept, not_kept, not_decided, and wrong ("the model is wrong"): shares of the repetitions.
    """
    rows, sizes = [], REPLICATES[: 2 if quick else None]
    foreseen = errors(Case(lake()).measured(FORESEEN * (20 if quick else _SYSTEMS), 1))
    for stream, (name, case) in enumerate([*cases().items()][: 2 if quick else None], 2):
        of_case = repeated(case, foreseen, sizes, 20 if quick else REPEATS, stream)
        rows += [{"case": name, **row} for row in of_case]
        say(f"{name}: " + ", ".join(f"{key} {value:.3g}" for key, value in of_case[-1].items()
                                    if not isinstance(value, str)))  # fmt: skip
    return {"backtest": pd.DataFrame(rows)}


def repeated(
    case: Case,
    foreseen: Mapping[str, Array],
    sizes: tuple[int, ...] = REPLICATES,
    repeats: int = REPEATS,
    stream: int = 2,
) -> list[dict[str, Any]]:
    """The verdicts of repetitions with separate replicates.

    Parameters
    ----------
    case : Case
    foreseen : mapping of str to array, (K FORESEEN,)
        Errors of simulated systems with each set.
    sizes : tuple of int
        Numbers of replicates.
    repeats : int
    stream : int
        Key of the noise.
    """
    true, rows = ratios(case), []
    real = errors(case.measured(repeats * sizes[-1], stream))
    groups = {name: each.reshape(-1, FORESEEN) for name, each in foreseen.items()}
    rng = np.random.default_rng(stream)
    for size in sizes:
        verdicts, wrong = {name: list[str]() for name in GRIDS}, 0
        for repeat in range(repeats):
            part = slice(repeat * size, (repeat + 1) * size)
            chosen = rng.integers(len(groups["plan"]), size=size)
            of_sets = {
                name: RelativeErrors(real[name][part], groups[name][chosen]) for name in SETS
            }
            intervals = [real_over_foreseen(each, len(SETS))[1] for each in of_sets.values()]
            wrong += not all(low <= 1.0 <= high for low, high in intervals)
            for name in GRIDS:
                verdicts[name].append(promise(of_sets["plan"], of_sets[name]).verdict)
        rows += [
            {
                "grid": name,
                "ratio": true[name],
                "replicates": size,
                **{
                    verdict.replace(" ", "_"): verdicts[name].count(verdict) / repeats
                    for verdict in (KEPT, NOT_KEPT, NOT_DECIDED)
                },
                "wrong": wrong / repeats,
            }
            for name in GRIDS
        ]
    return rows


def summary(tables: Tables) -> str:
    """Give the table in Markdown."""
    rows = tables["backtest"]
    lines = [
        [
            row["case"],
            f"{row['ratio']:.2f}".replace("-0.00", "0.00"),
            str(row["replicates"]),
            *(f"{100 * row[share]:.1f}" for share in ("kept", "not_kept", "not_decided", "wrong")),
        ]
        for row in rows[rows["grid"] == "centred"].to_dict("records")
    ]
    header = (
        "measurements", "true ratio", "replicates", "kept, %", "not kept, %", "not decided, %",
        "model is wrong, %",
    )  # fmt: skip
    return (
        f"Verdicts of {REPEATS} backtests of a plan of 4 measurements in T = {HORIZON} against "
        "centred times, and how many say that the model is wrong. The true ratio of the found and "
        "the foreseen difference is exact. The foreseen gain is 20 % against centred times and "
        "11 % against times from 0, for which verdicts take about three times as many replicates."
        "\n\n" + markdown(header, lines)
    )


def plot(tables: Tables) -> Figure:
    """Draw the share of clear verdicts against the number of replicates."""
    figure = Figure(figsize=(COLUMN_INCHES, 1.5 * COLUMN_INCHES), layout="constrained")
    panels = figure.subplots(2, sharex=True, sharey=True)
    rows = tables["backtest"]
    for axes, grid in zip(panels, GRIDS, strict=True):
        chosen = rows[rows["grid"] == grid]
        for (name, case), colour in zip(chosen.groupby("case", sort=False), COLOURS, strict=False):
            share = 100 * (1 - case["not_decided"])
            axes.plot(case["replicates"], share, "o-", ms=2, color=colour, label=name)
        axes.set_title(f"against {'times from 0' if grid == 'from_start' else 'centred times'}")
        axes.set_ylabel("verdicts, %")
    panels[1].set_xlabel("replicates")
    panels[1].set_xscale("log")
    panels[1].set_xticks(REPLICATES, [str(each) for each in REPLICATES])
    panels[1].minorticks_off()
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper left", ncols=2)
    return figure
