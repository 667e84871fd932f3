"""Processes of this machine, as Linux lists them; see proc(5)."""

import contextlib
import os
import signal
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

_PROC = Path("/proc")
_PARENT, _STARTED = 1, 19  # places in ``stat``, after the command in parentheses
_LOOK_SECONDS = 0.05  # between two looks for processes that are to end


@dataclass(frozen=True)
class Process:
    """A process, not to be taken for a later one that has its number.

    Parameters
    ----------
    id : int
    started : int
        Ticks of the clock since the machine started.
    parent : int
        When it was looked at.
    """

    id: int
    started: int
    parent: int = field(compare=False)


def family(parent: int, word: str = "", but: Iterable[Process] = ()) -> list[Process]:
    """Give the processes below a process.

    Parameters
    ----------
    parent : int
    word : str
        Children in whose command it does not stand are left out, with all that is below them.
    but : iterable of Process
        Are left out likewise.
    """
    everyone = set(_everyone()).difference(but)
    found = [one for one in everyone if one.parent == parent and word in _command(one)]
    for one in found:  # it grows as it is walked
        found += [child for child in everyone if child.parent == one.id]
    return found


def marked(name: str, value: str) -> list[Process]:
    """Give the processes whose environment had a variable of this value when they began.

    A process cannot lose such a mark, and its children inherit it, whoever adopts them.
    """
    mark = f"{name}={value}".encode()
    return [process for process in _everyone() if mark in _environment(process)]


def end(processes: Iterable[Process]) -> None:
    """End those that still live, at once: what is stopped would hear nothing else."""
    for process in set(processes).intersection(_everyone()):
        with contextlib.suppress(ProcessLookupError):
            os.kill(process.id, signal.SIGKILL)


def end_marked(name: str, value: str, quiet: float, most: float) -> None:
    """End all processes with a mark, and those that are born meanwhile.

    Parameters
    ----------
    name, value : str
        The mark; see `marked`.
    quiet : float
        Seconds in which no such process may be found before the search ends.
    most : float
        Seconds after which it ends in any case.
    """
    start = last = time.monotonic()
    while (now := time.monotonic()) - start <= most:
        if found := marked(name, value):
            last = now
            end(found)
        elif now - last >= quiet:
            return
        time.sleep(_LOOK_SECONDS)


def _everyone() -> Iterator[Process]:
    for folder in _PROC.glob("[0-9]*"):
        with contextlib.suppress(OSError):  # it has ended meanwhile
            stat = (folder / "stat").read_text(encoding="utf-8", errors="replace")
            fields = stat.rpartition(")")[2].split()
            yield Process(int(folder.name), int(fields[_STARTED]), int(fields[_PARENT]))


def _command(process: Process) -> str:
    with contextlib.suppress(OSError):
        return (_PROC / f"{process.id}" / "cmdline").read_text(encoding="utf-8", errors="replace")
    return ""


def _environment(process: Process) -> list[bytes]:
    with contextlib.suppress(OSError):  # it has ended, or is another user's
        return (_PROC / f"{process.id}" / "environ").read_bytes().split(b"\0")
    return []
