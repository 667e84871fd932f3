"""The processes of this machine that began with a mark in their environment, and their families."""

import contextlib
import time
from collections.abc import Collection, Iterable
from pathlib import Path

import psutil
from psutil import Process

_PAUSE_SECONDS = 0.05  # between two searches for processes that are to end


def marked(name: str, value: str, known: Collection[Process] = ()) -> list[Process]:
    """Give the processes that began with a variable of this value, and all processes below them.

    Children inherit such a mark, whoever adopts them. But Ray's agents overwrite their environment
    with their titles, so they are found below the server that started them. If this server may have
    ended meanwhile, an earlier answer helps.

    Parameters
    ----------
    name, value : str
        The mark.
    known : collection of psutil.Process
        Processes of which it is known that they belong to these.
    """
    mark = f"{name}={value}".encode()
    everyone = [
        process
        for process in psutil.process_iter(["ppid", "status"])
        if process.info["status"] != psutil.STATUS_ZOMBIE
    ]
    found = [process for process in everyone if process in known or _has_mark(process, mark)]
    for process in found:  # the list grows while it is walked
        children = (child for child in everyone if child.info["ppid"] == process.pid)
        found += [child for child in children if child not in found]
    return found


def end(processes: Iterable[Process]) -> None:
    """Kill the processes that still live, because a stopped process obeys no other signal."""
    for process in processes:
        with contextlib.suppress(psutil.NoSuchProcess):
            process.kill()  # never a later process that has the same number


def end_marked(
    name: str, value: str, quiet: float, most: float, known: Collection[Process] = ()
) -> None:
    """End all processes with a mark, and those that begin meanwhile.

    Parameters
    ----------
    name, value : str
        The mark; see `marked`.
    quiet : float
        The search ends when no such process was found for so many seconds.
    most : float
        Seconds after which the search ends in any case.
    known : collection of psutil.Process
        See `marked`.
    """
    start = last = time.monotonic()
    while (now := time.monotonic()) - start <= most:
        if known := marked(name, value, known):
            last = now
            end(known)
        elif now - last >= quiet:
            return
        time.sleep(_PAUSE_SECONDS)


def _has_mark(process: Process, mark: bytes) -> bool:
    """Whether the environment holds ``name=value``; psutil stops at zeros that a title leaves."""
    try:
        return mark in Path(f"/proc/{process.pid}/environ").read_bytes().split(b"\0")
    except OSError:  # the process has ended, or belongs to another user
        return False
