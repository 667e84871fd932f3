"""Work of several runs in the same workers: each task says which evaluator it needs."""

import pickle
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from pfdist.evaluation.evaluator import Evaluator
from pfdist.evaluation.work import Result, Work
from pfdist.runner.door import Session
from pfdist.runner.evaluator_source import EvaluatorSource

_KEPT = 32  # evaluators in a worker; fewer runs are computed at the same time


@dataclass(frozen=True)
class WorkOfRun:
    """The works of a task, with the evaluator of their run.

    Parameters
    ----------
    source : bytes
        The pickled `EvaluatorSource`: it is pickled once for all tasks of the run.
    works : tuple of Work
    """

    source: bytes
    works: tuple[Work, ...]


def of_run() -> Callable[[Session, tuple[Work, ...]], WorkOfRun]:
    """The function that adds the evaluator of a run to the works of its tasks."""
    contents = dict[Session, bytes]()

    def wrapped(session: Session, works: tuple[Work, ...]) -> WorkOfRun:
        if session not in contents:
            contents[session] = pickle.dumps(session.built.source)
        return WorkOfRun(contents[session], works)

    return wrapped


def worker_of_runs() -> Callable[[WorkOfRun], list[Result]]:
    """Give the function that a worker applies to the works of any run."""
    return _results


def _results(work: WorkOfRun) -> Any:
    return _evaluator(work.source).results(work.works)


@lru_cache(maxsize=_KEPT)
def _evaluator(source: bytes) -> Evaluator:
    found: EvaluatorSource = pickle.loads(source)  # noqa: S301  the driver made it
    return found.compiled()
