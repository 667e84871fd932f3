"""The pool of Ray workers. Ray is a pool here and nothing else.

A worker is a long-lived actor with a thread for each of its cores: one worker a node, because
compiled filters release Python's lock. If tasks keep the lock, every core has a worker of its own.
An actor makes the function of its tasks once: it loads a filter, or compiles it. It keeps a few,
and loads one again that it has forgotten. Each thread gets its next task before it has ended the
last one.

Cores that become free while tasks are done get workers too: those of a node that joins, of another
driver that has ended, or of a worker that was lost.

A worker that dies or is silent for too long is ended. One of its tasks may be the reason, and it
is not known which. So these suspects are done next, one after another, by one more worker with one
thread, while the others go on. An outcome costs the driver as much time with a thousand workers as
with one.

The state of the pool belongs to the driver's thread. Other threads only put answers and free cores
into queues, which the loop of `run` empties.
"""

import contextlib
import sys
import threading
import time
import warnings
from collections import Counter, deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future
from functools import lru_cache
from importlib.metadata import version
from itertools import chain
from queue import Empty, SimpleQueue
from typing import Any, Self

import cloudpickle
from threadpoolctl import threadpool_limits

from pfdist.common.stopping import check, sleep
from pfdist.errors import EngineWarning, PfdistError, PoolError, SilenceError
from pfdist.pools import base
from pfdist.pools.base import Function, Outcome, Task, do, patience
from pfdist.pools.ray_cluster import (
    START_SECONDS,
    STOP_SECONDS,
    NodeAffinitySchedulingStrategy,
    about,
    all_cores,
    connected,
    free_cores,
    idle_cores,
    ray,
    within,
)
from pfdist.pools.ray_rehearsal import reason, shortened

IN_FLIGHT = 2  # tasks of a thread: the one that it does, and the next
DEATHS = 3  # of workers that had only this task, before the task is given up
SILENCES = 2  # of workers that had only this task and did not answer, likewise
ANSWER_SECONDS = 40.0  # when all workers are silent for longer, none will answer
WAIT_SECONDS = 300.0  # for the cores that the cluster must have before workers start
TAKEN_SECONDS = 3.0  # for which cores may still belong to workers that are just ending
FUNCTIONS = 32  # that a worker keeps; fewer runs are computed at the same time
_END = Task("", repr, None)  # there are no more tasks
_BUSY = Task("", repr, None)  # no thread was free to take another task

Call = Future[Any]
"""An answer for which the driver waits."""
_Owed = Task | int | None  # for a task; for the load of a function with this key; who it is


