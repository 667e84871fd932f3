"""One worker of the pool of Ray workers: what it does, which answers it owes, when it is lost."""

import contextlib
import threading
import time
from collections.abc import Callable, Mapping
from importlib.metadata import version
from typing import Any

from pfdist.errors import ModelError, PfdistError, PoolError
from pfdist.pools.base import Outcome, Task, do
from pfdist.pools.precautions import within
from pfdist.pools.ray_cluster import ANSWER_BYTES, START_SECONDS, about, ray

IN_FLIGHT = 2  # tasks a worker: the one it does and the one that waits for it
PATIENCE_SECONDS = 15.0  # a worker is taken for lost when it is silent for so long, and for
PATIENCE_TIMES = 20  # so many times what its task should take
ANSWER_SECONDS = 40.0  # when all are silent for so long, nobody will answer
_ENVIRONMENT = {
    f"{library}_NUM_THREADS": "1" for library in ("OMP", "MKL", "OPENBLAS", "NUMBA", "NUMEXPR")
} | ANSWER_BYTES


@ray.remote(num_cpus=1)
class _Actor:
    """The worker's process, as Ray runs it."""

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


class Worker:
    """A worker as the driver knows it: its actor, and the answers that it owes.

    Nothing is handed to a worker that has not said who it is: it may never start, as on a cluster
    that has lost a node.

    Parameters
    ----------
    make_function : callable
        Makes, in the worker, the function that is applied to each task's work.
    after_a_death : bool
        Whether Ray itself has said that the worker in whose place it comes has ended.

    Attributes
    ----------
    about : Any
        The call that asks who the worker is, until it is answered; then None.
    tasks : dict
        The task of each call that is not answered yet.
    room : int
        For so many tasks.
    heard : float
        When the worker last answered, or had nothing to do, on the monotonic clock.
    """

    def __init__(
        self, make_function: Callable[[], Callable[[Any], Any]], after_a_death: bool = False
    ) -> None:
        options = _Actor.options(runtime_env={"env_vars": _ENVIRONMENT})  # type: ignore[attr-defined]
        self._actor = options.remote(make_function)
        self._after_a_death = after_a_death
        self.about: Any = self._actor.about.remote()
        self.tasks: dict[Any, Task] = {}
        self.room = IN_FLIGHT
        self.heard = time.monotonic()

    @property
    def calls(self) -> list[Any]:
        """The calls that the worker has not answered yet."""
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
        starting = self._after_a_death and self.about is not None
        return START_SECONDS if starting else max(ANSWER_SECONDS, 2 * self.patience)

    def hand(self, task: Task, alone: bool) -> None:
        """Hand the worker a task; alone if no other may wait for it meanwhile."""
        if not self.tasks:
            self.heard, self.room = time.monotonic(), 1 if alone else IN_FLIGHT
        self.tasks[self._actor.do.remote(task)] = task

    def forget_tasks(self) -> None:
        """Forget tasks of a run that was broken off; their answers are ignored."""
        self.tasks, self.room = {}, IN_FLIGHT

    def accept(self, about: Mapping[str, Any]) -> None:
        """Accept who the worker says it is.

        Raises
        ------
        PoolError
            It has another version of pfdist.
        ModelError
            It could not make its function.
        """
        self.about = None
        if about["pfdist"] != version("pfdist"):
            raise PoolError(
                f"every node must have pfdist {version('pfdist')}, got {about['pfdist']} on "
                f"{about['host']}: install the same version there"
            )
        if about["refusal"]:
            raise ModelError(f"{about['refusal']} (found by a worker on {about['host']})")

    def end(self) -> threading.Thread:
        """End the worker in a thread, because the request may never return."""

        def kill() -> None:
            with contextlib.suppress(ray.exceptions.RayError, ValueError):
                ray.kill(self._actor)

        return within(0.0, kill)


def silent(calls: list[Any]) -> bool:
    """Whether none of these calls has been answered; an answer may still wait to be taken."""
    return not ray.wait(calls, timeout=0)[0]
