"""Filters with and without the proposal that they derive, against exact filters or many particles.

All filters of a system have the same draws, so their errors are compared draw by draw.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from benchmarks.measure import Say, one_core, take_turns
from benchmarks.results import Tables, markdown
from pfdist import StateSpaceModel, linear_gaussian, load_model, where
from pfdist.common.estimate import Estimate
from pfdist.common.measurement_times import Times
from pfdist.filters import kalman
from pfdist.filters.draws import Draws
from pfdist.filters.particle_filter import filter_checked_draws
from pfdist.filters.proposal import PLAIN
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation, with_truth
from pfdist.pages.style import BLUE, COLUMN_INCHES, RED
from pfdist.plugins.guided.proposal import GUIDED
from pfdist.problem.job import load_job
from pfdist.runner.build import build

TITLE = "Guided filters"
JOBS = Path(__file__).parents[1] / "jobs"
TABLES: tuple[str, ...] = ("guided",)

REPEATS, SHARP = 3, 0.001


@dataclass(frozen=True)
class System:
    """A model with measurement times, and the filter that counts as exact: 0 is Kalman's."""

    model: StateSpaceModel
    noise: str
    horizon: int
    times: Times
    particles: int
    many: tuple[int, str] = (0, "")
    draws: int = 1000


def walk(dimensions: int) -> StateSpaceModel:
    """A random walk in some dimensions, each of which has a sharp sensor."""
    unit = np.eye(dimensions)
    return linear_gaussian(
        f"walk in {dimensions}",
        initial_noise=unit.tolist(),
        transition=unit.tolist(),
        process_noise=(0.5 * unit).tolist(),
        measurement=unit.tolist(),
        measurement_noise=(SHARP * unit).tolist(),
        quantity_of_interest=unit.tolist(),
    )


def clutter(count: int = 4, sd: float = 0.01, share: float = 0.01) -> StateSpaceModel:
    """Positions that return to 0, seen by sharp sensors; some echoes are clutter."""
    wide = 3.0

    def log_likelihood(y: Any, x: Any, t: Any, p: Any) -> Any:
        pairs = [*zip(y, x, strict=True)]
        echo = sum(-0.5 * ((a - b) / sd) ** 2 - np.log(sd) for a, b in pairs)
        noise = sum(-0.5 * (a / wide) ** 2 - np.log(wide) for a in y)
        return np.logaddexp(np.log(1.0 - share) + echo, np.log(share) + noise)

    return StateSpaceModel(
        name=f"clutter in {count}",
        initial=lambda w, p: w,
        transition=lambda x, t, w, p: tuple(0.5 * a + 0.9 * b for a, b in zip(x, w, strict=True)),
        measurement=lambda x, t, v, p: tuple(
            where(v[count] < share, wide * v[k], x[k] + sd * v[k]) for k in range(count)
        ),
        log_likelihood=log_likelihood,
        quantity_of_interest=lambda x, t, p: x,
        initial_noise=("normal",) * count,
        process_noise=("normal",) * count,
        measurement_noise=(*("normal",) * count, "uniform"),
    )


def systems() -> Mapping[str, System]:
    """The systems by their names."""
    sharp = {"bearing_sd": 1e-4, "range_sd": 1e-4}
    velocity, every7, every8 = load_model("constant_velocity"), (5, 12, 19, 26, 33, 40), 8
    grid = (*range(0, 41, every8),)
    return {
        **{
            f"walk in {n}, {'with' if 0 in times else 'without'} t = 0": System(
                walk(n), "sensors of .001", 14, times, 500
            )
            for n in (1, 2, 4, 6)
            for times in ((0, 7, 14), (6, 13))
        },
        "clutter in 4": System(
            clutter(), "sensors of .01, 1 % clutter", 30, (*range(31),), 500,
            (20_000, GUIDED.name), 200,
        ),
        "constant velocity, sharp": System(
            velocity.with_parameters(sharp), "range and bearing to 1e-4", 40, every7, 500,
            (100_000, GUIDED.name), 100,
        ),
        "constant velocity": System(
            velocity, "the model's own", 40, grid, 500, (20_000, GUIDED.name), 400
        ),
        "robot": System(
            load_model("robot"), "the model's own", 40, grid, 300, (20_000, PLAIN.name), 400
        ),
        **{name: of_job(name) for name in ("xray_tumour", "epidemic_counts", "two_compartments")},
        "growth": System(
            load_model("ungm"), "the model's own", 60, (*range(0, 61, 3),), 500,
            (20_000, PLAIN.name), 400,
        ),
    }  # fmt: skip


