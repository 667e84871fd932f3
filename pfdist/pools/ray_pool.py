"""The pool of Ray workers. Ray is a pool here and nothing else.

The workers are long-lived actors: a call to one costs 0.7 ms, a stateless task 2 to 5 ms, and an
actor loads its filter once, or compiles it. Each is handed its next task before it has ended the
last one.
"""

import contextlib
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Any, Self

from pfdist.errors import ModelError, PfdistError, PoolError
from pfdist.pools.base import Outcome, Task, do
from pfdist.pools.precautions import within
from pfdist.pools.ray_cluster import (
    ANSWER_BYTES,
    START_SECONDS,
    STOP_SECONDS,
    about,
    connected,
    ray,
)
from pfdist.pools.ray_rehearsal import reason, shortened

IN_FLIGHT = 2  # tasks a worker: the one it does and the one that waits for it
DEATHS = 3  # of workers that had a task and no other, before the task is given up
SILENCES = 2  # likewise, of workers that did not answer
PATIENCE_SECONDS = 15.0  # a worker is taken for lost when it is silent for so long, and for
PATIENCE_TIMES = 20  # so many times what its task should take
LOOK_SECONDS = 1.0  # between two looks for those that are silent
STILL_SECONDS = 5.0  # without a look: this process itself was stopped, or had other things to do
ANSWER_SECONDS = 40.0  # when all are silent for so long, nobody will answer
FETCH_SECONDS = 10.0
_ENVIRONMENT = {
    f"{library}_NUM_THREADS": "1" for library in ("OMP", "MKL", "OPENBLAS", "NUMBA", "NUMEXPR")
} | ANSWER_BYTES


@ray.remote(num_cpus=1)
class _Worker:
    def __init__(self, make_function: Callable[[], Callable[[Any], Any]]) -> None:
        self._refusal = ""
        try:
            self._function = make_function()
        except PfdistError as error:  # the driver is told, and ends with the same error
            self._refusal = str(error)

    def about(self) -> dict[str, Any]:
        """Say who this is, and whether it can work; it is the first to be answered."""
        return {**about(), "refusal": self._refusal}

    def do(self, task: Task) -> Outcome:
        return do(self._function, task)


@dataclass(eq=False)
class _Slot:
    """A slot for a worker: its present worker, and the tasks that the worker holds.

    Nothing is handed to a worker that has not said who it is: it may never start, as on a cluster
    that has lost a node.
    """

    actor: Any
    about: Any  # the answer to `_Worker.about`, until it has come
    tasks: dict[Any, Task] = field(default_factory=dict)
    room: int = IN_FLIGHT  # for so many tasks
    called_for: bool = False  # Ray itself has said that the one before has ended
    heard: float = field(default_factory=time.monotonic)

    @property
    def calls(self) -> list[Any]:
        """The answers that the worker still owes."""
        return [*self.tasks, *([] if self.about is None else [self.about])]

    @property
    def patience(self) -> float:
        """Seconds for which the worker may be silent."""
        expected = max((task.seconds for task in self.tasks.values()), default=0.0)
        return max(PATIENCE_SECONDS, PATIENCE_TIMES * expected)

    @property
    def answer_patience(self) -> float:
        """Seconds for which all workers may be silent because of this worker.

        If Ray answers, a worker that is starting has as much time to load and compile as the first
        workers had.
        """
        starting = self.called_for and self.about is not None
        return START_SECONDS if starting else max(ANSWER_SECONDS, 2 * self.patience)


