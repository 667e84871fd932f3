"""Compare named sets of times on common draws: hand-made schedules, and the sets of runs."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Unpack

from pfdist.analysis import Run, read_recorded
from pfdist.api.following import following
from pfdist.api.options import Chosen, Options, with_options
from pfdist.api.run import Ending, run_built
from pfdist.api.run_of_job import finished_run, folder_of
from pfdist.api.sets_to_compare import SetsToCompare
from pfdist.job.asked import Asked, as_job
from pfdist.runner.build import Built, build, check_pool, say_model_files
from pfdist.runner.identity import changed_fingerprints
from pfdist.times.clock import Time

Written = Iterable[Time | str] | str
"""Times as a user writes them, for instance [0, 3, 6] or "0:60:3"; "regular": regular times."""


@with_options
def compare(
    job: Asked,
    *runs: Run | str | Path,
    times: Mapping[str, Written] | None = None,
    results: str | Path | None = None,
    draws: int | None = None,
    changes: Iterable[str] = (),
    **options: Unpack[Options],
) -> Run:
    """Compare sets of times pairwise on common fresh draws, or resume their comparison.

    The comparison is a run of its own, without a search. `Run.pairs` and `Run.ranks` are its
    answers. All sets filter the same draws of the job's problem. The first set is the reference of
    the gains.

    Parameters
    ----------
    job : Problem, Job, str or Path
        A problem, a job, or the path of a job file. It gives the problem. Sets that the job gives
        are compared, too: a list of times as comparison.reference, and [comparison.sets].
    runs : Run, str or Path
        Finished runs, or their folders, whose sets are compared, too: the found sets, and the
        references if they differ. The runs are only read. A name that is already in use gets the
        name of the run's folder before it.
    times : mapping of str to iterable or str, optional
        Named sets: times on the clock of the problem, or a text such as "0:60:3", or "regular" for
        its regular times. They may break constraints.
    results : str or Path, optional
        The folder of the comparison; by default ``results/<the job file's stem>-compare``. The same
        call resumes what is there.
    draws : int, optional
        Replaces comparison.draws. A larger number resumes the comparison with more draws.
    changes : iterable of str, optional
        Changes ``key=value`` of the job, as `pfdist.load_job` takes them.
    options
        See `Options`.

    Returns
    -------
    Run

    Raises
    ------
    JobError, MeasurementTimesError
        There are fewer than two sets, a name is used twice, or times are not those of the problem.
    PfdistError
        As `pfdist.run` raises. A folder that compares other sets is refused.
    """
    chosen = Chosen(**options)
    settings = {"execution": chosen.execution, "comparison": {"draws": draws}}
    asked = as_job(job, changes, settings=settings)
    sets, opened = SetsToCompare(asked), [finished_run(run) for run in runs]
    sets.add_named()
    for run in opened:
        sets.add_run(run)
    sets.add_times(times or {})
    compared = sets.job()
    check_pool(compared.execution)
    path = folder_of(asked, results, "-compare")
    with following(chosen.progress, chosen.say) as (show, tell):
        say_model_files([compared], tell)
        built = build(compared)
        for sentence in [*sets.differences, *_other_models(opened, built)]:
            tell(sentence)
        ending = Ending(chosen.figures, chosen.has_report)
        return run_built(built, path, ending, show, tell)


def _other_models(runs: Iterable[Run], built: Built) -> list[str]:
    """Say which runs have other models than the job."""
    found = []
    for run in runs:
        changes = changed_fingerprints(read_recorded(run.path)[0], built)
        if changes:
            found.append(
                f"{run.path} has another problem than the first: its model differs in "
                f"{', '.join(changes)}"
            )
    return found
