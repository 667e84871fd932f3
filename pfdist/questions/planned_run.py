"""Real measurements: the run that planned them, the tables of a user, and the filter."""

from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd

from pfdist.common.arguments import path_argument
from pfdist.common.measurement_times import Times
from pfdist.common.nearest import did_you_mean
from pfdist.errors import JobError, shown
from pfdist.filters.cloud import Prior
from pfdist.filters.filter import Filter
from pfdist.filters.user_prior import as_prior, read_prior
from pfdist.results import Run
from pfdist.results.sets import best_first
from pfdist.runner.build import Built

Table = str | Path | pd.DataFrame
"""The path of a table in CSV or Parquet, or a table in memory."""


def table_argument(name: str, value: Any) -> Path | pd.DataFrame:
    """An argument as a path or a DataFrame; an `ArgumentError` if it is neither."""
    return value if isinstance(value, pd.DataFrame) else path_argument(name, value)


def prior_argument(value: Any) -> Any:
    """The prior of a caller: the path of its table, None for an empty name, or an object."""
    if isinstance(value, str | Path):
        return path_argument("prior", value) if str(value) else None
    return value


class PlannedRun(NamedTuple):
    """A finished run, the set that was planned, and what filters need.

    Parameters
    ----------
    run : Run
    name : str
        Name of the compared set whose times were planned.
    times : tuple of int
    built : Built
        The run's job, built.
    prior : Cloud, Gaussian or None
        Particles from which the filter starts, if the user gives some.
    """

    run: Run
    name: str
    times: Times
    built: Built
    prior: Prior | None


def planned_run(run_and_job: tuple[Run, Built], planned: str, prior: Any) -> PlannedRun:
    """A finished run whose times were planned, and what filters need.

    Parameters
    ----------
    run_and_job : Run, Built
        As `pfdist.questions.run_of_job.run_and_job` gives them.
    planned : str
        Name of the compared set that was planned; empty: see `planned_set`.
    prior : Path, DataFrame, Cloud or array, optional
        As `prior_argument` gives it.

    Raises
    ------
    JobError, PriorError
        As `planned_set` and `read_prior` raise.
    """
    opened, built = run_and_job
    name, times = planned_set(opened, planned)
    times = built.job.problem.clock.measurements(times)
    return PlannedRun(opened, name, times, built, _prior(prior, built))


def _prior(prior: Any, built: Built) -> Prior | None:
    model, clock = built.evaluator.believed, built.job.problem.clock
    if isinstance(prior, Path):
        return read_prior(prior, model, clock)
    return None if prior is None else as_prior(prior, model, clock)


def planned_set(run: Run, name: str = "") -> tuple[str, Times]:
    """The name and the times of the set that was planned.

    Parameters
    ----------
    run : Run
    name : str, optional
        Name of a compared set; by default the found set with the lowest expected MSE.

    Raises
    ------
    JobError
        The run has no set of this name, or sets of several numbers of measurements and no name.
    """
    sets = run.sets
    if name in sets:
        return name, sets[name]
    if name:
        raise JobError(
            f"planned must be a compared set of {run.path}, {', '.join(sets)}, got {shown(name)}"
            f"{did_you_mean(name, sets)}",
            argument="planned",
        )
    if "budget" in run.job:
        raise JobError(
            f"{run.path} has times of several numbers of measurements: planned must say which, "
            f"for instance {list(sets)[-1]}",
            argument="planned",
        )
    best = best_first(run.table("sets"))[0]
    return best, sets[best]


def filter_of(built: Built, prior: Prior | None = None, draw: int = 0) -> Filter:
    """The filter of a job for one system, with the job's [model.filter], [filter] and seed.

    Parameters
    ----------
    built : Built
    prior : Cloud or Gaussian, optional
        The knowledge of x(s), in the place of the model's `initial`.
    draw : int
        Number of the system, which keys the noise.

    Raises
    ------
    PriorError
        The prior does not fit the model.
    """
    job = built.job
    if built.evaluator.told:
        raise JobError(
            "a filter of real measurements cannot be told the scenario, got scenarios.filter = "
            f"'told' ({job.path}): 'nominal' gives it the parameters of the model"
        )
    return Filter(
        built.evaluator.believed,
        job.filter.particles,
        job.seed,
        resampling=job.filter.resampling,
        resample=job.filter.resample or "always",
        engine=built.evaluator.engine,
        prior=prior,
        draw=draw,
        horizon=job.problem.feasible.horizon,
    )
