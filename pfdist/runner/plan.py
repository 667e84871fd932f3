"""Find measurement times and prove them, without a word about how."""

from pathlib import Path
from typing import Any

from pfdist.analysis import Run
from pfdist.job import Job, load_job
from pfdist.runner.run import run
from pfdist.search_sections import PLANNER


def plan(
    job: Job | str | Path, results: str | Path | None = None, search: str = PLANNER, **options: Any
) -> Run:
    """Search, decide on fresh draws between what was found, and compare it with regular times.

    Parameters
    ----------
    job : Job, str or Path
        A job, or the path of its file. Its searches, if it names any, are left aside.
    results : str or Path, optional
        The run's own folder; by default ``results/<the job file's stem>``, with ``-plan`` behind it
        if the job names searches, whose run that one is.
    search : str
        Method of the search, which has its defaults.
    options : object
        By name, as `pfdist.run` takes them.

    Returns
    -------
    Run

    Raises
    ------
    PfdistError
        As `pfdist.run`.
    """
    job = job if isinstance(job, Job) else load_job(job)
    if results is None:
        suffix = "-plan" if job.names_its_searches else ""
        results = Path("results") / f"{job.path.stem}{suffix}"
    return run(job.planned(search), results, **options)
