"""A finished run whose times a user has planned to measure."""

from pathlib import Path
from typing import Any, NamedTuple

from pfdist.analysis import Run
from pfdist.common.nearest import did_you_mean
from pfdist.errors import JobError, shown
from pfdist.filters.cloud import Prior
from pfdist.runner.build import Built
from pfdist.sequential.user_prior import as_prior, read_prior
from pfdist.times.measurement_times import Times


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
        As `pfdist.api.run_of_job.run_and_job` gives them.
    planned : str
        Name of the compared set that was planned; empty: see `planned_set`.
    prior : str, Path, DataFrame, Cloud or array
        Particles from which the filter starts, or their table; an empty name for none.

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
    """The knowledge from which a filter starts: a table's, a prior, or None for an empty name."""
    model, clock = built.evaluator.believed, built.job.problem.clock
    if isinstance(prior, str | Path):
        return read_prior(Path(prior), model, clock) if str(prior) else None
    return as_prior(prior, model, clock)


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
    best = run.summary().by_error[0]
    return best, sets[best]
