"""Say how the expected MSE falls with the number of measurements, and how many are enough."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pfdist.analysis import Run
from pfdist.api.run import run
from pfdist.errors import JobError
from pfdist.job.job import Job, as_job
from pfdist.plots import draw_target
from pfdist.search.methods import DEFAULT_METHOD

DRAWS = 4000


def budget(
    job: Job | str | Path,
    measurements: tuple[int, int],
    results: str | Path | None = None,
    draws: int = DRAWS,
    target: float | None = None,
    changes: Sequence[str] = (),
    **options: Any,
) -> Run:
    """Find times for every number of measurements, and compare them with regular times.

    One survivor programme finds the times of all numbers; all of them, and the regular times of
    each, then filter the same fresh draws.

    Parameters
    ----------
    job : Job, str or Path
        A job, or the path of its file. Its searches and its measurement budget are left aside.
    measurements : (int, int)
        Least and largest number of measurements.
    results : str or Path, optional
        The run's own folder; by default ``results/<the job file's stem>-budget``.
    draws : int
        On which they are compared; more of them go on with a run.
    target : float, optional
        An expected MSE: another figure, ``budget-target-<target>``, shows it and the least number
        that reaches it, as `Run.reaching` gives it.
    changes : sequence of str, optional
        ``key=value`` each, as `pfdist.load_job` takes them.
    options : object
        By name, as `pfdist.run` takes them.

    Returns
    -------
    Run
        Its `Run.budget` has a row for each number and kind of times.

    Raises
    ------
    PfdistError
        As `pfdist.run`.
    """
    if draws < 2:
        raise JobError(f"draws must be at least 2, got {draws}", argument="draws")
    least, most = measurements
    asked = {"budget": {"least": least, "most": most}, "comparison": {"draws": draws}}
    search = [{"method": DEFAULT_METHOD, "polish": False}]
    job = as_job(job, changes, {"search": search, **asked})
    if job.with_changes((), asked) != job:
        raise JobError(
            "changes of a budget must leave [budget] and [comparison] as measurements and draws "
            f"say, got {' '.join(changes)}",
            argument="set",
        )
    # Whatever one number it is that the job is for, the run is the same.
    job = job.with_changes([f"problem.measurement_budget={most}"])
    results = Path("results") / f"{job.path.stem}-budget" if results is None else results
    done = run(job, results, **options)
    if target is not None:
        draw_target(done, target)
    return done
