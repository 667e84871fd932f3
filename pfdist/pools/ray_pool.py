"""The pool of Ray workers. Ray is a pool here and nothing else.

The workers are long-lived actors: a call to one costs 0.7 ms, a stateless task 2 to 5 ms, and an
actor makes the function of its tasks once: it loads a filter, or compiles it. Each worker is handed
its next task before it has ended the last one.

A worker that dies or is silent for too long is replaced. One of its tasks may be the reason, and
nobody knows which. So these suspects are done next, each by a worker that has no other task: one
worker is set aside for them, while the others go on. An outcome costs the driver as much time with
a thousand workers as with one.
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
from queue import Empty, SimpleQueue
from typing import Any, Self

import cloudpickle

from pfdist.errors import EngineWarning, PfdistError, PoolError, SilenceError
from pfdist.pools import base
from pfdist.pools.base import Function, Outcome, Task, do, patience
from pfdist.pools.precautions import within
from pfdist.pools.ray_cluster import (
    ANSWER_BYTES,
    START_SECONDS,
    STOP_SECONDS,
    about,
    connected,
    is_own,
    ray,
)
from pfdist.pools.ray_rehearsal import reason, shortened

IN_FLIGHT = 2  # tasks a worker: the one it does and the one that waits for it
DEATHS = 3  # of workers that had a task and no other, before the task is given up
SILENCES = 2  # likewise, of workers that did not answer
ANSWER_SECONDS = 40.0  # when all are silent for so long, nobody will answer
TAKEN_SECONDS = 3.0  # for which cores may be taken by workers that are just ending
FUNCTIONS = 32  # that a worker keeps; fewer runs are computed at the same time
_ENVIRONMENT = {
    f"{library}_NUM_THREADS": "1" for library in ("OMP", "MKL", "OPENBLAS", "NUMBA", "NUMEXPR")
} | ANSWER_BYTES
_END = Task("", repr, None)  # there are no more tasks
_BUSY = Task("", repr, None)  # there may be more tasks, for which no worker is free

Call = Future[Any]
"""An answer that is owed."""


class RayPool:
    """Workers of a Ray cluster: this session's, an existing one's, or a local one of its own.

    Parameters
    ----------
    workers : int
        How many; 0 takes all cores: those this process may use on a local cluster, all CPUs of an
        existing one.
    address : str
        Address of an existing cluster. If it is empty or local, a cluster is started, unless this
        process has joined one.

    Raises
    ------
    PoolError
        On entering: Ray does not start, or does not answer, or no node has this version of pfdist.
    """

    def __init__(self, workers: int = 0, address: str = "") -> None:
        self._address = address
        self._cluster = contextlib.ExitStack()
        self._members: dict[_Worker, None] = {}
        self._answers = SimpleQueue[Call]()  # filled by a thread of Ray's
        self._owners: dict[Call, _Worker] = {}
        self._pickled = lru_cache(maxsize=FUNCTIONS)(cloudpickle.dumps)
        # Workers that can take a task, by the number of tasks that they have.
        self._free: tuple[dict[_Worker, None], ...] = tuple({} for _ in range(IN_FLIGHT))
        self._aside: _Worker | None = None  # for suspects alone
        self._suspects: deque[Task] = deque()
        self._lost: Counter[str] = Counter()
        self._unfinished = 0  # tasks that were taken and have no outcome
        self._last_loss = ""
        self._looked = self._heard = time.monotonic()
        self.workers = workers

    def __enter__(self) -> Self:
        try:
            is_our_own = not ray.is_initialized() and is_own(self._address)
            self._cluster.enter_context(connected(self._address, self.workers))
            cores = max(1, int(ray.cluster_resources().get("CPU", 1)))
            self.workers = self.workers or cores
            awaited = self.workers if is_our_own else self._untaken(cores)
            for _ in range(self.workers):
                self._add_worker()
            self._wait_for(awaited)
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

        A late answer of a worker that was replaced is ignored.

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
                pass
            else:
                yield from self._take(call)
            if time.monotonic() - self._looked >= base.LOOK_SECONDS:
                yield from self._give_up_the_silent()

    # --- workers that start ---------------------------------------------------------------------

    def _untaken(self, cores: int) -> int:
        """How many workers an existing cluster can start now; says so if others must wait."""
        deadline = time.monotonic() + TAKEN_SECONDS
        while (free := int(ray.available_resources().get("CPU", 0))) < self.workers:
            if time.monotonic() > deadline:
                taken = f"{cores - free} of the {cores} cores of the Ray cluster are taken"
                waits = f"{free} of {self.workers} workers start now, the others" * (free > 0)
                warnings.warn(
                    f"{taken}: {waits or 'the workers'} wait until cores are free",
                    EngineWarning,
                    stacklevel=3,
                )
                return free
            time.sleep(base.PAUSE_SECONDS)
        return self.workers

    def _add_worker(self, *, after_a_silence: bool = False) -> None:
        worker = _Worker(after_a_silence)
        self._members[worker] = None
        worker.starting = self._owe(worker, worker.actor.about.remote())

    def _wait_for(self, awaited: int) -> None:
        """Wait until so many workers have said who they are; at least one.

        Workers whose cores are taken may never start.
        """
        deaths, deadline = 0, time.monotonic() + START_SECONDS
        while sum(not worker.starting for worker in self._members) < max(
            1, min(awaited, len(self._members))
        ):
            try:
                call = self._answers.get(timeout=base.LOOK_SECONDS)
            except Empty:
                if awaited and time.monotonic() > deadline:
                    raise TimeoutError(f"no answer in {START_SECONDS:.0f} s") from None
                continue
            if (error := call.exception()) is not None:
                deaths += 1
                if deaths == DEATHS:
                    raise error
            for _outcome in self._take(call):
                pass  # there are no tasks yet

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
        worker.end()
        del self._members[worker]
        self.workers = len(self._members)
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
        self._suspects, self._aside, self._unfinished = deque(), None, 0
        self._lost, self._last_loss = Counter(), ""
        self._looked = self._heard = time.monotonic()
        for worker in self._members:
            for call in list(worker.owed):
                if call is worker.starting:
                    worker.owed[call] = None
                else:
                    del worker.owed[call], self._owners[call]
            self._set_free(worker)

    def _hand_out(self, todo: Iterator[Task | None]) -> Task | None:
        """Hand tasks to all workers that can take one, first to those that have none.

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
                self._hand(workers.popitem()[0], task)
        return task

    def _hand_suspects(self) -> None:
        """Let the worker that is set aside do the next suspect, as soon as it has no task."""
        if self._suspects and self._aside is None:
            for workers in filter(None, self._free):
                self._aside, _ = workers.popitem()
                break
        if self._aside is None or self._aside.tasks:
            return
        if self._suspects:
            self._hand(self._aside, self._suspects.popleft())
        else:
            worker, self._aside = self._aside, None
            self._set_free(worker)

    def _hand(self, worker: "_Worker", task: Task) -> None:
        """Hand a task to a worker; before it, its function, if the worker does not have it."""
        content = self._pickled(task.function)
        key = hash(content)
        if not worker.tasks:
            worker.heard = time.monotonic()
        if key in worker.functions:
            self._owe(worker, worker.actor.do.remote(key, task.work), task)
        else:
            worker.starting = self._owe(worker, worker.actor.make.remote(key, content), task)
        self._set_free(worker)

    def _owe(self, worker: "_Worker", answer: Any, task: Task | None = None) -> Call:
        """Note that a worker owes an answer, which a task waits for."""
        call: Call = answer.future()
        worker.owed[call], self._owners[call] = task, worker
        call.add_done_callback(self._answers.put)
        return call

    def _set_free(self, worker: "_Worker") -> None:
        """Note how many tasks a worker can take."""
        for workers in self._free:
            workers.pop(worker, None)
        tasks = len(worker.tasks)
        if not worker.starting and worker is not self._aside and tasks < IN_FLIGHT:
            self._free[tasks][worker] = None

    def _take(self, call: Call) -> Iterator[Outcome]:
        """Take an answer of a worker."""
        worker = self._owners.pop(call, None)
        if worker is None:  # it was replaced, or the run was broken off
            return
        if (error := call.exception()) is not None:
            if worker.tasks:  # such deaths are few
                self._heard = time.monotonic()
            yield from self._replace(worker, f"{type(error).__name__}: {error}", DEATHS)
            return
        worker.heard = self._heard = time.monotonic()
        task, outcome = worker.owed.pop(call), call.result()
        if call is worker.starting:
            worker.starting = None
            if isinstance(outcome, dict):
                self._check_version(worker, outcome)
            elif isinstance(outcome, str):  # it cannot make the function
                outcome = None, 0.0, "", "", outcome, True
            else:
                worker.functions.append(outcome)
                if task is not None:
                    self._hand(worker, task)
                    task = None
        if worker in self._members:
            self._set_free(worker)
        if task is not None:
            self._unfinished -= 1
            yield Outcome(task, *outcome)

    # --- workers that are lost ------------------------------------------------------------------

    def _give_up_the_silent(self) -> Iterator[Outcome]:
        """Replace workers that have been silent for too long; once a second."""
        now = time.monotonic()
        if now - self._looked > base.STILL_SECONDS:  # this process stood still, perhaps with all
            self._heard = now
            for worker in self._members:
                worker.heard = now
        for worker in list(self._members):
            silence = now - worker.heard
            if worker.tasks and silence > worker.patience and worker.is_silent:
                why = f"TimeoutError: no answer in {silence:.0f} s"
                yield from self._replace(worker, why, SILENCES)
        most = max(worker.answer_patience for worker in self._members)
        if now - self._heard > most and all(worker.is_silent for worker in self._members):
            silence = now - self._heard
            raise SilenceError(f"no worker has answered for {silence:.0f} s{self._last_loss}")
        self._looked = time.monotonic()

    def _replace(self, worker: "_Worker", why: str, most: int) -> Iterator[Outcome]:
        """Replace a lost worker; its tasks are suspects.

        A suspect is given up when it was the only task of so many workers that were lost.
        """
        self._last_loss = f" (the last was lost by {why.splitlines()[0]})"
        worker.end()
        for call in worker.owed:
            self._owners.pop(call, None)
        del self._members[worker]
        for workers in self._free:
            workers.pop(worker, None)
        if self._aside is worker:
            self._aside = None
        self._add_worker(after_a_silence=most == SILENCES)
        for task in worker.tasks:
            self._lost[task.key] += len(worker.tasks) == 1
            if self._lost[task.key] < most:
                self._suspects.append(task)
            else:
                self._unfinished -= 1
                yield Outcome(task, None, time.monotonic() - worker.heard, "", "", why)


