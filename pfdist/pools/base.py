"""The contract of pools, and the serial pool, which runs all tasks in this process."""

import os
import platform
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any, Protocol, Self

from pfdist.common.stopping import check
from pfdist.errors import SilenceError

Function = Callable[[Any], Any]

# A task may compute, or sleep, for so many seconds, and so many times its expected duration:
PATIENCE_SECONDS = 15.0
PATIENCE_TIMES = 20
WAIT_SECONDS = 0.2  # for an answer, before the pool looks whether a signal was received
STILL_SECONDS = 5.0  # between two looks: after longer, this process itself was stopped or busy


def patience(seconds: float) -> float:
    """The limit, in seconds, of a task that is expected to take so many seconds.

    It limits the processor time, and the time in which the task does not compute. So no task is
    ended because the machine is busy.
    """
    return max(PATIENCE_SECONDS, PATIENCE_TIMES * seconds)


@dataclass(frozen=True)
class Task:
    """One unit handed to a pool."""

    key: str  # the same key means the same work
    # Pure. A worker in another process gets it pickled, once for all its tasks. So it makes costly
    # things when it is unpickled, before any task.
    function: Function = field(repr=False)
    work: Any
    seconds: float = 0.0  # expected duration; 0 if it is unknown


@dataclass(frozen=True)
class Outcome:
    """The result of a task."""

    task: Task
    value: Any  # of the function; None if it failed
    seconds: float  # in the worker
    worker: str  # process id, with the name of the thread if there are several
    node: str  # host name
    error: str | None = None  # the traceback, if the function failed
    refused: bool = False  # whether no worker can make the function; `error` says why


class Silence:
    """Seconds without an answer, not counting those in which this process was suspended."""

    def __init__(self) -> None:
        self.seconds, self._looked = 0.0, time.monotonic()

    def end(self) -> None:
        """Restart the count after an answer."""
        self.seconds = 0.0

    def check(self, most: float, who: str = "any worker") -> None:
        """Raise a `SilenceError` if more than so many seconds have passed."""
        now = time.monotonic()
        passed, self._looked = now - self._looked, now
        self.seconds += passed if passed < STILL_SECONDS else 0.0
        if self.seconds > most:
            raise SilenceError(f"no answer from {who} for {self.seconds:.0f} s")


class Pool(AbstractContextManager["Pool"], Protocol):
    """Workers that run tasks; a context manager."""

    workers: int

    def run(self, tasks: Iterable[Task]) -> Iterator[Outcome]:
        """Yield the outcomes in any order; tasks are taken from the iterable only as needed."""


def do(function: Function, work: Any) -> tuple[Any, float, str, str, str | None]:
    """The fields of an `Outcome` from value to error: the function runs in this process."""
    start = time.perf_counter()
    value, error = None, None
    try:
        value = function(work)
    except Exception:
        error = traceback.format_exc()
    seconds = time.perf_counter() - start
    return value, seconds, str(os.getpid()), platform.node(), error


class SerialPool:
    """A pool with one worker, this process."""

    workers = 1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def run(self, tasks: Iterable[Task]) -> Iterator[Outcome]:
        """Yield the outcomes of the tasks, which run one after another."""
        for task in tasks:
            check()
            yield Outcome(task, *do(task.function, task.work))
