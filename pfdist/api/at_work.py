"""The pool of a run or a sweep, entered and left."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from time import perf_counter

from pfdist.api.following import Say
from pfdist.job.sections import Execution
from pfdist.pools.base import Pool
from pfdist.pools.kinds import POOLS
from pfdist.runner.build import make_pool
from pfdist.store import remove_file, write_file

_BEGUN = ".begun"
_SAYS = "A process computes here, or has ended without a word.\n"
_SILENT = (
    "the last process that computed here ended without a word: it was killed, or the model crashed "
    "it (--pool ray isolates the model)"
)


@contextlib.contextmanager
def at_work(execution: Execution, folder: Path, say: Say) -> Iterator[Pool]:
    """Enter the pool that [execution] names, and say that its workers are ready.

    A formula that crashes the process of the driver leaves no word. So a file in the folder of the
    run or sweep says that such a process has begun, and the next process speaks in its place.
    """
    kind, begun, start = POOLS[execution.pool], folder / _BEGUN, perf_counter()
    if os.path.lexists(begun):
        say(_SILENT)
    with make_pool(execution) as pool:
        workers = f"{pool.workers} worker{'s' * (pool.workers != 1)}"
        say(f"{kind.title} is ready: {workers} in {perf_counter() - start:.1f} s")
        if not kind.isolated:
            write_file(begun, lambda path: path.write_text(_SAYS, encoding="utf-8"))
        try:
            yield pool
        finally:
            remove_file(begun)