class _Worker:
    """A worker as the driver knows it: its actor, and the answers that it owes.

    Nothing is handed to a worker that has not said who it is, for it may never start, as on a
    cluster that has lost a node; nor while it makes a function, which may take long.

    Parameters
    ----------
    after_a_silence : bool
        Whether it comes in the place of a worker that did not answer. If not, Ray answers.

    Attributes
    ----------
    starting : Call or None
        Who it is, or the function that it makes, while it owes this.
    owed : dict
        The answers that it owes, and the task of each.
    functions : deque of int
        Hashes of the functions that it has, the oldest first.
    heard : float
        When the worker last answered, or had nothing to do, on the monotonic clock.
    """

    def __init__(self, after_a_silence: bool) -> None:
        self.actor: Any = _RemoteActor.remote()
        self._after_a_silence = after_a_silence
        self.starting: Call | None = None
        self.owed: dict[Call, Task | None] = {}
        self.functions = deque[int](maxlen=FUNCTIONS)  # it forgets the oldest, as its actor does
        self.heard = time.monotonic()

    @property
    def tasks(self) -> list[Task]:
        """The tasks that it has."""
        return [task for task in self.owed.values() if task is not None]

    @property
    def is_silent(self) -> bool:
        """Whether no answer of it waits to be taken."""
        return not any(call.done() for call in self.owed)

    @property
    def _patience(self) -> float:
        return patience(max((task.seconds for task in self.tasks), default=0.0))

    @property
    def patience(self) -> float:
        """Seconds for which the worker may be silent."""
        return START_SECONDS if self.starting else self._patience

    @property
    def answer_patience(self) -> float:
        """Seconds for which all workers may be silent because of this worker."""
        if self.starting and not self._after_a_silence:
            return START_SECONDS
        return max(ANSWER_SECONDS, 2 * self._patience)

    def end(self) -> threading.Thread:
        """End the worker in a thread, because the request may never return."""

        def kill() -> None:
            with contextlib.suppress(ray.exceptions.RayError, ValueError):
                ray.kill(self.actor)

        return within(0.0, kill)


class _Actor:
    """The worker's process, as Ray runs it."""

    def __init__(self) -> None:
        self._functions: dict[int, Function] = {}  # the oldest first

    def about(self) -> dict[str, Any]:
        """Say who this is; it is the first to be answered."""
        return about()

    def make(self, key: int, content: bytes) -> int | str:
        """Make a function and give its key, or say why that failed."""
        try:
            self._functions[key] = cloudpickle.loads(content)
        except Exception as error:
            kind = "" if isinstance(error, PfdistError) else f"{type(error).__name__}: "
            return f"{kind}{error} (found by a worker on {about()['host']})"
        if len(self._functions) > FUNCTIONS:
            del self._functions[next(iter(self._functions))]
        return key

    def do(self, key: int, work: Any) -> tuple[Any, ...]:
        """Do a task: all of its outcome but the task."""
        return do(self._functions[key], work)


_RemoteActor: Any = ray.remote(num_cpus=1, runtime_env={"env_vars": _ENVIRONMENT})(_Actor)