class RayPool:
    """A pool of workers of a Ray cluster: this session's, an existing one, or a local one.

    `workers` is the number of cores to use; 0 takes all: those that this process may use on a local
    cluster, all CPUs of an existing one, also of nodes that join it later. Afterwards, the
    attribute is the number of tasks that are done at the same time, when all cores are free.

    Without an address, or for local, a cluster is started, unless this process has joined one. If
    not `threaded`, because tasks keep Python's lock, every core has a worker of its own. Workers
    start when the cluster has as many cores as `wait_for_cores` says.

    On entering, raises `PoolError` if Ray does not start or does not answer, or if no node has this
    version of pfdist; and `SilenceError` if the cluster lacks cores for `WAIT_SECONDS`.
    """

    def __init__(
        self, workers: int = 0, address: str = "", wait_for_cores: int = 0, *, threaded: bool = True
    ) -> None:
        self._demanded, self._address, self._threaded = workers, address, threaded
        self._least_cores = wait_for_cores
        self._cluster = contextlib.ExitStack()
        self._members: dict[_Worker, None] = {}
        self._answers = SimpleQueue[Call]()  # filled by a thread of Ray's
        self._owners: dict[Call, _Worker] = {}
        self._sent = lru_cache(maxsize=FUNCTIONS)(_send)
        # Workers that can take a task: with a thread that is free; with all threads at work.
        self._free: tuple[dict[_Worker, None], dict[_Worker, None]] = {}, {}
        self._aside: _Worker | None = None  # does suspects, and nothing else
        self._suspects: deque[Task] = deque()
        self._lost: Counter[str] = Counter()
        self._unfinished = 0  # tasks that were taken and have no outcome yet
        self._last_loss = self._last_node = ""
        self._was_silent = False  # the worker that was lost last; Ray itself may not answer
        self._looked = self._heard = time.monotonic()
        self._seeker = threading.Thread()  # asks Ray for free cores, and may never return
        self._newly_free = SimpleQueue[_FreeCores]()  # filled by the seeker
        self._left_out = 0  # cores of nodes with another version of pfdist
        self.workers = workers

    def __enter__(self) -> Self:
        try:
            self._cluster.enter_context(connected(self._address, self.workers))
            self._wait_for_cores()
            self._start_workers()
        except (ray.exceptions.RayError, OSError, RuntimeError, ValueError) as error:
            self.__exit__()
            where = f" at {shortened(self._address)}" if self._address else ""
            raise PoolError(
                f"Ray could not start workers{where}: {reason(error)}; "
                "the serial pool computes the same without Ray",
                argument="pool",
            ) from error
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        workers, self._members = self._members, {}
        self._cluster.close()  # the workers go with a cluster that was joined or started here
        if ray.is_initialized() and not sys.is_finalizing():
            deadline = time.monotonic() + STOP_SECONDS
            for ending in [worker.end() for worker in workers]:
                ending.join(max(0.0, deadline - time.monotonic()))

    def run(self, tasks: Iterable[Task | None]) -> Iterator[Outcome]:
        """Yield the outcomes as the workers finish tasks, with a bounded number in flight.

        Late answers of a lost worker are ignored. Raises `PoolError` if no worker answers, or if
        none is left that has this version of pfdist.

        In each round, suspects go first, then every free thread gets a task, then one answer is
        taken. About once a second, the pool looks for silent workers and for free cores, even while
        answers come.
        """
        todo = iter(tasks)
        self._forget_tasks()  # an earlier run may have been broken off
        task: Task | None = None
        while True:
            self._hand_suspects()
            if task is not _END:
                task = self._hand_out(todo)
            if not self._unfinished and (task is None or task is _END):
                return
            check()
            try:
                call = self._answers.get(
                    timeout=base.PAUSE_SECONDS if task is None else base.WAIT_SECONDS
                )
            except Empty:
                pass  # no worker has answered; it is time to look for the silent
            else:
                yield from self._take(call)
            if time.monotonic() - self._looked >= base.LOOK_SECONDS:
                yield from self._look()

    # --- workers that start ---------------------------------------------------------------------

    def _wait_for_cores(self) -> None:
        deadline = time.monotonic() + WAIT_SECONDS
        if (cores := all_cores()) < self._least_cores:
            warnings.warn(
                f"the Ray cluster has {cores} of {self._least_cores} cores: waiting for the others "
                f"for up to {WAIT_SECONDS:.0f} s",
                EngineWarning,
                stacklevel=3,
            )
        while (cores := all_cores()) < self._least_cores:
            if time.monotonic() > deadline:
                raise SilenceError(
                    f"after {WAIT_SECONDS:.0f} s the Ray cluster has {cores} of the "
                    f"{self._least_cores} cores that it must have",
                    argument="wait_for_cores",
                )
            sleep(base.PAUSE_SECONDS)
        if self._demanded > cores:
            warnings.warn(
                f"{self._demanded:,} workers are wanted, but the Ray cluster has {cores:,} cores: "
                "the others start only if nodes join",
                EngineWarning,
                stacklevel=3,
            )

    def _start_workers(self) -> None:
        """Start workers on the cores that are free, and wait until each has reported its version.

        Cores that are taken are not waited for, unless all are; a warning says so.
        """
        self.workers, deadline = self._wanted, time.monotonic() + TAKEN_SECONDS
        while (free := idle_cores()) < self.workers and time.monotonic() < deadline:
            sleep(base.PAUSE_SECONDS)
        if free < self.workers:
            cores = all_cores()
            taken = f"{cores - free} of the {cores} cores of the Ray cluster are taken"
            waits = f"{free} of {self.workers} workers start now, the others" * (free > 0)
            warnings.warn(
                f"{taken}: {waits or 'the workers'} wait until cores are free",
                EngineWarning,
                stacklevel=3,
            )
        # Cores that were free may be taken in between: wait until one worker can start.
        while not self._members:
            self._add_workers(self._free_cores())
            sleep(base.PAUSE_SECONDS)
        deaths, deadline = 0, time.monotonic() + START_SECONDS
        while any(worker.is_loading for worker in self._members):
            check()
            try:
                call = self._answers.get(timeout=base.WAIT_SECONDS)
            except Empty:
                if time.monotonic() > deadline:
                    raise TimeoutError(f"no answer in {START_SECONDS:.0f} s") from None
                continue
            if (error := call.exception()) is not None:
                deaths += 1
                if deaths == DEATHS:
                    raise error
                self._add_workers(self._free_cores())
            for _outcome in self._take(call):
                pass  # there are no tasks yet

    @property
    def _used(self) -> int:
        """Number of cores that have workers."""
        return sum(worker.cores for worker in self._members)

    def _free_cores(self) -> "_FreeCores":
        """The number of wanted cores, and the free cores of each node without a worker."""
        wanted = self._wanted - self._left_out
        return max(1, wanted), free_cores(wanted - self._used)

    @property
    def _wanted(self) -> int:
        """Number of cores to use, as far as the cluster has them."""
        cores = all_cores()
        return min(self._demanded or cores, cores)

    def _seek_cores(self) -> None:
        """Look for cores that have become free, in a thread, because Ray may never answer.

        At most one such thread is at work, and a thread that hangs is never replaced.
        """

        def seek() -> None:
            with contextlib.suppress(ray.exceptions.RayError, OSError, RuntimeError, ValueError):
                self._newly_free.put(self._free_cores())

        if not self._seeker.is_alive() and (not self._demanded or self._used < self.workers):
            self._seeker = within(0.0, seek)

    def _add_workers(self, free: "_FreeCores") -> None:
        """Start workers on free cores."""
        self.workers, nodes = free
        for node, cores in nodes.items():
            for each in [cores] if self._threaded else [1] * cores:
                self._add_worker(node, each)

    def _add_worker(self, node: str, cores: int) -> "_Worker":
        worker = _Worker(node, cores)
        self._members[worker] = None
        self._owe(worker, worker.actor.about.remote())
        return worker

    def _check_version(self, worker: "_Worker", about: dict[str, Any]) -> None:
        """Leave out a worker with another version of pfdist.

        Raises `PoolError` if no worker has this version.
        """
        here = version("pfdist")
        if about["pfdist"] == here:
            return
        self._end(worker)
        self._left_out += worker.cores
        self.workers -= worker.cores
        wrong = (
            f"every node must have pfdist {here}, got {about['pfdist']} on {about['host']}: "
            "install the same version there"
        )
        if not self._members:
            raise PoolError(wrong)
        warnings.warn(f"{wrong}; the other nodes go on without it", EngineWarning, stacklevel=2)

    # --- tasks ----------------------------------------------------------------------------------

    def _forget_tasks(self) -> None:
        """Forget the tasks of an earlier run; their answers are ignored."""
        self._suspects, self._unfinished = deque(), 0
        self._lost, self._last_loss, self._was_silent = Counter(), "", False
        self._looked = self._heard = time.monotonic()
        for worker in self._members:
            for call, what in list(worker.owed.items()):
                if isinstance(what, Task):
                    del worker.owed[call], self._owners[call]
            worker.tasks, worker.waiting = 0, {key: [] for key in worker.waiting}
            self._set_free(worker)

    def _hand_out(self, todo: Iterator[Task | None]) -> Task | None:
        """Hand tasks to all workers that can take one, first to those with a free thread.

        `_END` says that there are no more tasks, and None that there is none now.
        """
        task: Task | None = _BUSY
        for workers in self._free:
            while workers:
                task = next(todo, _END)
                if task is None or task is _END:
                    return task
                self._unfinished += 1
                self._hand(next(iter(workers)), task)
        return task

    def _hand_suspects(self) -> None:
        """Hand the next suspect to a worker that does nothing else.

        It has one suspect at a time, so if it is lost, this task was the reason. It ends with the
        last one.
        """
        worker = self._aside
        if worker is None:
            if self._suspects:
                nodes = [worker.node for worker in self._members]
                self._aside = self._add_worker(next(iter(nodes), self._last_node), 0)
        elif not worker.owed:
            if self._suspects:
                self._hand(worker, self._suspects.popleft())
            else:
                self._end(worker)

    def _hand(self, worker: "_Worker", task: Task) -> None:
        """Hand a task to a worker; the task waits if the worker must first load its function.

        A load may compile for a minute, and the patience with a task does not cover this.
        """
        key, content = self._sent(task.function)
        worker.tasks += 1
        self._set_free(worker)
        if key in worker.functions:
            self._owe(worker, worker.actor.do.remote(key, task.work), task)
        elif key in worker.waiting:
            worker.waiting[key].append(task)
        else:
            worker.waiting[key] = [task]
            self._owe(worker, worker.actor.load.remote(key, content), key)

    def _owe(self, worker: "_Worker", answer: Any, what: "_Owed" = None) -> None:
        """Note an answer that a worker owes."""
        call: Call = answer.future()
        worker.owed[call], self._owners[call] = what, worker
        call.add_done_callback(self._answers.put)

    def _set_free(self, worker: "_Worker") -> None:
        """Note whether a worker can take a task, with a free thread or to wait for one."""
        idle, waiting = self._free
        idle.pop(worker, None)
        waiting.pop(worker, None)
        if worker not in self._members or not worker.has_started:
            return
        if worker.tasks < worker.cores:
            idle[worker] = None
        elif worker.tasks < IN_FLIGHT * worker.cores:
            waiting[worker] = None

    def _take(self, call: Call) -> Iterator[Outcome]:
        """Yield the outcome, or the outcomes of a loss, that an answer of a worker brings."""
        worker = self._owners.pop(call, None)
        if worker is None:  # the worker was lost, or the run was broken off
            return
        if (error := call.exception()) is not None:
            # A death counts as an answer if the worker had tasks: each task dies a few times at
            # most. Workers that die as they start must not keep the pool waiting for ever.
            if worker.tasks:
                self._heard = time.monotonic()
            yield from self._lose(worker, f"{type(error).__name__}: {error}", DEATHS)
            return
        self._heard = time.monotonic()
        what, answer = worker.owed.pop(call), call.result()
        if isinstance(what, Task) and answer is None:
            worker.tasks -= 1
            worker.functions.discard(self._sent(what.function)[0])
            self._hand(worker, what)
        elif isinstance(what, Task):
            worker.tasks -= 1
            self._unfinished -= 1
            yield Outcome(what, *answer)
        elif what is not None:
            worker.functions.add(what)
            for task in worker.waiting.pop(what):
                worker.tasks -= 1
                self._hand(worker, task)
        else:
            worker.has_started = True
            self._check_version(worker, answer)
        self._set_free(worker)

    # --- workers that are lost ------------------------------------------------------------------

    def _look(self) -> Iterator[Outcome]:
        """End workers that are silent for too long, and start workers on cores that are free.

        First the pool allows for its own standstill: time in which this process was stopped says
        nothing about workers. A worker counts as silent only if no answer of it waits in the queue.
        Last, cores that an earlier search has found get workers, and the next search begins.
        """
        now = time.monotonic()
        if now - self._looked > base.STILL_SECONDS:  # this process stood still, and perhaps others
            self._heard = now
            for worker in self._members:
                worker.since = now
        for worker in list(self._members):
            silence = worker.silence(now)
            if silence > worker.patience and worker.is_silent:
                why = f"TimeoutError: no answer in {silence:.0f} s"
                yield from self._lose(worker, why, SILENCES)
        silence = now - self._heard
        if silence > self._patience and all(worker.is_silent for worker in self._members):
            raise SilenceError(f"no worker has answered for {silence:.0f} s{self._last_loss}")
        with contextlib.suppress(Empty):
            self._add_workers(self._newly_free.get_nowait())
        self._seek_cores()
        self._looked = time.monotonic()

    @property
    def _patience(self) -> float:
        """Seconds for which all workers may be silent together."""
        if not self._was_silent and any(worker.is_loading for worker in self._members):
            return START_SECONDS
        return max([ANSWER_SECONDS, *(2 * worker.task_patience for worker in self._members)])

    def _lose(self, worker: "_Worker", why: str, most: int) -> Iterator[Outcome]:
        """End a lost worker, and yield the outcomes of tasks that are given up.

        Its other tasks are suspects. A suspect is given up when it was the only task of so many
        lost workers.
        """
        self._last_loss = f" (the last was lost by {why.splitlines()[0]})"
        self._last_node, self._was_silent = worker.node, most == SILENCES
        self._end(worker)
        for task in worker.all_tasks:
            # With other tasks beside it, the task may be innocent: only a loss alone counts.
            self._lost[task.key] += worker.tasks == 1
            if self._lost[task.key] < most:
                self._suspects.append(task)
            else:
                self._unfinished -= 1
                yield Outcome(task, None, time.monotonic() - worker.since, "", "", why)

    def _end(self, worker: "_Worker") -> None:
        """End a worker, whose answers are ignored from now on."""
        worker.end()
        for call in worker.owed:
            self._owners.pop(call, None)
        del self._members[worker]
        if self._aside is worker:
            self._aside = None
        self._set_free(worker)