def of_job(name: str) -> System:
    """The model and the regular times of a job that ships, with its number of particles."""
    job = load_job(JOBS / f"{name}.toml", ["filter.proposal=plain"])
    model, times = build(job).evaluator.model, job.problem.feasible.regular()
    horizon = job.problem.feasible.horizon
    return System(
        model, "the model's own", horizon, times, job.filter.particles, (10_000, GUIDED.name), 400
    )


def measure(quick: bool, say: Say) -> Tables:
    """Give error, bound and time of each system with both proposals.

    Parameters
    ----------
    quick : bool
        Few draws, two repeats.
    say : callable
        Receives a line about the progress.

    Returns
    -------
    dict of DataFrames
        guided: a row for each system and proposal, with excess (of the expected MSE over that of
        the exact filter, as a fraction), excess_error, bound (of the same set, as a fraction of the
        exact error), bound_error, and ns a particle-step.
    """
    rows, functions = list[dict[str, Any]](), dict[tuple[str, ...], Callable[[], object]]()
    for name, system in systems().items():
        count = 16 if quick else system.draws
        draws = simulate(system.model, system.horizon, range(count), 1)
        exact = _exact(system, draws, quick)
        for proposal in (PLAIN.name, GUIDED.name):
            own = Estimation(system.particles, proposal=proposal)
            filtered = partial(filter_checked_draws, system.model, draws, system.times, 2)
            excess = Estimate.of_mean(filtered(own).mse - exact).times(1.0 / exact.mean())
            inside = filtered(with_truth(system.particles, proposal)).mse
            ratio = inside.mean() / exact.mean()
            bound = Estimate.of_mean(inside - ratio * exact).times(1.0 / exact.mean())
            functions[name, proposal] = partial(filtered, own)
            rows.append(
                {
                    "system": name,
                    "noise": system.noise,
                    "times": " ".join(map(str, system.times)),
                    "particles": system.particles,
                    "proposal": proposal,
                    "excess": excess.value,
                    "excess_error": excess.standard_error,
                    "bound": ratio,
                    "bound_error": bound.standard_error,
                    "steps": count * (system.horizon + 1) * system.particles,
                }
            )
        say(name)
    with one_core():
        timings = take_turns(functions, 2 if quick else REPEATS, say)
    for row in rows:
        timing = timings[row["system"], row["proposal"]]
        row["ns"] = timing.nanoseconds(row.pop("steps"))["ns"]
    return {"guided": pd.DataFrame(rows)}


def _exact(system: System, draws: Draws, quick: bool) -> Any:
    """The errors of the filter that counts as exact."""
    particles, proposal = system.many
    if not particles:
        return kalman.filter_draws(system.model, draws, system.times, 1, 2).mse
    many = Estimation(2000 if quick else particles, proposal=proposal)
    return filter_checked_draws(system.model, draws, system.times, 3, many).mse


def summary(tables: Tables) -> str:
    """Give a summary in Markdown."""
    table = markdown(
        ["system", "noise", "P", "proposal", "error over exact", "bound over exact", "ns"],
        (
            [
                row["system"],
                row["noise"],
                str(row["particles"]),
                row["proposal"],
                f"{100 * row['excess']:+.1f} ± {100 * row['excess_error']:.1f} %",
                f"{row['bound']:.3f} ± {row['bound_error']:.3f}",
                f"{row['ns']:.1f}",
            ]
            for _, row in tables["guided"].iterrows()
        ),
    )
    return (
        "Error and bound are over the error of the same draws with a Kalman filter (walks), or "
        "with many particles; ± is the standard error of this ratio. The time is that of a "
        f"particle-step on one core, least of {REPEATS} repeats in turns.\n\n{table}"
    )


def plot(tables: Tables) -> Figure:
    """Draw the excess of both proposals."""
    rows = tables["guided"]
    figure = Figure(figsize=(COLUMN_INCHES, 1.1 * COLUMN_INCHES), layout="constrained")
    axes = figure.subplots()
    for proposal, color, marker in ((PLAIN.name, RED, "s"), (GUIDED.name, BLUE, "o")):
        some = rows[rows["proposal"] == proposal].iloc[::-1]
        axes.errorbar(
            100 * some["excess"], some["system"], xerr=196 * some["excess_error"], fmt=marker,
            color=color, ms=3, lw=0.8, label=proposal,
        )  # fmt: skip
    axes.axvline(0.0, color="0.5", lw=0.6)
    axes.set_xscale("symlog", linthresh=1.0)
    axes.set_xlabel("error over the exact filter's [%]")
    axes.legend()
    return figure
