"""A finished run, and its job built again, for questions that need the model once more."""

from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pfdist.analysis import Run, open_run, read_recorded
from pfdist.errors import RunMismatchError, StoreError
from pfdist.job.job import load_job
from pfdist.runner.build import Built, build
from pfdist.runner.identity import changed_meanings
from pfdist.runner.named_by_a_run import NamedByRun

_AS_DEFAULT: Mapping[str, Any] = MappingProxyType({})


def finished_run(run: str | Path) -> Run:
    """Open a run that is finished.

    Raises
    ------
    StoreError
        The folder holds no finished run.
    """
    opened = open_run(run)
    if opened.state != "finished":
        raise StoreError(f"{opened.path} is not finished ({opened.state}): run its job on first")
    return opened


def built_again(
    run: Run,
    instead: Mapping[str, str],
    say: Callable[[str], Any],
    execution: Mapping[str, Any] = _AS_DEFAULT,
) -> Built:
    """Build the run's own job, and check that the models are those of the run.

    Parameters
    ----------
    run : Run
    instead : mapping of str to str
        Models that the user names, for the parts "model" and "filter_model"; empty: the run's own.
    say : callable
        Receives a line for each model file before the file is run.
    execution : mapping, optional
        Values of keys of [execution].

    Raises
    ------
    StoreError
        The model has changed since, or the run names a model file that is not run without the
        user's word.
    ModelError
        The model cannot be loaded.
    """
    about, _ = read_recorded(run.path)
    remedy = "to have a model run that you trust, name it: {part} = FILE.py:OBJECT"
    choose = NamedByRun(run.path, about, instead, say, remedy)
    settings = {"execution": dict(execution)} if execution else {}
    built = build(load_job(run.path / "job.toml", settings=settings), choose)
    differences = changed_meanings(about, built)
    if differences:
        message = f"{run.path} is of another model than is there now: the run's -> this one's"
        raise RunMismatchError(message, tuple(f"{k}: {v}" for k, v in differences.items()))
    return built
