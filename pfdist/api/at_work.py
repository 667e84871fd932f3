"""A session in the pool of a job."""

import contextlib
from collections.abc import Callable, Iterator
from time import perf_counter
from typing import Any

from pfdist.pools.base import Pool
from pfdist.pools.kinds import POOLS
from pfdist.runner.build import Built, make_pool
from pfdist.runner.progress import Show
from pfdist.runner.session import Session
from pfdist.store import Store

AtWork = Callable[
    [Built, Store, Show, Callable[[str], Any]], contextlib.AbstractContextManager[Session]
]
"""Gives a session that computes a run; see `at_work`."""


@contextlib.contextmanager
def at_work(built: Built, store: Store, show: Show, say: Callable[[str], Any]) -> Iterator[Session]:
    """Start the pool of a job, and end it again.

    Parameters
    ----------
    built : Built
    store : Store
    show : callable
        Receives the progress.
    say : callable
        Receives a line when the pool is ready.
    """
    execution, start = built.job.execution, perf_counter()
    with make_pool(built, execution) as pool:
        say_ready(pool, execution.pool, perf_counter() - start, say)
        session = Session.start(built, store, pool, show, say)
        yield session
        session.reporter.finish()


def say_ready(pool: Pool, name: str, seconds: float, say: Callable[[str], Any]) -> None:
    """Say that the workers of a pool are ready, and how long they took."""
    workers = f"{pool.workers} worker{'s' * (pool.workers != 1)}"
    say(f"{POOLS[name].title} is ready: {workers} in {seconds:.1f} s")
