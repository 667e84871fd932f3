"""The processes of this machine that began with a mark in their environment, and their families."""

import contextlib
import time
from collections.abc import Iterable
from pathlib import Path

import psutil
from psutil import Process

_PAUSE_SECONDS = 0.05  # between two searches for processes that are to end


def marked(name: str, value: str) -> list[Process]:
    """Give the processes that began with a variable of this value, and all processes below them.

    Children inherit such a mark, whoever adopts them. But Ray's agents overwrite their environment
    with their titles, so they are found below the server that started them.
    """
    mark = f"{name}={value}".encode()
    everyone = list(psutil.process_iter(["ppid"]))
    found = [process for process in everyone if _has_mark(process, mark)]
    for process in found:  # the list grows while it is walked
        children = (child for child in everyone if child.info["ppid"] == process.pid)
        found += [child for child in children if child not in found]
    return found


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
    """Whether the environment holds ``name=value``; psutil stops at zeros that a title leaves."""
    try:
        return mark in Path(f"/proc/{process.pid}/environ").read_bytes().split(b"\0")
    except OSError:  # the process has ended, or belongs to another user
        return False
