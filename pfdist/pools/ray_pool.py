"""The pool of Ray workers. Ray is a pool here and nothing else.

The workers are long-lived actors: a call to one costs 0.7 ms, a stateless task 2 to 5 ms, and an
actor loads its filter once, or compiles it. Each is handed its next task before it has ended the
last one.
"""

import contextlib
import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any, Self

from pfdist.errors import PoolError
from pfdist.pools.base import Outcome, Task
from pfdist.pools.ray_cluster import START_SECONDS, STOP_SECONDS, connected, ray
from pfdist.pools.ray_rehearsal import reason, shortened
from pfdist.pools.ray_worker import IN_FLIGHT, Worker, silent

DEATHS = 3  # of workers that had a task and no other, before the task is given up
SILENCES = 2  # likewise, of workers that did not answer
LOOK_SECONDS = 1.0  # between two looks for those that are silent
PAUSE_SECONDS = 0.01  # before tasks are asked for again, where there were none at the moment
STILL_SECONDS = 5.0  # without a look: this process itself was stopped, or had other things to do
FETCH_SECONDS = 10.0
_END = Task("", None)  # there are no more tasks


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
        self._members: list[Worker] = []
        self._todo: Iterator[Task | None] = iter(())
        self._pauses = False  # there was no task at the moment
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
            self._members = [Worker(self._make_function) for _ in range(self.workers)]
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
        workers, self._members = self._members, []
        self._cluster.close()  # the workers go with a cluster that was joined or started here
        if ray.is_initialized() and not sys.is_finalizing():
            deadline = time.monotonic() + STOP_SECONDS
            for ending in [worker.end() for worker in workers]:
                ending.join(max(0.0, deadline - time.monotonic()))

    def _wait_for_all(self) -> None:
        """Wait until every worker has answered for the first time; some may die before."""
        deadline, deaths = time.monotonic() + START_SECONDS, 0
        while coming := {each.about: each for each in self._members if each.about is not None}:
            ready, _ = ray.wait(list(coming), timeout=max(0.0, deadline - time.monotonic()))
            worker = coming[ready[0]] if ready else next(iter(coming.values()))
            try:
                worker.accept(ray.get(worker.about, timeout=0 if not ready else FETCH_SECONDS))
            except ray.exceptions.RayActorError:
                deaths += 1
                if deaths >= DEATHS:
                    raise
                self._members[self._members.index(worker)] = Worker(self._make_function)

    def run(self, tasks: Iterable[Task | None]) -> Iterator[Outcome]:
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
        for worker in self._members:
            worker.forget_tasks()  # there may have been a run that was broken off
        while self._hand_out() or any(worker.tasks for worker in self._members):
            patience = PAUSE_SECONDS if self._pauses else LOOK_SECONDS
            ready, _ = ray.wait(self._calls, num_returns=1, timeout=patience)
            if ready:
                yield from self._take(ready[0])
            yield from self._give_up_the_silent()

    def _hand_out(self) -> bool:
        """Hand tasks to all workers that can take one; say whether more tasks may come."""
        for depth in range(IN_FLIGHT):
            for worker in self._members:
                held = len(worker.tasks)
                if worker.about is not None or held > depth or depth >= worker.room:
                    continue
                alone = not held and bool(self._again)
                task = self._again.popleft() if alone else next(self._todo, _END)
                self._pauses = task is None
                if task is None or task is _END:
                    return False
                worker.hand(task, alone)
        return True

    def _take(self, call: Any) -> Iterator[Outcome]:
        """Take the answer of a worker."""
        worker = next(worker for worker in self._members if call in worker.calls)
        try:
            answer = ray.get(call, timeout=FETCH_SECONDS)
        except ray.exceptions.RayError as error:
            if worker.tasks:  # it had said who it is: such deaths are few
                self._heard = time.monotonic()
            yield from self._replace(worker, f"{type(error).__name__}: {error}", DEATHS)
            return
        worker.heard = self._heard = time.monotonic()
        if call is worker.about:
            worker.accept(answer)
        else:
            del worker.tasks[call]
            yield answer

    def _give_up_the_silent(self) -> Iterator[Outcome]:
        """Replace workers that have been silent for too long."""
        now = time.monotonic()
        if now - self._looked > STILL_SECONDS:  # nothing here moved: it says nothing of the workers
            self._heard = now
            for worker in self._members:
                worker.heard = now
        for worker in list(self._members):
            silence = now - worker.heard
            if worker.tasks and silence > worker.patience and silent(worker.calls):
                why = f"TimeoutError: no answer in {silence:.0f} s"
                yield from self._replace(worker, why, SILENCES)
        patience = max(worker.answer_patience for worker in self._members)
        if now - self._heard > patience and silent(self._calls):
            raise PoolError(
                f"no worker has answered for {now - self._heard:.0f} s{self._last_loss}; run the "
                "same command again to go on from what is committed"
            )
        self._looked = time.monotonic()

    def _replace(self, worker: Worker, why: str, most: int) -> Iterator[Outcome]:
        """Replace a lost worker, and do its tasks again.

        One of the tasks may have killed the worker, and nobody knows which. So each task is done
        again alone, and given up when it has killed so many workers alone.
        """
        self._last_loss = f" (the last was lost by {why.splitlines()[0]})"
        worker.end()
        new = Worker(self._make_function, after_a_death=most == DEATHS)
        self._members[self._members.index(worker)] = new
        for task in worker.tasks.values():
            self._lost[task.key] += len(worker.tasks) == 1
            if self._lost[task.key] < most:
                self._again.append(task)
            else:
                yield Outcome(task, None, time.monotonic() - worker.heard, "", "", why)

    @property
    def _calls(self) -> list[Any]:
        return [call for worker in self._members for call in worker.calls]
