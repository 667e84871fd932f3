"""A pool of processes on this machine, for formulas that hold Python's lock or may crash."""

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from functools import lru_cache
from itertools import islice
from types import ModuleType
from typing import Any, Self

from pfdist.common.stopping import check
from pfdist.errors import PoolError
from pfdist.pools.base import WAIT_SECONDS, Outcome, Silence, Task, patience
from pfdist.pools.cores import usable_cores
from pfdist.pools.workers import (
    FUNCTIONS,
    Answer,
    Sent,
    answer_task,
    failed,
    pickled,
    silence_limit,
)

_SPAWN = multiprocessing.get_context("spawn")  # a fork of a process with threads may hang
_IGNORED = (signal.SIGHUP, signal.SIGINT, signal.SIGUSR1, signal.SIGUSR2)


class ProcessPool:
    """A pool of processes; without a number, one for each core that this process may use.

    If a process dies, all tasks in flight run again, one at a time, so that a second death
    identifies the faulty task.
    """

    def __init__(self, workers: int = 0) -> None:
        self.workers = workers or usable_cores()
        self._processes = _Processes(self.workers)
        self._pickled = lru_cache(maxsize=FUNCTIONS)(pickled)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._processes.end()

    def run(self, tasks: Iterable[Task]) -> Iterator[Outcome]:
        """Yield the outcomes in any order, with two tasks for each process in flight.

        Raises `PoolError` if no process can start, and `SilenceError` if none answers.
        """
        todo, in_flight, suspects = iter(tasks), dict[Future[Answer], Sent](), list[Task]()
        silence = Silence()
        while True:
            handed = suspects if suspects else todo
            room = (1 if suspects else 2 * self.workers) - len(in_flight)
            for task in islice(handed, max(0, room)):
                in_flight[self._submit(task)] = Sent(task, time.monotonic())
            if not in_flight:
                return
            done, _ = wait(in_flight, WAIT_SECONDS, FIRST_COMPLETED)
            lost, has_begun = list[Sent](), False
            for each in done:
                check()
                sent, error = in_flight.pop(each), each.exception()
                silence.end()
                if isinstance(error, BrokenProcessPool):
                    lost.append(sent)
                    has_begun |= not isinstance(error, _NotBegunError)
                    continue
                del suspects[:1]
                yield failed(sent, error) if error else Outcome(sent.task, *each.result())
            if lost:
                lost += in_flight.values()
                in_flight.clear()
                self._start_again()
                if len(lost) > 1 or not has_begun:
                    suspects = [sent.task for sent in lost]
                    continue
                del suspects[:1]
                yield failed(lost[0])
            if not done:
                check()
                silence.check(silence_limit(in_flight.values()), "any process")

    def _submit(self, task: Task) -> "Future[Answer]":
        key, content = self._pickled(task.function)
        try:
            return self._processes.submit(key, content, task.work, patience(task.seconds))
        except BrokenProcessPool:  # since the last answer: this task has not begun
            lost = Future[Answer]()
            lost.set_exception(_NotBegunError())
            return lost

    def _start_again(self) -> None:
        if not self._processes.ids():
            raise PoolError("no process can start; is there enough memory?", argument="pool")
        self._processes.end()
        self._processes = _Processes(self.workers)


class _NotBegunError(BrokenProcessPool):
    """The processes have died before this task was sent to them."""


class _Processes:
    """So many processes, which start with the first task."""

    def __init__(self, count: int) -> None:
        self._started, started = _SPAWN.Pipe(duplex=False)
        ended, self._alive = _SPAWN.Pipe(duplex=False)  # closes with the pool, or with this process
        blocked = signal.pthread_sigmask(signal.SIG_BLOCK, [])
        try:
            self._executor = ProcessPoolExecutor(count, _SPAWN, _begin, (started, ended))
        finally:  # Python unblocks SIGINT and SIGTERM when it starts its tracker of semaphores
            signal.pthread_sigmask(signal.SIG_SETMASK, blocked)
        self._ids = set[int]()

    def submit(self, *given: Any) -> "Future[Answer]":
        """Submit a task; a `BrokenProcessPool` says that a process has died."""
        with _hidden_script():
            return self._executor.submit(_do, *given)

    def ids(self) -> set[int]:
        """Ids of the processes, which they report when they start."""
        while self._started.poll():
            self._ids.add(self._started.recv())
        return self._ids

    def end(self) -> None:
        """End the processes: those that have not reported yet by themselves, the others at once."""
        self._executor.shutdown(wait=False, cancel_futures=True)
        self._alive.close()
        own = self.ids()
        for process in multiprocessing.active_children():
            if process.pid in own:
                process.kill()


@contextlib.contextmanager
def _hidden_script() -> Iterator[None]:
    """Let processes that start here not run the user's script again: functions travel by value."""
    script = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = script


def _begin(started: Any, ended: Any) -> None:
    """Begin a process, and report its id; it ends with the pool."""
    for number in _IGNORED:  # a terminal or a batch system sends them to all processes
        signal.signal(number, signal.SIG_IGN)
    threading.Thread(target=_end_with_pool, args=[ended], daemon=True).start()
    with contextlib.suppress(OSError):  # the pool has ended
        started.send(os.getpid())


def _end_with_pool(ended: Any) -> None:
    with contextlib.suppress(EOFError, OSError):
        ended.recv()
    os._exit(1)


def _do(key: str, content: bytes, work: Any, most: float) -> Answer:
    return answer_task(key, lambda: content, work, most)
