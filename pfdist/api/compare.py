"""Compare named sets of times on common draws: hand-made schedules, and the sets of runs."""

from collections.abc import Iterable, Mapping
from pathlib import Path

from pfdist.analysis import Run, read_recorded
from pfdist.api.finished_run import Model, built_as, finished_run
from pfdist.api.following import Say, following, silent
from pfdist.api.run import Ending, run_built
from pfdist.api.sets_to_compare import SetsToCompare
from pfdist.common.arguments import path_argument
from pfdist.errors import JobError
from pfdist.job.asked import Asked, as_job
from pfdist.job.job import Job
from pfdist.runner.build import Built, build, check_pool
from pfdist.runner.identity import changed_meanings
from pfdist.runner.named_by_a_run import files_named
from pfdist.runner.progress import Show
from pfdist.times.clock import Time

Written = Iterable[Time | str] | str
"""Times as a user writes them, for instance [0, 3, 6] or "0:60:3"; "regular": regular times."""


def compare(
    job: Asked | Run,
    *runs: Run | str | Path,
    times: Mapping[str, Written] | None = None,
    results: str | Path | None = None,
    draws: int | None = None,
    changes: Iterable[str] = (),
    pool: str | None = None,
    workers: int | None = None,
    address: str | None = None,
    model: Model = "",
    filter_model: Model = "",
    figures: bool = True,
    report: bool | None = None,
    progress: Show | bool = False,
    say: Say = silent,
) -> Run:
    """Compare sets of times pairwise on common fresh draws, or resume their comparison.

    The comparison is a run of its own, without a search. `Run.pairs` and `Run.ranks` are its
    answers. All sets filter the same draws of the first problem. The first set is the reference of
    the gains.

    Parameters
    ----------
    job : Problem, Job, Run, str or Path
        A problem, a job, a job file, or a finished run or its folder. It gives the problem. Sets
        that a job gives are compared, too: a list of times as comparison.reference, and
        [comparison.sets]. So are all sets of a run: its reference first.
    runs : Run, str or Path
        Finished runs whose found sets are compared, too, and their references if they differ. A
        name that is already in use gets the name of the run's folder before it.
    times : mapping of str to iterable or str, optional
        Named sets: times on the clock of the first problem, or a text such as "0:60:3", or
        "regular" for its regular times. They may break constraints.
    results : str or Path, optional
        The folder of the comparison; by default ``results/<name>-compare`` with the name of the
        job file or of the first run's folder. The same call resumes what is there.
    draws : int, optional
        Replaces comparison.draws. A larger number resumes the comparison with more draws.
    changes : iterable of str, optional
        Changes ``key=value`` of the job, as `pfdist.load_job` takes them.
    pool, workers, address : optional
        Where to compute, as for `pfdist.run`.
    model, filter_model : StateSpaceModel or str, optional
        An object or ``path/file.py:object``: replaces what a run as `job` names for the model or
        for the filter's model. It is run without question, and must mean the same as the run's
        model.
    figures : bool
        Whether to draw the figures that the folder lacks.
    report : bool, optional
        Whether to write the file ``report.html``; by default if figures are drawn.
    progress : callable or bool
        Whether to show progress and messages, or what receives each
        `pfdist.runner.progress.Progress`.
    say : callable, optional
        Receives lines: each difference of a further run's model, horizon, weights of instants or
        costs from the first problem, each model file before it is run, and when the pool is ready.

    Returns
    -------
    Run

    Raises
    ------
    JobError, MeasurementTimesError
        There are fewer than two sets, a name is used twice, times are not those of the first
        problem, or `changes` change the sets of a run.
    PfdistError
        As `pfdist.run` raises. A folder that compares other sets is refused.
    """
    execution = {"pool": pool, "workers": workers, "address": address}
    settings = {"execution": execution, "comparison": {"draws": draws}}
    first, source = _problem_of(job)
    asked = as_job(source, changes, settings=settings)
    sets, others = SetsToCompare(asked), [finished_run(run) for run in runs]
    if first is None:
        sets.add_named()
    else:
        _check_that_sets_are_kept(asked, as_job(source))
        sets.add_run(first)
    for run in others:
        sets.add_run(run)
    sets.add_times(times or {})
    compared = sets.job()
    check_pool(compared.execution)
    name = asked.path.stem if first is None else first.path.absolute().name
    if results is not None:
        path_argument("results", results)
    path = Path("results") / f"{name}-compare" if results is None else Path(results)
    with following(progress, say) as (show, tell):
        if first is not None:
            built = built_as(compared, first, {"model": model, "filter_model": filter_model}, tell)
        else:
            if model or filter_model:
                raise JobError("model and filter_model need a run in the place of the job")
            for file in files_named(compared):
                tell(f"runs the model file {file}, which your job names")
            built = build(compared)
        for sentence in [*sets.differences, *_other_models(others, built)]:
            tell(sentence)
        ending = Ending(figures, figures if report is None else report)
        return run_built(built, path, ending, show, tell)


def _check_that_sets_are_kept(asked: Job, job_of_run: Job) -> None:
    """Refuse changes of the sets that a job gives where a run gives the sets."""
    for key in ("reference", "sets"):
        if getattr(asked.comparison, key) != getattr(job_of_run.comparison, key):
            raise JobError(
                f"changes must leave comparison.{key} as it is where a run gives the problem and "
                "its sets, got another value: name sets with times",
                argument="changes",
            )


def _other_models(runs: Iterable[Run], built: Built) -> list[str]:
    """Say which runs have other models than the first problem."""
    found = []
    for run in runs:
        changes = changed_meanings(read_recorded(run.path)[0], built)
        if changes:
            found.append(
                f"{run.path} has another problem than the first: its model differs in "
                f"{', '.join(changes)}"
            )
    return found


def _problem_of(job: Asked | Run) -> tuple[Run | None, Asked]:
    """Give the run that stands in the place of a job, or None, and the job or the job's file."""
    is_folder = isinstance(job, str | Path) and Path(job).is_dir()
    if not is_folder and not isinstance(job, Run):
        return None, job
    run = finished_run(job)
    return run, run.path / "job.toml"