class _Worker:
    """A worker as the driver sees it: its actor, and the answers that it owes.

    It gets no task before it has reported its version, because it may never start, as on a lost
    node. `node` is Ray's name of its node. It has a thread for each core; with 0 cores, it has one
    thread and shares a core with others.
    """

    def __init__(self, node: str, cores: int) -> None:
        where = NodeAffinitySchedulingStrategy(node, soft=cores == 0)
        self.actor: Any = _RemoteActor.options(
            num_cpus=cores, max_concurrency=max(1, cores), scheduling_strategy=where
        ).remote()
        self.node, self.cores = node, cores
        self.has_started = False  # whether it has reported its version
        self.owed: dict[Call, _Owed] = {}  # the answers that it owes, the oldest first
        self.waiting: dict[int, list[Task]] = {}  # for a function that is loading, by its key
        self.tasks = 0  # that it has, or that wait
        self.functions = set[int]()  # keys of the functions that it has loaded
        self._oldest: Call | None = None
        self.since = time.monotonic()  # when a look first found `_oldest` to be the oldest answer

    @property
    def is_silent(self) -> bool:
        """Whether none of its answers waits to be taken."""
        return not any(call.done() for call in self.owed)

    def silence(self, now: float) -> float:
        """Seconds for which it has owed its oldest answer; Ray's thread may answer meanwhile."""
        oldest = next(iter(self.owed), None)
        if oldest is not self._oldest:
            self._oldest, self.since = oldest, now
        return 0.0 if oldest is None else now - self.since

    @property
    def all_tasks(self) -> list[Task]:
        """Its tasks, those that it was handed first."""
        handed = [what for what in self.owed.values() if isinstance(what, Task)]
        return [*handed, *chain.from_iterable(self.waiting.values())]

    @property
    def is_loading(self) -> bool:
        """Whether it starts, or loads a function."""
        return not all(isinstance(what, Task) for what in self.owed.values())

    @property
    def patience(self) -> float:
        """Seconds for which it may be silent now."""
        return START_SECONDS if self.is_loading else self.task_patience

    @property
    def task_patience(self) -> float:
        """Seconds for which it may be silent while it does its tasks."""
        return patience(max((task.seconds for task in self.all_tasks), default=0.0))

    def end(self) -> threading.Thread:
        """End the worker in a thread, because the request may never return."""

        def kill() -> None:
            with contextlib.suppress(ray.exceptions.RayError, ValueError):
                ray.kill(self.actor)

        return within(0.0, kill)


