"""The contract of pools, and the serial pool, which does all tasks in this process."""

import os
import platform
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Protocol, Self

Function = Callable[[Any], Any]

PATIENCE_SECONDS = 15.0  # a worker is taken for lost when it is silent for so long, and for
PATIENCE_TIMES = 20  # so many times what its task should take
LOOK_SECONDS = 1.0  # between two looks for those that are silent
PAUSE_SECONDS = 0.01  # before tasks are asked for again, where there were none at the moment
STILL_SECONDS = 5.0  # without a look: this process itself was stopped, or had other things to do


def patience(seconds: float) -> float:
    """Seconds for which a worker may be silent whose task should take so many seconds."""
    return max(PATIENCE_SECONDS, PATIENCE_TIMES * seconds)


@dataclass(frozen=True)
class Task:
    """One unit handed to a pool.

    Parameters
    ----------
    key : str
        Identifies the work: the same key means the same work.
    function : callable
        Is applied to the work, and is pure. A worker in another process gets it pickled, once for
        all its tasks: what is costly to make there is made when it is unpickled, before any task.
    work : object
    seconds : float
        The expected duration; 0 if it is unknown.
    """

    key: str
    function: Function = field(repr=False)
    work: Any
    seconds: float = 0.0


@dataclass(frozen=True)
class Outcome:
    """The result of a task.

    Parameters
    ----------
    task : Task
    value : object or None
        The function's value; None if it failed.
    seconds : float
        In the worker.
    worker, node : str
        Process id, with the name of the thread if there are several, and host name.
    error : str or None
        The traceback, if it failed.
    refused : bool
        Whether the worker could not make the function, and no other worker can; `error` is why.
    """

    task: Task
    value: Any
    seconds: float
    worker: str
    node: str
    error: str | None = None
    refused: bool = False


class Pool(Protocol):
    """Workers that do tasks; a context manager."""

    workers: int

    def run(self, tasks: Iterable[Task | None]) -> Iterator[Outcome]:
        """Give the outcomes in any order; tasks are taken from the iterable only as needed.

        None in the place of a task says that there is none at the moment. The pool asks again while
        a task is in flight, and ends when none is.
        """

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...


def do(function: Function, work: Any) -> tuple[Any, float, str, str, str | None]:
    """Apply a function in this process; an exception becomes a text.

    Returns
    -------
    value, seconds, worker, node, error
        As in `Outcome`.
    """
    start = time.perf_counter()
    value, error = None, None
    try:
        value = function(work)
    except Exception:
        error = traceback.format_exc()
    seconds = time.perf_counter() - start
    return value, seconds, str(os.getpid()), platform.node(), error


class SerialPool:
    """One worker, this process."""

    workers = 1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def run(self, tasks: Iterable[Task | None]) -> Iterator[Outcome]:
        """Do the tasks one after another."""
        for task in tasks:
            if task is None:  # and none is in flight
                return
            yield Outcome(task, *do(task.function, task.work))