class RayPool:
    """Workers of a Ray cluster: this session's, an existing one's, or a local one of its own.

    Parameters
    ----------
    make_function : callable
        Makes, in each worker, the function that is applied to each task's work.
    workers : int
        How many; 0 takes all cores: those this process may use on a local cluster, all CPUs of an
        existing one.
    address : str
        Address of an existing cluster. If it is empty or local, a cluster is started, unless this
        process has joined one.

    Raises
    ------
    PoolError
        On entering: Ray does not start, or does not answer.
    ModelError
        A worker cannot make its function; or means something else by its model than the driver.
    """

    def __init__(
        self,
        make_function: Callable[[], Callable[[Any], Any]],
        workers: int = 0,
        address: str = "",
    ) -> None:
        self._make_function = make_function
        self._address = address
        self._cluster = contextlib.ExitStack()
        self._slots: list[_Slot] = []
        self._todo: Iterator[Task] = iter(())
        self._again: deque[Task] = deque()  # tasks of lost workers, each of which is done alone
        self._lost: Counter[str] = Counter()
        self._last_loss = ""
        self._looked = self._heard = time.monotonic()
        self.workers = workers

    def __enter__(self) -> Self:
        try:
            self._cluster.enter_context(connected(self._address, self.workers))
            if not self.workers:
                self.workers = max(1, int(ray.cluster_resources().get("CPU", 1)))
            self._slots = [self._new_slot() for _ in range(self.workers)]
            self._wait_for_all()
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
        slots, self._slots = self._slots, []
        self._cluster.close()  # the workers go with a cluster that was joined or started here
        if ray.is_initialized():
            deadline = time.monotonic() + STOP_SECONDS
            for ending in [_end(slot.actor) for slot in slots]:
                ending.join(max(0.0, deadline - time.monotonic()))

    def _wait_for_all(self) -> None:
        """Wait until every worker has answered for the first time; some may die before."""
        deadline, deaths = time.monotonic() + START_SECONDS, 0
        while coming := {slot.about: slot for slot in self._slots if slot.about is not None}:
            ready, _ = ray.wait(list(coming), timeout=max(0.0, deadline - time.monotonic()))
            slot = coming[ready[0]] if ready else next(iter(coming.values()))
            try:
                _check_about(ray.get(slot.about, timeout=0 if not ready else FETCH_SECONDS))
                slot.about = None
            except ray.exceptions.RayActorError:
                deaths += 1
                if deaths >= DEATHS:
                    raise
                self._slots[self._slots.index(slot)] = self._new_slot()

    def run(self, tasks: Iterable[Task]) -> Iterator[Outcome]:
        """Give the outcomes as the workers finish tasks, with a bounded number in flight.

        A worker that dies or is silent for too long is replaced, and its tasks are done again. A
        late answer of the old worker is ignored.

        Raises
        ------
        PoolError
            No worker answers.
        """
        self._todo, self._again = iter(tasks), deque()
        self._lost, self._last_loss = Counter(), ""
        self._looked = self._heard = time.monotonic()
        for slot in self._slots:
            slot.tasks, slot.room = {}, IN_FLIGHT  # there may have been a run that was broken off
        while self._hand_out() or any(slot.tasks for slot in self._slots):
            ready, _ = ray.wait(self._calls, num_returns=1, timeout=LOOK_SECONDS)
            if ready:
                yield from self._take(ready[0])
            yield from self._give_up_the_silent()

    def _hand_out(self) -> bool:
        """Hand tasks to all workers that can take one; say whether more tasks may come."""
        for depth in range(IN_FLIGHT):
            for slot in self._slots:
                if slot.about is not None or len(slot.tasks) > depth or depth >= slot.room:
                    continue
                alone = not slot.tasks and bool(self._again)
                task = self._again.popleft() if alone else next(self._todo, None)
                if task is None:
                    return False
                if not slot.tasks:
                    slot.heard, slot.room = time.monotonic(), 1 if alone else IN_FLIGHT
                slot.tasks[slot.actor.do.remote(task)] = task
        return True

    def _take(self, call: Any) -> Iterator[Outcome]:
        """Take the answer of a worker."""
        slot = next(slot for slot in self._slots if call in slot.calls)
        try:
            answer = ray.get(call, timeout=FETCH_SECONDS)
        except ray.exceptions.RayError as error:
            if slot.tasks:  # it had said who it is: such deaths are few
                self._heard = time.monotonic()
            yield from self._replace(slot, f"{type(error).__name__}: {error}", DEATHS)
            return
        slot.heard = self._heard = time.monotonic()
        if call is slot.about:
            slot.about = None
            _check_about(answer)
        else:
            del slot.tasks[call]
            yield answer

    def _give_up_the_silent(self) -> Iterator[Outcome]:
        """Replace workers that have been silent for too long."""
        now = time.monotonic()
        if now - self._looked > STILL_SECONDS:  # nothing here moved: it says nothing of the workers
            self._heard = now
            for slot in self._slots:
                slot.heard = now
        for slot in list(self._slots):
            if slot.tasks and now - slot.heard > slot.patience and _silent(slot.calls):
                why = f"TimeoutError: no answer in {now - slot.heard:.0f} s"
                yield from self._replace(slot, why, SILENCES)
        patience = max(slot.answer_patience for slot in self._slots)
        if now - self._heard > patience and _silent(self._calls):
            raise PoolError(
                f"no worker has answered for {now - self._heard:.0f} s{self._last_loss}; run the "
                "same command again to go on from what is committed"
            )
        self._looked = time.monotonic()

    def _replace(self, slot: _Slot, why: str, most: int) -> Iterator[Outcome]:
        """Replace a lost worker, and do its tasks again.

        One of the tasks may have killed the worker, and nobody knows which. So each task is done
        again alone, and given up when it has killed so many workers alone.
        """
        self._last_loss = f" (the last was lost by {why.splitlines()[0]})"
        _end(slot.actor)
        self._slots[self._slots.index(slot)] = new = self._new_slot()
        new.called_for = most == DEATHS
        for task in slot.tasks.values():
            self._lost[task.key] += len(slot.tasks) == 1
            if self._lost[task.key] < most:
                self._again.append(task)
            else:
                yield Outcome(task, None, time.monotonic() - slot.heard, "", "", why)

    @property
    def _calls(self) -> list[Any]:
        return [call for slot in self._slots for call in slot.calls]

    def _new_slot(self) -> _Slot:
        options = _Worker.options(runtime_env={"env_vars": _ENVIRONMENT})  # type: ignore[attr-defined]
        actor = options.remote(self._make_function)
        return _Slot(actor, actor.about.remote())


def _check_about(about: Mapping[str, Any]) -> None:
    """Raise an error if a worker has another version, or could not make its function."""
    if about["pfdist"] != version("pfdist"):
        raise PoolError(
            f"every node must have pfdist {version('pfdist')}, got {about['pfdist']} on "
            f"{about['host']}: install the same version there"
        )
    if about["refusal"]:
        raise ModelError(f"{about['refusal']} (found by a worker on {about['host']})")


def _silent(calls: list[Any]) -> bool:
    """Whether none of these calls has been answered; an answer may still wait to be taken."""
    return not ray.wait(calls, timeout=0)[0]


def _end(actor: Any) -> threading.Thread:
    """End a worker in a thread, because the request may never return."""

    def kill() -> None:
        with contextlib.suppress(ray.exceptions.RayError, ValueError):
            ray.kill(actor)

    return within(0.0, kill)
