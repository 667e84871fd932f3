"""Choose measurement times one after another, and compare them with times chosen in advance."""

from collections.abc import Iterable
from pathlib import Path
from typing import Unpack

from pfdist.problem.problem import JobSource, as_job
from pfdist.questions.options import Options, with_options
from pfdist.questions.run import run
from pfdist.questions.run_of_job import folder_of
from pfdist.results import Run


@with_options
def online(
    job: JobSource,
    results: str | Path | None = None,
    draws: int | None = None,
    changes: Iterable[str] = (),
    reuse: str | Path | Iterable[str | Path] = (),
    **options: Unpack[Options],
) -> Run:
    """Choose times one after another, and compare them with times found in advance.

    After each measurement, the measurements that are left are planned again from the particles of
    the filter. The times chosen in this way, the times that the job's searches found in advance and
    the regular times all filter the same fresh draws. See ``docs/online.md``.

    Parameters
    ----------
    job : Problem, Job, str or Path
        A job file, as ``jobs/plan.toml``, or the folder of a run.
        Without a section [online] it gets the defaults.
    results : str or Path, optional
        Folder of the run; by default ``results/NAME`` of a job ``NAME.toml`` if it has a
        section [online], as its run has, and otherwise ``results/NAME-online``.
    draws : int, optional
        Replaces the job's online.draws. A larger number resumes a run with more draws.
    changes : iterable of str, optional
        Other values of keys of the job, as ``seed=3 filter.particles=200``.
    reuse : str, Path or iterable of these, optional
        Folders of other runs, whose evaluations are taken, not computed again; give it once for
        each.
    options
        See `Options`.

    Returns
    -------
    Run
        Its table ``online`` has a row for each draw, and `Run.as_json` the key ``online``.

    Raises
    ------
    PfdistError
        As `pfdist.run` raises. The job has fewer draws in its comparison, or a section [budget].
    """
    settings = {"online": {} if draws is None else {"draws": draws}}
    job = as_job(job, changes, settings=settings)
    results = folder_of(job, results, "" if "online" in job.origin.sections else "-online")
    return run(job, results, reuse=reuse, **options)
