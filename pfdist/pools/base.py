"""The contract of pools, and the serial pool, which does all tasks in this process."""

import os
import platform
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Protocol, Self


@dataclass(frozen=True)
class Task:
    """One unit handed to a pool.

    Parameters
    ----------
    key : str
        Identifies the work: the same key means the same work.
    work : object
        The argument of the pool's function, which is pure.
    seconds : float
        The expected duration; 0 if it is unknown.
    """

    key: str
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
        Process id and host name.
    error : str or None
        The traceback, if it failed.
    """

    task: Task
    value: Any
    seconds: float
    worker: str
    node: str
    error: str | None = None


class Pool(Protocol):
    """Workers that apply one pure function; a context manager.

    The function is made in each worker by the callable the pool was created with, so that what
    is costly to send or cannot be sent (a compiled filter) never travels.
    """

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


def do(function: Callable[[Any], Any], task: Task) -> Outcome:
    """Do a task in this process. An exception becomes the outcome's error."""
    start = time.perf_counter()
    value, error = None, None
    try:
        value = function(task.work)
    except Exception:
        error = traceback.format_exc()
    seconds = time.perf_counter() - start
    return Outcome(task, value, seconds, str(os.getpid()), platform.node(), error)


class SerialPool:
    """One worker, this process.

    Parameters
    ----------
    make_function : callable
        Makes the function that is applied to each task's work.
    """

    workers = 1

    def __init__(self, make_function: Callable[[], Callable[[Any], Any]]) -> None:
        self._make_function = make_function
        self._function: Callable[[Any], Any] | None = None

    def __enter__(self) -> Self:
        self._function = self._make_function()
        return self

    def __exit__(self, *_: object) -> None:
        self._function = None

    def run(self, tasks: Iterable[Task | None]) -> Iterator[Outcome]:
        """Do the tasks one after another."""
        if self._function is None:
            raise RuntimeError("a pool runs tasks inside its with statement only")
        for task in tasks:
            if task is None:  # and none is in flight
                return
            yield do(self._function, task)
