"""The pool of Ray workers. Ray is a pool here and nothing else, and is named nowhere else.

The workers are long-lived actors: a call to one costs 0.7 ms, a stateless task 2 to 5 ms, and an
actor loads its filter once, or compiles it. Each is handed its next task before it has ended the
last one.
"""

import logging
import os
import signal
import socket
import threading
import warnings
from collections import Counter
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
DEATHS = 3  # of workers that had a task, before the task is given up
PATIENCE_SECONDS = 600.0  # a task takes seconds; when none ends in this time, none will
START_SECONDS = 120.0
CONNECT_SECONDS = 10.0
_ONE_THREAD = {
    f"{library}_NUM_THREADS": "1" for library in ("OMP", "MKL", "OPENBLAS", "NUMBA", "NUMEXPR")
}
_OBJECT_STORE_BYTES = 100 * 1024**2  # outcomes are kilobytes


@ray.remote(num_cpus=1)
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
        self._actors: list[Any] = []
        self.workers = workers

    def __enter__(self) -> Self:
        try:
            self._connect()
            if not self.workers:
                self.workers = max(1, int(ray.cluster_resources().get("CPU", 1)))
            self._actors = [self._new_worker() for _ in range(self.workers)]
            ray.get([actor.ready.remote() for actor in self._actors], timeout=START_SECONDS)
        except (RayError, OSError, RuntimeError, ValueError) as error:
            self.__exit__()
            reason = str(error).strip().splitlines()
            raise PoolError(
                f"Ray could not start workers{f' at {self._address!r}' if self._address else ''}: "
                f"{reason[-1] if reason else type(error).__name__}; "
                "--pool serial computes the same without Ray"
            ) from error
        return self

    def __exit__(self, *_: object) -> None:
        if self._started:
            ray.shutdown()  # the workers go with it
            self._started = False
        elif ray.is_initialized():
            for actor in self._actors:
                ray.kill(actor)
        self._actors = []

    def run(self, tasks: Iterable[Task]) -> Iterator[Outcome]:
        """Give the outcomes as the workers end their tasks, with a bounded number in flight.

        A worker that dies is replaced and what it had is done again.

        Raises
        ------
        PoolError
            No worker answers.
        """
        waiting: dict[Any, tuple[Task, int, Any]] = {}
        deaths: Counter[str] = Counter()

        def submit(task: Task, slot: int) -> None:
            actor = self._actors[slot]
            waiting[actor.do.remote(task)] = (task, slot, actor)

        todo = iter(tasks)
        slots = cycle(range(self.workers))
        for slot, task in zip(islice(slots, IN_FLIGHT * self.workers), todo, strict=False):
            submit(task, slot)
        while waiting:
            ready, _ = ray.wait(list(waiting), num_returns=1, timeout=PATIENCE_SECONDS)
            if not ready:
                raise PoolError(
                    f"no worker has ended a task in {PATIENCE_SECONDS:.0f} s; "
                    "run the same command again to go on from what is committed"
                )
            task, slot, actor = waiting.pop(ready[0])
            try:
                outcome: Outcome = ray.get(ready[0], timeout=PATIENCE_SECONDS)
            except RayError as error:
                deaths[task.key] += 1
                if self._actors[slot] is actor:
                    self._actors[slot] = self._new_worker()
                if deaths[task.key] < DEATHS:
                    submit(task, slot)
                    continue
                outcome = Outcome(task, None, 0.0, "", "", f"{type(error).__name__}: {error}")
            following = next(todo, None)
            if following is not None:
                submit(following, slot)
            yield outcome

    def _new_worker(self) -> Any:
        options = _Worker.options(runtime_env={"env_vars": _ONE_THREAD})  # type: ignore[attr-defined]
        return options.remote(self._make_function)

    def _connect(self) -> None:
        if ray.is_initialized():
            return
        options: dict[str, Any] = {"log_to_driver": False, "logging_level": logging.ERROR}
        if self._address:
            _check_reachable(self._address)
            options["address"] = self._address
        else:
            options |= {
                "address": "local",
                "num_cpus": self.workers or len(os.sched_getaffinity(0)),
                "num_gpus": 0,
                "include_dashboard": False,
                "object_store_memory": _OBJECT_STORE_BYTES,
            }
        before = signal.getsignal(signal.SIGTERM)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)
            ray.init(**options)
        self._started = True
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, before)  # Ray takes it for itself, and exits with 1


def _check_reachable(address: str) -> None:
    """Ray itself waits for minutes where nobody listens."""
    host, colon, port = address.removeprefix("ray://").rpartition(":")
    if colon and port.isdigit():
        socket.create_connection((host, int(port)), timeout=CONNECT_SECONDS).close()
