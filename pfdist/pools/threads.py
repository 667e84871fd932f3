"""A pool of threads in the driver's process. Compiled filters release Python's lock."""

import contextlib
import sys
import time
import warnings
from collections.abc import Iterable, Iterator
from itertools import islice
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Self

from pfdist.common.stopping import check
from pfdist.errors import EngineWarning
from pfdist.pools import base
from pfdist.pools.base import Outcome, Task, do
from pfdist.pools.cores import usable_cores

LONG_SECONDS = 60.0  # after which a warning says what runs
IN_FLIGHT = 2  # tasks of a thread: the one that it does, and the next
_LEAVE_SECONDS = 0.5
# A thread that has filtered waits so long for Python's lock while the driver computes. By default
# Python lets it wait for 5 ms, several times a task.
_SWITCH_SECONDS = 0.0005


class ThreadPool:
    """A pool of threads of this process; without a number, one for each core that it may use.

    A formula that crashes ends the whole process. A thread that hangs cannot be stopped, nor told
    from a slow one on a busy machine. So a warning says what runs, and Ctrl-C ends the run. The
    thread itself ends with the process.
    """

    def __init__(self, workers: int = 0) -> None:
        self.workers = workers or usable_cores()
        self._threads: list[_Worker] = []
        self._todo = SimpleQueue[_Handed | None]()
        self._switch_seconds = sys.getswitchinterval()

    def __enter__(self) -> Self:
        sys.setswitchinterval(_SWITCH_SECONDS)
        self._threads = [_Worker(self._todo, number) for number in range(self.workers)]
        return self

    def __exit__(self, *_: object) -> None:
        sys.setswitchinterval(self._switch_seconds)
        self._forget_tasks()
        threads, self._threads = self._threads, []
        for _each in threads:
            self._todo.put(None)
        deadline = time.monotonic() + _LEAVE_SECONDS
        for thread in threads:
            thread.join(max(0.0, deadline - time.monotonic()))

    def run(self, tasks: Iterable[Task]) -> Iterator[Outcome]:
        """Yield the outcomes as threads finish tasks, with a bounded number in flight."""
        self._forget_tasks()  # an earlier run may have been broken off
        todo, answers, in_flight = iter(tasks), SimpleQueue[Outcome](), 0
        while True:
            for task in islice(todo, IN_FLIGHT * self.workers - in_flight):
                self._todo.put((task, answers))
                in_flight += 1
            if not in_flight:
                return
            check()
            try:
                outcome = answers.get(timeout=base.WAIT_SECONDS)
            except Empty:
                self._warn_of_long_tasks()
            else:
                in_flight -= 1
                yield outcome

    def _warn_of_long_tasks(self) -> None:
        """Warn of each task that has run for a minute, for two, for four, and so on."""
        for thread in self._threads:
            # The thread writes `begun`, then `task`. Read in reverse order, `begun` belongs to this
            # task or to a later one.
            task = thread.task
            seconds = time.monotonic() - thread.begun
            if task is not None and seconds > thread.warns_after:
                thread.warns_after *= 2
                warnings.warn(
                    f"task {task.key} has run for {seconds:.0f} s on a thread; Ctrl-C ends the run",
                    EngineWarning,
                    stacklevel=3,
                )

    def _forget_tasks(self) -> None:
        """Forget tasks that no thread has begun; the answers of the others are ignored."""
        with contextlib.suppress(Empty):
            while True:
                self._todo.get_nowait()


_Handed = tuple[Task, SimpleQueue[Outcome]]


class _Worker(Thread):
    """A thread that does tasks. It does not keep the process from ending."""

    def __init__(self, todo: "SimpleQueue[_Handed | None]", number: int) -> None:
        super().__init__(daemon=True)
        self._todo, self._number = todo, number
        self.task: Task | None = None
        self.begun, self.warns_after = time.monotonic(), LONG_SECONDS
        self.start()

    def run(self) -> None:
        while (handed := self._todo.get()) is not None:
            task, answers = handed
            self.begun, self.warns_after, self.task = time.monotonic(), LONG_SECONDS, task
            value, seconds, process, node, error = do(task.function, task.work)
            self.task = None
            worker = f"{process}-{self._number}"
            answers.put(Outcome(task, value, seconds, worker, node, error))
