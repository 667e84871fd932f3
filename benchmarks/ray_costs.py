"""The time that Ray itself takes: to start, and to call workers."""

from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import Any

import pandas as pd

from benchmarks.measure import Say
from pfdist.common.measurement_times import regular
from pfdist.filters.work import Estimation, FilterWork
from pfdist.pools.base import Task
from pfdist.pools.ray_pool import RayPool

_WORK = FilterWork(
    (regular(60, 21),), (60,), (1,), 2, (0, 1000), Estimation(500)
)  # as large as a search's tasks are


def measure_ray(repeats: int, calls: int, say: Say) -> pd.DataFrame:
    """Give the times of a pool with one worker that gives its tasks back unchanged.

    Parameters
    ----------
    repeats : int
        Number of starts of Ray.
    calls : int
        Number of calls after each start.
    say : callable
        Receives a line about the progress.

    Returns
    -------
    DataFrame
        what (``start``; ``call`` in a stream of tasks; ``round trip`` of a single task), repeat,
        seconds.
    """
    rows = []
    for repeat in range(repeats):
        start = perf_counter()
        with RayPool(workers=1) as pool:
            seconds = {"start": perf_counter() - start}
            tasks = [Task(str(number), _echo, _WORK) for number in range(calls)]
            list(pool.run(tasks[: calls // 10]))
            start = perf_counter()
            list(pool.run(tasks))
            seconds["call"] = (perf_counter() - start) / calls
            start = perf_counter()
            for task in tasks:
                list(pool.run([task]))
            seconds["round trip"] = (perf_counter() - start) / calls
        rows += [{"what": what, "repeat": repeat, "seconds": s} for what, s in seconds.items()]
        say(f"Ray started in {seconds['start']:.1f} s, a call takes {seconds['call'] * 1e3:.2f} ms")
    return pd.DataFrame(rows)


@contextmanager
def session(cores: int) -> Iterator[None]:
    """Keep a Ray cluster running that pools join, so that runs need not start Ray."""
    import ray  # noqa: PLC0415  after ray_pool, which sets Ray's environment variables

    ray.init(
        address="local",
        num_cpus=cores,
        include_dashboard=False,
        log_to_driver=False,
        logging_level="ERROR",
    )
    try:
        yield
    finally:
        ray.shutdown()


def _echo(work: Any) -> Any:
    return work
