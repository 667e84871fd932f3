"""The work of a worker in another process.

A worker unpickles a function once for all its tasks, and keeps the last 32 functions. If a task
exceeds its limit, the process ends itself: the operating system counts the processor time, and a
thread of the worker looks for tasks that sleep. A task of a busy machine does neither.
"""

import contextlib
import hashlib
import os
import platform
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import cloudpickle
from threadpoolctl import threadpool_limits

from pfdist.errors import PfdistError
from pfdist.pools.base import STILL_SECONDS, Function, Outcome, Task, do, patience

# Within so many seconds some worker must answer, however busy the machine is, and while other
# programs have the cores of a cluster, or new nodes start:
SILENCE_SECONDS = 900.0
LOOK_SECONDS = 0.5  # between two looks whether a task computes
_SHOWN = 300  # characters of an error
_ONE_THREAD = {"XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false", "NPROC": "1"}  # as JAX reads it
FUNCTIONS = 32
"""Number of functions that a worker keeps; the oldest is dropped."""

Answer = tuple[Any, float, str, str, str | None, bool]
"""The fields of `pfdist.pools.base.Outcome` but the task."""

_functions: dict[str, Function] = {}


def answer_task(key: str, content: Callable[[], bytes], work: Any, most: float) -> Answer:
    """The answer to a task, which may compute, or sleep, for so many seconds.

    `content` gives the pickled function; it is called only if the worker lacks the function.
    """
    try:
        function = _functions.get(key) or _made(key, content())
    except Exception as error:
        kind = "" if isinstance(error, PfdistError) else f"{type(error).__name__}: "
        refusal = f"{kind}{error} (found by a worker on {platform.node()})"
        return None, 0.0, "", "", refusal, True
    with _limited(most):
        return *do(function, work), False


class Sent(NamedTuple):
    """A task that was handed out, and when."""

    task: Task
    since: float


def failed(sent: Sent, error: BaseException | None = None) -> Outcome:
    """The outcome of a task whose worker died, or that cannot be sent."""
    why = f": {type(error).__name__}: {' '.join(str(error).split())[:_SHOWN]}" if error else ""
    text = (
        "its worker ended: it crashed, ran out of memory, or computed or slept for longer than "
        f"{patience(sent.task.seconds):.0f} s{why}"
    )
    return Outcome(sent.task, None, time.monotonic() - sent.since, "", "", text)


def silence_limit(sent: Iterable[Sent]) -> float:
    """Seconds within which some task must have an answer, given the limits of tasks."""
    return max([SILENCE_SECONDS, *(2 * patience(each.task.seconds) for each in sent)])


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


@contextlib.contextmanager
def _limited(seconds: float) -> Iterator[None]:
    """End this process if it computes for so many seconds, or sleeps for so many."""
    watch = _watch()
    signal.setitimer(signal.ITIMER_PROF, seconds)  # SIGPROF ends a process that does not handle it
    watch.limit = [seconds]
    try:
        yield
    finally:
        watch.limit = None
        signal.setitimer(signal.ITIMER_PROF, 0.0)


@cache
def _watch() -> "_Watch":
    return _Watch()


class _Watch(threading.Thread):
    """A thread that ends the process if its task sleeps for too long; with /proc alone (Linux)."""

    def __init__(self) -> None:
        super().__init__(daemon=True)
        self.limit: list[float] | None = None  # of the present task: a new object for each
        self.start()

    def run(self) -> None:
        limit, slept, looked = self.limit, 0.0, time.monotonic()
        while True:
            time.sleep(LOOK_SECONDS)
            now = time.monotonic()
            passed, looked = now - looked, now
            if limit is None or self.limit is not limit or _computes():
                limit, slept = self.limit, 0.0
            elif passed < STILL_SECONDS:  # else the process was stopped, or did not get a processor
                slept += passed
                if slept > limit[0]:
                    os._exit(1)


def _computes() -> bool:
    """Whether a thread of this process but the present one runs, or waits for a processor only."""
    own = threading.get_native_id()
    for each in Path("/proc/self/task").glob("[0-9]*"):
        with contextlib.suppress(OSError):  # the thread has ended
            state = (each / "stat").read_text(errors="replace").rpartition(")")[2].split()[0]
            if state == "R" and int(each.name) != own:
                return True
    return not Path("/proc/self/task").is_dir()
