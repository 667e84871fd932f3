"""The pool of a job, entered and left."""

import contextlib
from collections.abc import Callable, Iterator
from time import perf_counter
from typing import Any

from pfdist.job.sections import Execution
from pfdist.pools.base import Pool
from pfdist.pools.kinds import POOLS
from pfdist.runner.build import Built, make_pool


def pool_of_job(built: Built, say: Callable[[str], Any]) -> contextlib.AbstractContextManager[Pool]:
    """The pool of a job, which is entered with the first task; see `said`."""
    return said(make_pool(built, built.job.execution), built.job.execution, say)


def pool_in_this_process(built: Built) -> Pool:
    """A serial pool, for questions that take less time than workers take to start."""
    return make_pool(built, Execution(pool="serial"))


@contextlib.contextmanager
def said(pool: Pool, execution: Execution, say: Callable[[str], Any]) -> Iterator[Pool]:
    """Enter a pool, and say that its workers are ready and how long they took."""
    start = perf_counter()
    with pool:
        workers = f"{pool.workers} worker{'s' * (pool.workers != 1)}"
        title, seconds = POOLS[execution.pool].title, perf_counter() - start
        say(f"{title} is ready: {workers} in {seconds:.1f} s")
        yield pool
