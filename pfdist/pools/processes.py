"""The processes of this machine that carry a mark in their environment."""

import contextlib
import time
from collections.abc import Iterable
from pathlib import Path

import psutil
from psutil import Process

_PAUSE_SECONDS = 0.05  # between two searches for processes that are to end


def marked(name: str, value: str) -> list[Process]:
    """Give the processes whose environment had a variable of this value when they began.

    A process cannot lose such a mark, and its children inherit the mark, whoever adopts them.
    """
    mark = f"{name}={value}".encode()
    return [process for process in psutil.process_iter() if _has_mark(process, mark)]


def end(processes: Iterable[Process]) -> None:
    """Kill the processes that still live, because a stopped process obeys no other signal."""
    for process in processes:
        with contextlib.suppress(psutil.NoSuchProcess):
            process.kill()  # never a later process that has the same number


def end_marked(name: str, value: str, quiet: float, most: float) -> None:
    """End all processes with a mark, and those that begin meanwhile.

    Parameters
    ----------
    name, value : str
        The mark; see `marked`.
    quiet : float
        The search ends when no such process was found for so many seconds.
    most : float
        Seconds after which the search ends in any case.
    """
    start = last = time.monotonic()
    while (now := time.monotonic()) - start <= most:
        if found := marked(name, value):
            last = now
            end(found)
        elif now - last >= quiet:
            return
        time.sleep(_PAUSE_SECONDS)


def _has_mark(process: Process, mark: bytes) -> bool:
    """Whether the environment holds ``name=value``.

    Ray's agents overwrite the beginning of their environment with their titles. psutil's
    ``environ`` ends at the zeros that are left there, so the whole block is read here.
    """
    try:
        return mark in Path(f"/proc/{process.pid}/environ").read_bytes().split(b"\0")
    except OSError:  # the process has ended, or belongs to another user
        return False
