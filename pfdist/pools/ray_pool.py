"""A pool of Ray tasks: Ray schedules them, repeats those of lost workers, and uses new nodes."""

import contextlib
import pickle
import platform
import threading
import time
from collections.abc import Iterable, Iterator
from functools import cache, lru_cache
from importlib import metadata
from itertools import islice
from queue import Empty, SimpleQueue
from types import TracebackType
from typing import Any, Self

from pfdist.common.stopping import check, sleep
from pfdist.errors import PoolError, SilenceError
from pfdist.pools.base import WAIT_SECONDS, Function, Outcome, Silence, Task, patience
from pfdist.pools.ray_cluster import connected, is_own, load_ray, reason
from pfdist.pools.workers import (
    FUNCTIONS,
    Answer,
    Sent,
    answer_task,
    failed,
    pickled,
    silence_limit,
)

RETRIES = 3  # of a task whose worker died
LEAST_IN_FLIGHT = 16  # tasks, also on a cluster that has no cores yet, so that it gets some
LOST_SECONDS = 30.0  # Ray ends this process when its head has not answered for 60 s
LOOK_SECONDS = 3.0  # between two looks at the number of cores
_PAUSE_SECONDS = 0.01  # before the pool looks again for its first cores


class RayPool:
    """A pool on a Ray cluster: one that this process has joined, an existing one, or a new one.

    `workers` tasks run at the same time; by default, one for each core, also of nodes that join.
    """

    def __init__(self, workers: int = 0, address: str = "") -> None:
        self._demanded, self._address = workers, address
        self.workers, self._stack, self._cores = workers, contextlib.ExitStack(), _Cores()
        self._stored = lru_cache(maxsize=FUNCTIONS)(_stored)
        self._had = 0  # the most cores that the cluster has had

    def __enter__(self) -> Self:
        """Raise `PoolError` if there is no cluster, and `SilenceError` if it does not answer."""
        with contextlib.ExitStack() as stack:
            stack.enter_context(connected(self._address, self._demanded))
            while self._cores.look() < 0:
                sleep(_PAUSE_SECONDS)
            self._count_workers()
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._stack.__exit__(kind, error, traceback)

    def run(self, tasks: Iterable[Task]) -> Iterator[Outcome]:
        """Yield the outcomes in any order, with a bounded number in flight.

        Raises `PoolError` if a node has another version of pfdist, and `SilenceError` if the
        cluster or its workers no longer answer.
        """
        todo, in_flight, silence, remote = iter(tasks), dict[Any, Sent](), Silence(), _remote()
        answers: SimpleQueue[Any] = SimpleQueue()
        while True:
            for task in islice(todo, max(0, self._most_in_flight - len(in_flight))):
                key, content = self._stored(task.function)
                work, most = pickle.dumps(task.work), patience(task.seconds)
                call = remote.remote(key, content, work, most).future()
                in_flight[call] = Sent(task, time.monotonic())
                call.add_done_callback(answers.put)
            if not in_flight:
                return
            check()
            try:
                call = answers.get(timeout=WAIT_SECONDS)
            except Empty:
                silence.check(silence_limit(in_flight.values()))
            else:
                silence.end()
                yield _outcome(in_flight.pop(call), call)
            self._count_workers()

    def _count_workers(self) -> None:
        """Look at the cluster, also if so many workers are demanded: it may be lost."""
        cores = self._cores.look()
        self._had = max(self._had, cores)
        if cores == 0 < self._had and is_own(self._address):
            raise SilenceError("the Ray cluster is lost: its node does not answer")
        self.workers = self._demanded or max(1, cores)

    @property
    def _most_in_flight(self) -> int:
        """Two tasks for each core, so that no core waits; demanded workers may be fewer."""
        if not self._demanded:
            return max(LEAST_IN_FLIGHT, 2 * self._cores.number)
        return self._demanded * (1 + (self._demanded >= self._cores.number))


class _Cores:
    """The number of cores of the cluster, asked for in a thread, because Ray may never answer."""

    def __init__(self) -> None:
        self.number = -1  # before the first answer
        self._error: Exception | None = None
        self._silence, self._asked, self._thread = Silence(), -LOOK_SECONDS, threading.Thread()

    def look(self) -> int:
        """The number, which is asked for every few seconds; `SilenceError` without an answer."""
        if self._error is not None:
            raise SilenceError(f"the Ray cluster is lost: {reason(self._error)}")
        if self._thread.is_alive():
            self._silence.check(LOST_SECONDS, "the Ray cluster")
        elif (now := time.monotonic()) - self._asked >= LOOK_SECONDS:
            self._asked, self._silence = now, Silence()
            self._thread = threading.Thread(target=self._ask, daemon=True)
            self._thread.start()
        return self.number

    def _ask(self) -> None:
        try:
            self.number = int(load_ray().cluster_resources().get("CPU", 0))
        except Exception as error:
            self._error = error


def _outcome(sent: Sent, call: Any) -> Outcome:
    """The outcome of a task; a `PoolError` if a node has another version of pfdist."""
    error = call.exception()
    if error is not None:
        return failed(sent, error)
    values = call.result()
    if len(values) == 2:
        node, found = values
        raise PoolError(
            f"every node must have pfdist {metadata.version('pfdist')}, got {found} on {node}: "
            "install the same version there"
        )
    return Outcome(sent.task, *values)


def _stored(function: Function) -> tuple[str, list[Any]]:
    """The key of a function, and its content in Ray's object store; a list is not fetched."""
    key, content = pickled(function)
    return key, [load_ray().put(content)]


@cache
def _remote() -> Any:
    """The remote function. It travels by value: a node with another version must say so."""
    here = metadata.version("pfdist")

    def remote(key: str, content: list[Any], work: bytes, most: float) -> Any:
        found = next((each.version for each in metadata.distributions(name="pfdist")), "none")
        if found != here:
            return platform.node(), found
        from pfdist.pools.ray_pool import answer_of_ray  # noqa: PLC0415  of the worker's own version

        return answer_of_ray(key, content, work, most)

    return load_ray().remote(num_cpus=1, max_retries=RETRIES, name="pfdist")(remote)


def answer_of_ray(key: str, content: list[Any], work: bytes, most: float) -> Answer:
    """The answer of a worker to a task."""
    (stored,) = content
    return answer_task(key, lambda: load_ray().get(stored), pickle.loads(work), most)  # noqa: S301
