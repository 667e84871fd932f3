"""A pool that several threads share: no worker idles while one of them has a task.

Each thread is a member with tasks of its own. The thread that entered the pool hands out the tasks:
those of the first member first, so that the first members end first. It alone uses the pool.
"""

import queue
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, ExitStack
from dataclasses import replace
from types import TracebackType
from typing import Any, Self

from pfdist.pools.base import Outcome, Pool, Task

_WAIT_SECONDS = 0.2  # the serving thread looks for signals so often, while there is no task
_QUEUED = 2  # tasks of a member for each worker: the one it does and the one that waits for it


class SharedPool:
    """A pool whose workers serve several members; a context manager.

    Parameters
    ----------
    pool : context manager
        Gives an entered pool. It is entered when the first member needs it, and left with the
        shared pool.
    """

    def __init__(self, pool: AbstractContextManager[Pool]) -> None:
        self._to_enter = pool
        self._entered = ExitStack()
        self._pool: Pool | None = None
        self._workers = 0
        self._wanted, self._ready = False, threading.Event()
        self._members: list[Member] = []
        self._owners: dict[str, Member] = {}  # of the tasks in flight, by their keys
        self._changed = threading.Condition()
        self._failure: BaseException | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._entered.__exit__(kind, error, trace)

    def join(self, rank: int, wrapped: Callable[[Any], Any]) -> "Member":
        """Let a thread have tasks done, after those of members with a lower rank.

        Parameters
        ----------
        rank : int
            No two members have the same.
        wrapped : callable
            Makes the argument of the pool's function from the work of a task.

        Raises
        ------
        BaseException
            The error with which the pool has failed.
        """
        with self._changed:
            self._wanted = True
            self._changed.notify_all()
        self._ready.wait()
        self.check()
        with self._changed:
            member = Member(self, rank, self._workers, wrapped)
            self._members = sorted([*self._members, member], key=lambda each: each.rank)
        return member

    def serve(self, is_over: Callable[[], bool]) -> None:
        """Hand out tasks of all members, as they come; it may be called again for other members.

        Parameters
        ----------
        is_over : callable
            Whether no member will have another task; `wake` has it asked at once.

        Raises
        ------
        PoolError
            No worker answers. Every member gets this error, too.
        """
        try:
            self._wait(lambda: self._wanted or is_over())
            if self._pool is None and not is_over():
                self._pool = self._entered.enter_context(self._to_enter)
                self._workers = self._pool.workers
                self._ready.set()
            while self._pool is not None and not is_over():
                for outcome in self._pool.run(self._tasks()):
                    self._deliver(outcome)
                self._wait(lambda: any(each.queued for each in self._members) or is_over())
        except BaseException as error:
            self.fail(error)
            raise
        self.check()

    def _wait(self, until: Callable[[], bool]) -> None:
        with self._changed:
            while not until():
                self._changed.wait(_WAIT_SECONDS)

    def wake(self) -> None:
        """Have `serve` ask at once whether all is over."""
        with self._changed:
            self._changed.notify_all()

    def fail(self, error: BaseException) -> None:
        """End the work of every member with an error."""
        with self._changed:
            self._failure = self._failure or error
            self._ready.set()
            for member in self._members:
                member.answers.put(None)

    def check(self) -> None:
        """Raise the error that has ended the work of every member, if there is one."""
        if self._failure is not None:
            raise self._failure

    @property
    def failure(self) -> BaseException | None:
        """The error that has ended the work of every member; None if it goes on."""
        return self._failure

    def add(self, member: "Member", task: Task) -> None:
        """Take a task of a member."""
        with self._changed:
            member.queued.append(task)
            self._changed.notify_all()

    def leave(self, member: "Member") -> None:
        """Forget a member, with the tasks that it does not wait for any more."""
        self.forget(member)
        with self._changed:
            self._members.remove(member)

    def forget(self, member: "Member") -> None:
        """Forget the tasks of a member that stopped waiting; it may have others later."""
        with self._changed:
            member.queued.clear()
            self._owners = {key: each for key, each in self._owners.items() if each is not member}

    def _tasks(self) -> Iterator[Task | None]:
        while True:
            with self._changed:
                owner = next((member for member in self._members if member.queued), None)
                task = owner.queued.popleft() if owner is not None else None
                if owner is not None and task is not None:
                    self._owners[task.key] = owner
            yield task

    def _deliver(self, outcome: Outcome) -> None:
        with self._changed:
            owner = self._owners.pop(outcome.task.key, None)
        if owner is not None:
            owner.answers.put(outcome)


class Member:
    """The pool as one of its members sees it; `pfdist.pools.base.Pool` describes it.

    Parameters
    ----------
    shared : SharedPool
    rank, workers : int
    wrapped : callable

    Attributes
    ----------
    queued : deque of Task
        Tasks that no worker has yet.
    answers : Queue of Outcome or None
        Outcomes that the member has not taken yet; None if the pool has failed.
    """

    def __init__(
        self, shared: SharedPool, rank: int, workers: int, wrapped: Callable[[Any], Any]
    ) -> None:
        self.workers = workers
        self.rank, self._shared, self._wrapped = rank, shared, wrapped
        self._runs = 0
        self.queued: deque[Task] = deque()
        self.answers: queue.SimpleQueue[Outcome | None] = queue.SimpleQueue()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._shared.leave(self)

    def run(self, tasks: Iterable[Task | None]) -> Iterator[Outcome]:
        """Give the outcomes in any order; few tasks at a time wait for a worker.

        Raises
        ------
        BaseException
            The error with which the pool has failed.
        """
        self._runs += 1
        self.answers = queue.SimpleQueue()  # late answers of a run that was broken off are ignored
        todo, waiting = iter(tasks), dict[str, Task]()
        try:
            while True:
                while len(waiting) < _QUEUED * self.workers and (task := next(todo, None)):
                    key = f"{self.rank}:{self._runs}:{task.key}"
                    waiting[key] = task
                    self._shared.add(self, replace(task, key=key, work=self._wrapped(task.work)))
                if not waiting:
                    return
                self._shared.check()
                if (answer := self.answers.get()) is not None:
                    yield replace(answer, task=waiting.pop(answer.task.key))
        finally:
            self._shared.forget(self)
