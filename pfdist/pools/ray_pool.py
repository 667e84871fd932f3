"""The pool of Ray workers. Ray is a pool here and nothing else.

A worker is a long-lived actor with a thread for each core that it has: one worker a node, because
compiled filters release Python's lock. Where tasks keep the lock, every core has a worker of its
own. An actor makes the function of its tasks once: it loads a filter, or compiles it. Each thread
is handed its next task before it has ended the last one.

Cores that become free while tasks are done get workers too: those of a node that joins, of another
driver that has ended, or of a worker that was lost.

A worker that dies or is silent for too long is ended. One of its tasks may be the reason, and
nobody knows which. So these suspects are done next, one after another, by one more worker with one
thread, while the others go on. An outcome costs the driver as much time with a thousand workers as
with one.
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

from pfdist.errors import EngineWarning, PfdistError, PoolError, SilenceError
from pfdist.pools import base
from pfdist.pools.base import Function, Outcome, Task, do, patience
from pfdist.pools.precautions import within
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
)
from pfdist.pools.ray_rehearsal import reason, shortened

IN_FLIGHT = 2  # tasks a thread: the one it does and the one that waits for it
DEATHS = 3  # of workers that had a task and no other, before the task is given up
SILENCES = 2  # likewise, of workers that did not answer
ANSWER_SECONDS = 40.0  # when all are silent for so long, nobody will answer
TAKEN_SECONDS = 3.0  # for which cores may be taken by workers that are just ending
FUNCTIONS = 32  # that a worker keeps; fewer runs are computed at the same time
_END = Task("", repr, None)  # there are no more tasks
_BUSY = Task("", repr, None)  # there may be more tasks, for which no thread is free

Call = Future[Any]
"""An answer that is owed."""
_Owed = Task | int | None


class RayPool:
    """Workers of a Ray cluster: this session's, an existing one's, or a local one of its own.

    Parameters
    ----------
    workers : int
        How many cores to use; 0 takes all: those this process may use on a local cluster, all CPUs
        of an existing one, also of nodes that join it later.
    address : str
        Address of an existing cluster. If it is empty or local, a cluster is started, unless this
        process has joined one.
    threaded : bool
        Whether a worker has all free cores of a node. If not, because tasks keep Python's lock, it
        has one.

    Attributes
    ----------
    workers : int
        Number of tasks that are done at the same time, when all cores are free.

    Raises
    ------
    PoolError
        On entering: Ray does not start, or does not answer, or no node has this version of pfdist.
    """

    def __init__(self, workers: int = 0, address: str = "", threaded: bool = True) -> None:
        self._asked, self._address, self._threaded = workers, address, threaded
        self._cluster = contextlib.ExitStack()
        self._members: dict[_Worker, None] = {}
        self._answers = SimpleQueue[Call]()  # filled by a thread of Ray's
        self._owners: dict[Call, _Worker] = {}
        self._sent = lru_cache(maxsize=FUNCTIONS)(_send)
        # Workers that can take a task: with a thread that is free; with all threads at work.
        self._free: tuple[dict[_Worker, None], dict[_Worker, None]] = {}, {}
        self._aside: _Worker | None = None  # for suspects alone
        self._suspects: deque[Task] = deque()
        self._lost: Counter[str] = Counter()
        self._unfinished = 0  # tasks that were taken and have no outcome
        self._last_loss = self._last_node = ""
        self._was_silent = False  # the worker that was lost last; Ray itself may not answer
        self._looked = self._heard = time.monotonic()
        self._seeker = threading.Thread()  # asks Ray for free cores, and may never return
        self._found = SimpleQueue[_FreeCores]()  # by it
        self._left_out = 0  # cores of nodes with another version
        self.workers = workers

    def __enter__(self) -> Self:
        try:
            self._cluster.enter_context(connected(self._address, self.workers))
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
        """Give the outcomes as the workers finish tasks, with a bounded number in flight.

        A late answer of a worker that was lost is ignored.

        Raises
        ------
        PoolError
            No worker answers, or none is left that has this version of pfdist.
        """
        todo = iter(tasks)
        self._forget_tasks()  # there may have been a run that was broken off
        task: Task | None = None
        while True:
            self._hand_suspects()
            if task is not _END:
                task = self._hand_out(todo)
            if not self._unfinished and (task is None or task is _END):
                return
            try:
                call = self._answers.get(
                    timeout=base.PAUSE_SECONDS if task is None else base.LOOK_SECONDS
                )
            except Empty:
                pass  # no worker has answered; it is time to look for the silent
            else:
                yield from self._take(call)
            if time.monotonic() - self._looked >= base.LOOK_SECONDS:
                yield from self._look()

    # --- workers that start ---------------------------------------------------------------------

    def _start_workers(self) -> None:
        """Start workers on the cores that are free, and wait until they have said who they are.

        It does not wait for cores that are taken, but says so; unless all are.
        """
        self.workers, deadline = self._asked or all_cores(), time.monotonic() + TAKEN_SECONDS
        while (free := idle_cores()) < self.workers and time.monotonic() < deadline:
            time.sleep(base.PAUSE_SECONDS)
        if free < self.workers:
            cores = all_cores()
            taken = f"{cores - free} of the {cores} cores of the Ray cluster are taken"
            waits = f"{free} of {self.workers} workers start now, the others" * (free > 0)
            warnings.warn(
                f"{taken}: {waits or 'the workers'} wait until cores are free",
                EngineWarning,
                stacklevel=3,
            )
        while not self._members:
            self._add_workers(self._free_cores())
            time.sleep(base.PAUSE_SECONDS)
        deaths, deadline = 0, time.monotonic() + START_SECONDS
        while any(worker.is_loading for worker in self._members):
            try:
                call = self._answers.get(timeout=base.LOOK_SECONDS)
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
        """How many cores have workers."""
        return sum(worker.cores for worker in self._members)

    def _free_cores(self) -> "_FreeCores":
        """The cores that are wanted, and those of them that are free and have no worker yet."""
        wanted = (self._asked or all_cores()) - self._left_out
        return max(1, wanted), free_cores(wanted - self._used)

    def _seek_cores(self) -> None:
        """Look for cores that have become free, in a thread, because Ray may never answer."""

        def seek() -> None:
            with contextlib.suppress(ray.exceptions.RayError, OSError, RuntimeError, ValueError):
                self._found.put(self._free_cores())

        if not self._seeker.is_alive() and (not self._asked or self._used < self.workers):
            self._seeker = within(0.0, seek)

    def _add_workers(self, found: "_FreeCores") -> None:
        """Start workers on free cores."""
        self.workers, nodes = found
        for node, cores in nodes.items():
            for each in [cores] if self._threaded else [1] * cores:
                self._add_worker(node, each)

    def _add_worker(self, node: str, cores: int) -> "_Worker":
        worker = _Worker(node, cores)
        self._members[worker] = None
        self._owe(worker, worker.actor.about.remote())
        return worker

    def _check_version(self, worker: "_Worker", about: dict[str, Any]) -> None:
        """Leave out a worker that says that it has another version of pfdist.

        Raises
        ------
        PoolError
            No worker has this version.
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
        """Hand tasks to all workers that can take one, first to those with a thread that is free.

        Returns
        -------
        Task or None
            `_END` if there are no more tasks; None if there is none at the moment.
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
        """Let a worker that does nothing else do the next suspect."""
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
        """Hand a task to a worker; if the worker must first load its function, the task waits."""
        key, content = self._sent(task.function)
        worker.tasks += 1
        self._set_free(worker)
        if key in worker.functions:
            self._owe(worker, worker.actor.do.remote(key, content, task.work), task)
        elif key in worker.waiting:
            worker.waiting[key].append(task)
        else:
            worker.waiting[key] = [task]
            self._owe(worker, worker.actor.load.remote(key, content), key)

    def _owe(self, worker: "_Worker", answer: Any, what: "_Owed" = None) -> None:
        """Note that a worker owes an answer: to a task, of a function's load, or who it is."""
        call: Call = answer.future()
        worker.owed[call], self._owners[call] = what, worker
        call.add_done_callback(self._answers.put)

    def _set_free(self, worker: "_Worker") -> None:
        """Note whether a worker can take a task."""
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
        """Take an answer of a worker."""
        worker = self._owners.pop(call, None)
        if worker is None:  # it was lost, or the run was broken off
            return
        if (error := call.exception()) is not None:
            if worker.tasks:  # such deaths are few
                self._heard = time.monotonic()
            yield from self._lose(worker, f"{type(error).__name__}: {error}", DEATHS)
            return
        self._heard = time.monotonic()
        what, answer = worker.owed.pop(call), call.result()
        if isinstance(what, Task):
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
        """Look for workers that are silent for too long, and for cores that are free."""
        now = time.monotonic()
        if now - self._looked > base.STILL_SECONDS:  # this process stood still, perhaps with all
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
            self._add_workers(self._found.get_nowait())
        self._seek_cores()
        self._looked = time.monotonic()

    @property
    def _patience(self) -> float:
        """Seconds for which all workers may be silent."""
        if not self._was_silent and any(worker.is_loading for worker in self._members):
            return START_SECONDS
        return max([ANSWER_SECONDS, *(2 * worker.task_patience for worker in self._members)])

    def _lose(self, worker: "_Worker", why: str, most: int) -> Iterator[Outcome]:
        """End a lost worker; its tasks are suspects.

        A suspect is given up when it was the only task of so many workers that were lost.
        """
        self._last_loss = f" (the last was lost by {why.splitlines()[0]})"
        self._last_node, self._was_silent = worker.node, most == SILENCES
        self._end(worker)
        for task in worker.all_tasks:
            self._lost[task.key] += worker.tasks == 1
            if self._lost[task.key] < most:
                self._suspects.append(task)
            else:
                self._unfinished -= 1
                yield Outcome(task, None, time.monotonic() - worker.since, "", "", why)

    def _end(self, worker: "_Worker") -> None:
        """End a worker, whose answers are ignored."""
        worker.end()
        for call in worker.owed:
            self._owners.pop(call, None)
        del self._members[worker]
        if self._aside is worker:
            self._aside = None
        self._set_free(worker)


