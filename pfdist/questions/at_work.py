"""The pool of a run or a sweep while it works, and the mark of a process that may crash."""

import contextlib
import os
from collections.abc import Iterable, Iterator
from functools import partial
from time import perf_counter

from pfdist.common import stopping
from pfdist.errors import SilenceError
from pfdist.filters.engines import COMPILED, ENGINES
from pfdist.pools.base import Pool
from pfdist.pools.kinds import POOLS
from pfdist.problem.sections import Execution
from pfdist.runner.build import chosen_pool, make_pool
from pfdist.runner.door import RunSession
from pfdist.runner.progress import Detail, Say
from pfdist.store import remove_file, write_file

_BEGUN = ".begun"
_SAYS = "A process computes here, or has ended without a message.\n"
_CRASHED = (
    "the last process that computed here ended without a message: it was killed, or the model "
    "crashed it (--pool processes isolates the model)"
)


@contextlib.contextmanager
def at_work(execution: Execution, engines: Iterable[str], say: Say) -> Iterator[Pool]:
    """The pool of a run, as a context; a message reports when it is ready, and why it was chosen.

    Parameters
    ----------
    execution : Execution
    engines : iterable of str
        Names as in ``filter.engine``. Formulas that are compiled release Python's lock.
    say : callable

    Raises
    ------
    PoolError
        The pool does not start, or its workers no longer answer; the error names the remedy.
    """
    start, threaded = perf_counter(), release_the_lock(engines)
    execution, reason = chosen_pool(execution, threaded=threaded)
    kind, why = POOLS[execution.pool], f" ({reason})" if reason else ""
    with make_pool(execution) as pool:
        workers = f"{pool.workers} worker{'s' * (pool.workers != 1)}"
        say(Detail(f"{kind.title} is ready: {workers} in {perf_counter() - start:.1f} s{why}"))
        try:
            yield pool
        except SilenceError as error:
            isolate = "" if kind.isolated else "; --pool processes isolates the model"
            raise SilenceError(
                f"{error}; finished work is saved, run the same command to resume{isolate}"
            ) from error


@contextlib.contextmanager
def noted(session: RunSession) -> Iterator[None]:
    """Mark the locked folder of a run while formulas run in this process.

    A formula that crashes the process leaves the mark, and the next process reports the crash.
    """
    begun = session.store.path / _BEGUN
    if os.path.lexists(begun):
        session.say(_CRASHED)
    threaded = release_the_lock([session.built.evaluator.engine])
    execution, _ = chosen_pool(session.built.job.execution, threaded=threaded)
    if not POOLS[execution.pool].isolated:
        write_file(begun, lambda path: path.write_text(_SAYS, encoding="utf-8"))
    forget = partial(remove_file, begun)
    try:
        with stopping.saved(forget):  # a stop is no crash, in whatever way the process ends
            yield
    finally:
        forget()


def release_the_lock(engines: Iterable[str]) -> bool:
    """Whether the formulas of all engines are compiled, and so release Python's lock."""
    return all(ENGINES.get(name, COMPILED).compiled for name in engines)
