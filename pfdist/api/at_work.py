"""A session in the pool of a job."""

import contextlib
from collections.abc import Callable, Iterator
from time import perf_counter
from typing import Any

from pfdist.pools.kinds import POOLS
from pfdist.runner.build import Built, make_pool
from pfdist.runner.progress import Show
from pfdist.runner.session import Session
from pfdist.store import Store


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
        seconds = perf_counter() - start
        workers = f"{pool.workers} worker{'s' * (pool.workers != 1)}"
        say(f"{POOLS[execution.pool].title} is ready: {workers} in {seconds:.1f} s")
        session = Session.start(built, store, pool, show, say)
        yield session
        session.reporter.finish()
