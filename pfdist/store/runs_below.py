"""Find the folders of runs below a folder, and measure them, without reading any file."""

import os
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from pfdist.common.natural_order import natural_key
from pfdist.errors import StoreError

_RUN = "run.json"
# A start that was cut short, and a run that has lost its run.json, have these.
_TRACES = ({"job.toml", "manifest"}, {"tables", "manifest"})


@dataclass(frozen=True)
class Extent:
    """How large a folder is, and when it changed last.

    Parameters
    ----------
    bytes : int
        Sum of the lengths of all files.
    changed : float
        Seconds since 1970 at which the newest file or folder changed.
    """

    bytes: int
    changed: float


def runs_below(folder: Path, depth: int) -> Iterator[Path]:
    """Yield the folders of runs, in the order of their names; numbers are ordered as numbers.

    Links are not followed, and hidden folders are skipped. So are folders within a run. A folder
    below that cannot be listed is yielded as if it held a run: whoever opens it is told why.

    Parameters
    ----------
    folder : Path
        If it holds a run, it is the only one.
    depth : int
        How many levels of folders below this one are looked into.

    Raises
    ------
    StoreError
        The folder itself cannot be listed.
    """
    try:
        entries = _listed(folder)
    except OSError as error:
        raise StoreError(f"cannot list {folder}: {error.strerror}") from error
    if _is_run(entries):
        yield folder
    else:
        yield from _inside(folder, entries, depth)


def extent(folder: Path) -> Extent:
    """Measure a folder with all that lies in it; links count as themselves.

    Entries that cannot be read, or that vanish meanwhile, are left out.
    """
    total, changed, waiting = 0, 0.0, [os.fspath(folder)]
    while waiting:
        try:
            with os.scandir(waiting.pop()) as found:
                entries = list(found)
        except OSError:
            continue
        for entry in entries:
            try:
                about = entry.stat(follow_symlinks=False)
            except OSError:
                continue
            changed = max(changed, about.st_mtime)
            if stat.S_ISDIR(about.st_mode):
                waiting.append(entry.path)
            else:
                total += about.st_size
    return Extent(total, changed)


def _inside(folder: Path, entries: dict[str, bool], depth: int) -> Iterator[Path]:
    if not depth:
        return
    for name in sorted(entries, key=natural_key):
        if name.startswith(".") or not entries[name]:
            continue
        path = folder / name
        try:
            inner = _listed(path)
        except OSError:
            yield path
            continue
        if _is_run(inner):
            yield path
        else:
            yield from _inside(path, inner, depth - 1)


def _listed(folder: Path) -> dict[str, bool]:
    """Give the names of all entries, and whether each is a folder and no link."""
    with os.scandir(folder) as entries:
        return {entry.name: entry.is_dir(follow_symlinks=False) for entry in entries}


def _is_run(entries: dict[str, bool]) -> bool:
    return _RUN in entries or any(traces <= entries.keys() for traces in _TRACES)
