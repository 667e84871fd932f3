"""Find measurement times and prove them, with one search that needs no settings."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from pfdist.common.arguments import sets_argument
from pfdist.errors import JobError, MeasurementTimesError
from pfdist.problem.job import Job
from pfdist.problem.problem import JobSource, as_job
from pfdist.problem.sections import DEFAULT_METHOD
from pfdist.questions.options import Names, Options, with_options
from pfdist.questions.run import run
from pfdist.questions.run_of_job import AGAINST, PLANNED, folder_of, searched_by
from pfdist.results import Run
from pfdist.results.export import checked_export
from pfdist.runner.bound_settings import LEAST_DRAWS

if TYPE_CHECKING:
    from pfdist.questions.evaluate import OneSet


@with_options
def plan(
    job: JobSource,
    results: str | Path | None = None,
    search: str = DEFAULT_METHOD,
    changes: Iterable[str] = (),
    bound_draws: int | None = None,
    reuse: str | Path | Iterable[str | Path] = (),
    export: str | Path | None = None,
    against: "Mapping[str, OneSet] | Names | None" = None,
    **options: Unpack[Options],
) -> Run:
    """Find measurement times for a job's problem, and prove how good they are.

    One search finds them. They are compared with evenly spaced times on fresh draws. A lower bound
    proves how much better any other times can be. Quick estimates show how many evenly spaced
    measurements do as well, and what deciding on the way wins. The answer also has the error of an
    analysis afterwards, with all measurements. The same call resumes where it was stopped.

    Parameters
    ----------
    job : Problem, Job, str or Path
        A job file, as ``jobs/plan.toml``, or the folder of a run. Searches of the job are ignored.
    results : str or Path, optional
        Folder of the run; by default ``results/NAME`` of a job ``NAME.toml``, or
        ``results/NAME-plan`` if the job lists searches, or ``results/NAME-against``.
    search : str
        Method of the search. Its settings are keys of the job, as ``search.relaxation.paths=16``.
    changes : iterable of str, optional
        Other values of keys of the job, as ``seed=3 filter.particles=200``.
    bound_draws : int
        Draws of the lower bound, by default 480; 0 for no bound. For several numbers of
        measurements there is a bound only if this is given. One that would take more than about
        five minutes of a core is left out, and a line names the command that proves it.
    reuse : str, Path or iterable of these, optional
        Folders of other runs, whose evaluations are taken, not computed again; give it once for
        each.
    export : str or Path, optional
        Also write the plan into this file: ``.csv`` for a spreadsheet, ``.ics`` for a diary.
    against : mapping of str to iterable or str, or list of str, optional
        Was last year good? A table of its times, ``@last.csv``, or sets as for `pfdist.compare`,
        with which the plan is compared. Where the job counts measurements, the plan has as many as
        the first of these sets.
    options
        See `Options`.

    Returns
    -------
    Run

    Raises
    ------
    PfdistError
        As `pfdist.run` raises.
    """
    job = as_job(job, changes, sections=searched_by(search))
    ending = PLANNED if job.origin.names_searches else ""
    if against is not None:
        job, ending = of_as_many(job, against), AGAINST
    if export is not None:
        checked_export(export, job.problem.clock)
    results = folder_of(job, results, ending)
    draws = draws_of_bound(job, bound_draws)
    planned = run(job, results, bound_draws=draws, reuse=reuse, **options)
    if export is not None:
        planned.export(export)
    return planned


def of_as_many(job: Job, against: Any) -> Job:
    """The job that also compares sets of a user, and has as many measurements as the first."""
    from pfdist.questions.evaluate import instants_evaluated  # noqa: PLC0415  it loads pandas

    texts = [against] if isinstance(against, str) else against
    is_alone = isinstance(texts, (list, tuple)) and len(texts) == 1 and "=" not in str(texts[0])
    sets = {"last": texts[0]} if is_alone else sets_argument(against, "against")
    try:
        instants = {name: instants_evaluated(job, name, times) for name, times in sets.items()}
    except MeasurementTimesError as error:
        error.argument = "against"
        raise
    points, number = job.problem.points, len(next(iter(instants.values()), ()))
    written = {name: points.written_of(times) for name, times in instants.items()}
    if not number:
        raise JobError("against must name at least one time, as last=0,6,12", argument="against")
    is_counted = job.problem.measurement_budget is not None
    settings = {
        "comparison": {"sets": {**(job.comparison.sets or {}), **written}},
        "problem": {"measurement_budget": number} if is_counted else {},
    }
    return job.with_changes(settings=settings)


def draws_of_bound(job: Job, given: int | None) -> int:
    """Number of draws of a plan's bound: the given one, or the default."""
    return (0 if job.amounts else LEAST_DRAWS) if given is None else given
