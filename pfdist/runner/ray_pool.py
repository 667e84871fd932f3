"""The pool of Ray workers. Ray is a pool here and nothing else, and is named nowhere else.

The workers are long-lived actors: a call to one costs 0.7 ms, a stateless task 2 to 5 ms, and an
actor compiles its filter once. Each is handed its next task before it has ended the last one.
"""

import logging
import os
import warnings
from collections.abc import Callable, Iterable, Iterator
from itertools import cycle, islice
from typing import Any, Self

# Before Ray is imported: its defaults speak of themselves on standard error and to their makers.
os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")

import ray
from ray.exceptions import RayError

from pfdist.errors import PoolError
from pfdist.runner.pool import Outcome, Task, do

IN_FLIGHT = 2  # tasks a worker: the one it does and the one that waits for it
PATIENCE_SECONDS = 600.0  # a task takes seconds; when none ends in this time, none will
START_SECONDS = 120.0
_ONE_THREAD = {
    f"{library}_NUM_THREADS": "1" for library in ("OMP", "MKL", "OPENBLAS", "NUMBA", "NUMEXPR")
}
_OBJECT_STORE_BYTES = 100 * 1024**2  # outcomes are kilobytes


@ray.remote(num_cpus=1, max_restarts=3, max_task_retries=3)
class _Worker:
    def __init__(self, make_function: Callable[[], Callable[[Any], Any]]) -> None:
        self._function = make_function()

    def ready(self) -> bool:
        return True

    def do(self, task: Task) -> Outcome:
        return do(self._function, task)


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
        Of an existing cluster; empty starts a local one, unless this process has joined one.

    Raises
    ------
    PoolError
        On entering: Ray does not start, or does not answer.
    """

    def __init__(
        self,
        make_function: Callable[[], Callable[[Any], Any]],
        workers: int = 0,
        address: str = "",
    ) -> None:
        self._make_function = make_function
        self._address = address
        self._started = False
        self.workers = workers

    def __enter__(self) -> Self:
        try:
            self._connect()
            if not self.workers:
                self.workers = max(1, int(ray.cluster_resources().get("CPU", 1)))
            environment = {"env_vars": _ONE_THREAD}
            make = _Worker.options(runtime_env=environment)  # type: ignore[attr-defined]
            self._actors = [make.remote(self._make_function) for _ in range(self.workers)]
            ray.get([actor.ready.remote() for actor in self._actors], timeout=START_SECONDS)
        except (RayError, ConnectionError, RuntimeError, ValueError, TimeoutError) as error:
            self.__exit__()
            reason = str(error).strip().splitlines()
            raise PoolError(
                f"Ray gave no {self.workers or ''} workers within {START_SECONDS:.0f} s"
                f"{f' at {self._address!r}' if self._address else ''}: "
                f"{reason[-1] if reason else type(error).__name__}; "
                "--pool serial computes the same without Ray"
            ) from error
        return self

    def __exit__(self, *_: object) -> None:
        for actor in getattr(self, "_actors", []):
            ray.kill(actor)
        self._actors = []
        if self._started:
            ray.shutdown()
            self._started = False

    def run(self, tasks: Iterable[Task]) -> Iterator[Outcome]:
        """Give the outcomes as the workers end their tasks, with a bounded number in flight.

        Raises
        ------
        PoolError
            No worker answers.
        """
        waiting: dict[Any, tuple[Task, Any]] = {}
        todo = iter(tasks)
        for task, actor in zip(
            islice(todo, IN_FLIGHT * self.workers), cycle(self._actors), strict=False
        ):
            waiting[actor.do.remote(task)] = (task, actor)
        while waiting:
            ready, _ = ray.wait(list(waiting), num_returns=1, timeout=PATIENCE_SECONDS)
            if not ready:
                raise PoolError(
                    f"no worker has ended a task in {PATIENCE_SECONDS:.0f} s; "
                    "run the same command again to go on from what is committed"
                )
            task, actor = waiting.pop(ready[0])
            following = next(todo, None)
            if following is not None:
                waiting[actor.do.remote(following)] = (following, actor)
            yield self._outcome(ready[0], task)

    def _outcome(self, reference: Any, task: Task) -> Outcome:
        try:
            outcome: Outcome = ray.get(reference, timeout=PATIENCE_SECONDS)
        except RayError as error:  # the worker itself died, more often than it is restarted
            return Outcome(task, None, 0.0, "", "", f"{type(error).__name__}: {error}")
        return outcome

    def _connect(self) -> None:
        if ray.is_initialized():
            return
        options: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
        if self._address:
            options["address"] = self._address
        else:
            options |= {
                "address": "local",
                "num_cpus": self.workers or len(os.sched_getaffinity(0)),
                "num_gpus": 0,
                "include_dashboard": False,
                "object_store_memory": _OBJECT_STORE_BYTES,
            }
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)
            ray.init(**options)
        self._started = True
