"""The run of a job: its folder, and a finished run as the subject of a question."""

import contextlib
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pfdist.common.arguments import path_argument
from pfdist.errors import JobError, RunMismatchError, StoreError
from pfdist.problem.job import Job
from pfdist.problem.problem import JobSource, as_job
from pfdist.results import Run, open_run
from pfdist.results.stored_run import job_of
from pfdist.runner.build import Built, build, say_model_files
from pfdist.runner.identity import check_same_job, check_same_models, opened, store_of
from pfdist.runner.progress import Say, heard
from pfdist.runner.provenance import note_machine
from pfdist.store import Store, folder_of_run, holds_run

_AS_DEFAULT: Mapping[str, Any] = MappingProxyType({})
PLANNED = "-plan"
"""Ending of the folder of a plan, if the job lists searches, whose run has the folder without."""
AGAINST = "-against"
"""Ending of the folder of a plan of as many measurements as a user's set."""


def folder_of(job: Job, results: str | Path | None, ending: str = "") -> Path:
    """The folder of a job's run.

    Parameters
    ----------
    job : Job
    results : str, Path or None
        The folder that the user names.
    ending : str
        The end of the folder's name, after the name of the job's run.
    """
    if results is not None:
        return path_argument("results", results)
    own = folder_of_run(job.path).absolute()
    return own.with_name(f"{own.name}{ending}")


def searched_by(method: str) -> dict[str, Any]:
    """The sections of a job with one search instead of those that it lists."""
    return {"search": [{"method": method}]}


def finished_run(run: Run | str | Path, command: str = "") -> Run:
    """A run that is finished.

    Parameters
    ----------
    run : Run, str or Path
        A run or its folder.
    command : str
        The command that resumes it, for the error; by default ``pfdist run`` and the folder.

    Raises
    ------
    StoreError
        The folder holds no finished run.
    """
    opened = open_run(run.path if isinstance(run, Run) else run)
    if opened.state != "finished":
        raise StoreError(
            f"{opened.path} is not finished ({opened.state}): resume it first, "
            f"{command or f'`pfdist run {opened.path}`'}"
        )
    return opened


def run_and_job(
    source: JobSource | Run,
    results: str | Path | None,
    changes: Iterable[str],
    say: Say,
    execution: Mapping[str, Any] = _AS_DEFAULT,
) -> tuple[Run, Built]:
    """The finished run of a job, and the job with its models, for a question about the run.

    Parameters
    ----------
    source : Problem, Job, str, Path or Run
        A problem, a job, the path of a job file or of the run's folder, or a run.
    results : str, Path or None
        Folder of the run. By default it is the folder where `pfdist.run` and `pfdist.plan` put the
        run of the job. If a job that lists searches has been planned but not run, it is the plan.
    changes : iterable of str
        Changes ``key=value`` of the job.
    say : callable
        Receives a line for each model file before the file is run.
    execution : mapping, optional
        Values of keys of [execution].

    Raises
    ------
    StoreError
        There is no finished run of the job, or the run is of another job or of other models.
    ModelError
        A model cannot be loaded.
    """
    if isinstance(source, Run):
        results = source.path if results is None else results
        source = job_of(source) or source.path
    job = as_job(source)
    path = path_of_run(job, results)
    if path is None:
        raise _no_run(job, results)
    is_planned = job.origin.is_file and not job.origin.names_searches
    run = finished_run(path, _call(job, results, "plan") if is_planned else "")
    return run, built_for_run(run, source, changes, say, execution)


def built_for_run(
    run: Run,
    source: JobSource,
    changes: Iterable[str],
    say: Say,
    execution: Mapping[str, Any] = _AS_DEFAULT,
) -> Built:
    """The job of a run with its models; raises a `RunMismatchError` if they are not those."""
    settings = {"execution": execution, **_of_sets(run)}
    job = _job_of(run, partial(as_job, source, changes, settings=settings))
    check_same_job(run.path, run.job, job)
    say_model_files([job], say)
    codes = job.problem.measurements  # which are not part of a run
    read = {"problem": {"measurements": codes and codes.model_dump()}}
    # With the draws of the run.
    built = build(job.with_changes(sections=run.job, settings=read), run.path)
    check_same_models(run.path, built)
    return built


def path_of_run(job: Job, results: str | Path | None = None) -> Path | None:
    """The folder of a job's run, or else of its plan, or of that against a set; None without."""
    endings = ("", PLANNED, AGAINST) if job.origin.names_searches else ("", AGAINST)
    folders = (folder_of(job, results, ending) for ending in endings)
    return next(filter(holds_run, folders), None)


def _of_sets(run: Run) -> dict[str, Any]:
    """The sets and the number that `pfdist plan --against` has added to the job of its run."""
    if not run.path.name.endswith(AGAINST):
        return {}
    keys = {"comparison": "sets", "problem": "measurement_budget"}
    return {section: {key: run.job[section].get(key)} for section, key in keys.items()}


def _job_of(run: Run, job_with: Callable[..., Job]) -> Job:
    """The job with the one search of its plan if the run is a plan, else with its own searches."""
    searches = run.job["search"]
    if len(searches) == 1:
        with contextlib.suppress(JobError):
            planned = job_with(sections=searched_by(searches[0]["method"]))
            if planned.identity()["search"] == searches:
                return planned
    return job_with()


def _no_run(job: Job, results: str | Path | None) -> StoreError:
    """The error about a missing run: its possible folders, and the command that makes it."""
    origin = job.origin
    command, endings = ("run", ("", PLANNED)) if origin.names_searches else ("plan", ("",))
    folders = dict.fromkeys(str(folder_of(job, results, ending)) for ending in endings)
    call = _call(job, results, command) if origin.is_file else f"pfdist.{command}(problem)"
    return StoreError(f"there is no run of this job in {' or '.join(folders)}: {call} makes it")


def _call(job: Job, results: str | Path | None, command: str) -> str:
    option = "" if results is None else f" --results {results}"
    return f"`pfdist {command} {job.path}{option}`"


@contextlib.contextmanager
def own_store(
    run: Run, built: Built, say: Callable[[str], Any], *, must_be: bool = True
) -> Iterator[Store]:
    """The run's own store, or a temporary store if another version computed the run.

    Parameters
    ----------
    run : Run
    built : Built
    say : callable
        Receives a line if nothing is stored in the run's folder.
    must_be : bool
        Whether the folder must be writable; otherwise a temporary store replaces it.

    Raises
    ------
    StoreError
        Another process computes the run, or the folder cannot be read or written.
    """
    with contextlib.ExitStack() as stack:
        try:
            store = stack.enter_context(opened(run.path, built))
            note_machine(run.path, built, say)
        except RunMismatchError as error:
            difference, *_ = error.differences
            line = (
                f"{run.path} is of another program ({difference}): the answer is not stored there"
            )
            heard(say, line)
            store = _elsewhere(stack, built)
        except StoreError as error:
            if must_be:
                raise
            heard(say, f"the answer is not stored in the run: {error}")
            store = _elsewhere(stack, built)
        yield store


def _elsewhere(stack: contextlib.ExitStack, built: Built) -> Store:
    return store_of(built, Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="pfdist-"))))
