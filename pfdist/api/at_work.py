"""The pool of a run or a sweep, entered and left."""

import contextlib
from collections.abc import Iterator
from pathlib import Path
from time import perf_counter

from pfdist.api.following import Say
from pfdist.job.sections import Execution
from pfdist.pools.base import Pool
from pfdist.pools.kinds import POOLS
from pfdist.runner.build import make_pool

_BEGUN = ".begun"
"""A file in the folder of a run or sweep, while formulas run in the process of the driver."""


@contextlib.contextmanager
def at_work(execution: Execution, folder: Path, say: Say) -> Iterator[Pool]:
    """Enter the pool that [execution] names, and say that its workers are ready.

    A formula that crashes the process of the driver leaves no word. So a file in the folder says
    that such a process has begun, and the next process speaks in its place.
    """
    kind, begun, start = POOLS[execution.pool], folder / _BEGUN, perf_counter()
    if begun.exists():
        say("the last process ended without a word; --pool ray isolates the model, if it crashes")
    with make_pool(execution) as pool:
        workers = f"{pool.workers} worker{'s' * (pool.workers != 1)}"
        say(f"{kind.title} is ready: {workers} in {perf_counter() - start:.1f} s")
        if not kind.isolated:
            begun.touch()
        try:
            yield pool
        finally:
            begun.unlink(missing_ok=True)