class _Actor:
    """The worker's process, as Ray runs it."""

    def __init__(self) -> None:
        threadpool_limits(1)  # of BLAS; its cores have threads of ours
        self._functions: dict[int, Function | str] = {}  # the oldest first
        self._lock = threading.Lock()

    def about(self) -> dict[str, Any]:
        """Host and versions of the process; this is its first answer."""
        return about()

    def load(self, key: int, content: bytes) -> None:
        """Make a function, for which the first of its tasks would have to wait."""
        with self._lock:
            if key not in self._functions:
                self._make(key, content)

    def do(self, key: int, work: Any) -> tuple[Any, ...] | None:
        """Do a task: all of its outcome but the task; None if the function was forgotten.

        A task names its function by the key alone: content would cost each task as much as its
        answer.
        """
        function = self._functions.get(key)
        if function is None:
            return None
        if isinstance(function, str):
            return None, 0.0, "", "", function, True
        value, seconds, process, node, error = do(function, work)
        return value, seconds, f"{process}-{threading.get_native_id()}", node, error, False

    def _make(self, key: int, content: bytes) -> None:
        """Make a function, or note why that failed; the oldest of many is forgotten."""
        function: Function | str
        try:
            function = cloudpickle.loads(content)
        except Exception as error:
            kind = "" if isinstance(error, PfdistError) else f"{type(error).__name__}: "
            function = f"{kind}{error} (found by a worker on {about()['host']})"
        self._functions[key] = function
        if len(self._functions) > FUNCTIONS:
            del self._functions[next(iter(self._functions))]


_RemoteActor: Any = ray.remote(_Actor)


def _send(function: Function) -> tuple[int, Any]:
    """The key of a function, and its content in Ray's object store, for workers."""
    content = cloudpickle.dumps(function)
    return hash(content), ray.put(content)


_FreeCores = tuple[int, dict[str, int]]
"""The number of wanted cores in all, and the free cores of each node."""
