"""Find measurement times and prove them, without a word about how."""

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from pfdist.analysis import Run
from pfdist.api.run import run
from pfdist.job.job import Job, as_job
from pfdist.search.methods import DEFAULT_METHOD


def plan(
    job: Job | str | Path,
    results: str | Path | None = None,
    search: str = DEFAULT_METHOD,
    changes: Iterable[str] = (),
    **options: Any,
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
    changes : iterable of str, optional
        ``key=value`` each, as `pfdist.load_job` takes them; the search goes by its method:
        ``search.survivors.survivors=4``.
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
    job = as_job(job, changes, {"search": [{"method": search}]})
    if results is None:
        suffix = "-plan" if job.names_its_searches else ""
        results = Path("results") / f"{job.path.stem}{suffix}"
    return run(job, results, **options)
