"""Processes below this one, as Linux lists them; see proc(5)."""

import contextlib
import os
import signal
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

_PROC = Path("/proc")
_PARENT, _STARTED = 1, 19  # places in ``stat``, after the command in parentheses


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


def end(processes: Iterable[Process]) -> None:
    """End those that still live, at once: what is stopped would hear nothing else."""
    for process in set(processes).intersection(_everyone()):
        with contextlib.suppress(ProcessLookupError):
            os.kill(process.id, signal.SIGKILL)


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
