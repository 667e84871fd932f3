"""The work of a worker in another process.

A worker unpickles a function once for all its tasks, and keeps the last 32 functions. If a task
exceeds its time limit, the process ends itself, even if a formula never releases Python's lock.
"""

import faulthandler
import hashlib
import os
import platform
import time
from collections.abc import Callable, Iterable
from functools import cache
from typing import Any, NamedTuple

import cloudpickle
from threadpoolctl import threadpool_limits

from pfdist.errors import PfdistError
from pfdist.pools.base import Function, Outcome, Task, do, patience

START_SECONDS = 60.0  # for which a worker may start and make a function
_SHOWN = 300  # characters of an error
_ONE_THREAD = {"XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false", "NPROC": "1"}  # as JAX reads it
FUNCTIONS = 32
"""Number of functions that a worker keeps; the oldest is dropped."""

Answer = tuple[Any, float, str, str, str | None, bool]
"""The fields of `pfdist.pools.base.Outcome` but the task."""

_functions: dict[str, Function] = {}


def answer(key: str, content: Callable[[], bytes], work: Any, most: float) -> Answer:
    """The answer to a task, which may take so many seconds.

    `content` gives the pickled function; it is called only if the worker lacks the function.
    """
    try:
        function = _functions.get(key) or _made(key, content())
    except Exception as error:
        kind = "" if isinstance(error, PfdistError) else f"{type(error).__name__}: "
        refusal = f"{kind}{error} (found by a worker on {platform.node()})"
        return None, 0.0, "", "", refusal, True
    faulthandler.dump_traceback_later(most, exit=True, file=_nowhere())
    try:
        return *do(function, work), False
    finally:
        faulthandler.cancel_dump_traceback_later()


class Sent(NamedTuple):
    """A task that was handed out, and when."""

    task: Task
    since: float


def failed(sent: Sent, error: BaseException | None = None) -> Outcome:
    """The outcome of a task whose worker died, or that cannot be sent."""
    why = f": {type(error).__name__}: {' '.join(str(error).split())[:_SHOWN]}" if error else ""
    text = (
        "its worker ended: it crashed, ran out of memory, or took longer than "
        f"{patience(sent.task.seconds):.0f} s{why}"
    )
    return Outcome(sent.task, None, time.monotonic() - sent.since, "", "", text)


def silence_limit(sent: Iterable[Sent]) -> float:
    """Seconds within which some task must have an answer, given the time limits of tasks."""
    return 2 * max([START_SECONDS, *(patience(each.task.seconds) for each in sent)])


def pickled(function: Function) -> tuple[str, bytes]:
    """The key of a function for workers, and its pickled content."""
    content = cloudpickle.dumps(function)
    return hashlib.blake2b(content, digest_size=16).hexdigest(), content


def _made(key: str, content: bytes) -> Function:
    if len(_functions) == FUNCTIONS:
        del _functions[next(iter(_functions))]
    for name, value in _ONE_THREAD.items():  # each core has a worker
        os.environ.setdefault(name, value)
    function: Function = cloudpickle.loads(content)
    threadpool_limits(1)  # of BLAS and OpenMP, which may be loaded only now
    _functions[key] = function
    return function


@cache
def _nowhere() -> int:
    return os.open(os.devnull, os.O_WRONLY)
