"""A finished run, and its job built again, for questions that need the model once more."""

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pfdist.analysis import Run, open_run, read_recorded
from pfdist.api.following import silent
from pfdist.api.plan import plan
from pfdist.api.run import run as run_job
from pfdist.errors import JobError, RunMismatchError, StoreError, shown
from pfdist.job.job import Job, load_job
from pfdist.job.problem import Problem
from pfdist.meaning.chosen import ChosenModel
from pfdist.models import StateSpaceModel
from pfdist.runner.build import Built, build
from pfdist.runner.identity import changed_meanings
from pfdist.runner.named_by_a_run import NamedByRun

AskedRun = Run | Problem | Job | str | Path
"""A run, its folder, or the problem or job whose run is meant."""
Model = StateSpaceModel | str
"""A model as a user gives it: an object, or a name as in a job."""
_AS_DEFAULT: Mapping[str, Any] = MappingProxyType({})


def finished_run(asked: AskedRun, **options: Any) -> Run:
    """Give a run that is finished.

    Parameters
    ----------
    asked : Run, Problem, Job, str or Path
        A run or its folder. A problem, or a job without searches, means the run that `pfdist.plan`
        makes of it; a job with searches means that of `pfdist.run`. The function computes what
        this run lacks.
    options : object
        Arguments of `pfdist.run`, by name, for a problem or a job.

    Raises
    ------
    StoreError
        The folder holds no finished run.
    PfdistError
        As `pfdist.run` raises.
    """
    if isinstance(asked, Job) and asked.names_its_searches:
        return run_job(asked, **options)
    if isinstance(asked, Problem | Job):
        return plan(asked, bound_draws=0, **options)
    if not isinstance(asked, Run | str | Path):
        raise StoreError(
            "a run must be a pfdist.Run, its folder, a pfdist.Problem or a pfdist.Job, got "
            f"{shown(asked)}",
            argument="run",
        )
    opened = open_run(asked.path if isinstance(asked, Run) else asked)
    opened.models = asked.models if isinstance(asked, Run) else {}
    if opened.state != "finished":
        raise StoreError(f"{opened.path} is not finished ({opened.state}): run its job on first")
    return opened


def built_again(
    run: Run,
    instead: Mapping[str, Model],
    say: Callable[[str], Any] = silent,
    execution: Mapping[str, Any] = _AS_DEFAULT,
) -> Built:
    """Build the run's own job, and check that the models are those of the run.

    Parameters
    ----------
    run : Run
    instead : mapping of str to StateSpaceModel or str
        Models that the user gives, for the parts "model" and "filter_model"; an empty name: the
        run's own.
    say : callable
        Receives a line for each model file before the file is run.
    execution : mapping, optional
        Values of keys of [execution].

    Raises
    ------
    StoreError
        The model has changed since, or the run names a model file that is not run without the
        user's word, or was made with an object that is not given.
    ModelError
        The model cannot be loaded.
    """
    job = load_job(run.path / "job.toml", settings={"execution": execution})
    return built_as(job, run, instead, say)


def built_as(job: Job, run: Run, instead: Mapping[str, Model], say: Callable[[str], Any]) -> Built:
    """Build a job with the models of a run; see `built_again`.

    Parameters
    ----------
    job : Job
        The run's job; sections that leave the models as they are may be changed.
    run : Run
    instead, say
        As for `built_again`.
    """
    about, _ = read_recorded(run.path)
    given: dict[str, Model | ChosenModel] = {name: each for name, each in instead.items() if each}
    for name, each in given.items():
        if not isinstance(each, Model):
            raise JobError(
                f"{name} must be a StateSpaceModel or 'path/file.py:object', got {shown(each)}",
                argument=name,
            )
    remedy = "to have a model run that you trust, name it: {part} = FILE.py:OBJECT"
    choose = NamedByRun(run.path, about, {**run.models, **given}, say, remedy)
    built = build(job, choose)
    differences = changed_meanings(about, built)
    if differences:
        message = f"{run.path} is of another model than is there now: the run's -> this one's"
        raise RunMismatchError(message, tuple(f"{k}: {v}" for k, v in differences.items()))
    return built