class _Worker:
    """A worker as the driver knows it: its actor, and the answers that it owes.

    Nothing is handed to a worker that has not said who it is, for it may never start, as on a node
    that is lost.

    Parameters
    ----------
    node : str
        Ray's name of its node.
    cores : int
        How many it has, with a thread for each. 0 is one thread that has no core to itself.

    Attributes
    ----------
    has_started : bool
        Whether it has said who it is.
    owed : dict
        The answers that it owes, the oldest first: each to a task, of the load of a function with
        this key, or (None) who it is.
    waiting : dict
        Tasks that wait until a function is loaded, by its key.
    tasks : int
        How many tasks it has.
    functions : set of int
        Those that it has loaded.
    since : float
        When a look first found the oldest answer to be the oldest, on the monotonic clock.
    """

    def __init__(self, node: str, cores: int) -> None:
        where = NodeAffinitySchedulingStrategy(node, soft=cores == 0)
        self.actor: Any = _RemoteActor.options(
            num_cpus=cores, max_concurrency=max(1, cores), scheduling_strategy=where
        ).remote()
        self.node, self.cores, self.has_started = node, cores, False
        self.owed: dict[Call, _Owed] = {}
        self.waiting: dict[int, list[Task]] = {}
        self.tasks = 0
        self.functions = set[int]()
        self._oldest: Call | None = None
        self.since = time.monotonic()

    @property
    def is_silent(self) -> bool:
        """Whether no answer of it waits to be taken."""
        return not any(call.done() for call in self.owed)

    def silence(self, now: float) -> float:
        """Seconds for which it has owed its oldest answer. Another thread may answer meanwhile."""
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
        """Seconds for which it may be silent."""
        return START_SECONDS if self.is_loading else self.task_patience

    @property
    def task_patience(self) -> float:
        """Seconds for which it may do its tasks."""
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
        """Say who this is; it is the first to be answered."""
        return about()

    def load(self, key: int, content: bytes) -> None:
        """Make a function, which the first of its tasks would have to wait for."""
        self._function(key, content)

    def do(self, key: int, content: bytes, work: Any) -> tuple[Any, ...]:
        """Do a task, of a function with a key and a content: all of its outcome but the task."""
        function = self._function(key, content)
        if isinstance(function, str):
            return None, 0.0, "", "", function, True
        value, seconds, process, node, error = do(function, work)
        return value, seconds, f"{process}-{threading.get_native_id()}", node, error, False

    def _function(self, key: int, content: bytes) -> Function | str:
        """The function, made once, or why that failed."""
        function = self._functions.get(key)
        if function is None:
            with self._lock:  # threads that want the same function wait for it
                function = self._functions.get(key) or self._make(key, content)
        return function

    def _make(self, key: int, content: bytes) -> Function | str:
        function: Function | str
        try:
            function = cloudpickle.loads(content)
        except Exception as error:
            kind = "" if isinstance(error, PfdistError) else f"{type(error).__name__}: "
            function = f"{kind}{error} (found by a worker on {about()['host']})"
        self._functions[key] = function
        if len(self._functions) > FUNCTIONS:
            del self._functions[next(iter(self._functions))]
        return function


_RemoteActor: Any = ray.remote(_Actor)


def _send(function: Function) -> tuple[int, Any]:
    """A key of a function, and its content, which Ray hands to workers."""
    content = cloudpickle.dumps(function)
    return hash(content), ray.put(content)


_FreeCores = tuple[int, dict[str, int]]
"""The cores that are wanted in all, and those that are free on nodes."""
