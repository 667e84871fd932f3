"""Strange entries of a run's folder: links, pipes, devices, and folders in place of files.

A run's folder may come from anywhere, in an archive for instance, which keeps links. A link would
lead out of the folder, and opening a pipe would wait for ever: so neither is ever opened.
"""

import os
import stat
from collections.abc import Iterator
from pathlib import Path

from pfdist.errors import StoreError

OWN = (
    "job.toml", "run.json", ".lock", "parts", "tables", "manifest", "quarantine", "figures",
    "report.html",
)  # fmt: skip
"""What a run's folder holds; other names in it are the user's and are never opened."""
_FILES = ("job.toml", "run.json", ".lock", "report.html")
_TABLES_DEEP = 2  # tables/<table>/ and parts/<table>/ hold files alone


def strange_entries(folder: Path) -> Iterator[tuple[Path, str]]:
    """Paths of strange entries, relative to the run's folder, each with what is wrong with it.

    Links are not followed.

    Raises
    ------
    StoreError
        A folder cannot be listed.
    """
    for name in OWN:
        path = folder / name
        try:
            mode = path.lstat().st_mode
        except (FileNotFoundError, NotADirectoryError):
            continue
        except OSError as error:
            raise StoreError(f"cannot read {path}: {error.strerror}") from error
        wrong = _wrong(mode, file=name in _FILES, folder=name not in _FILES)
        if wrong:
            yield Path(name), wrong
        elif stat.S_ISDIR(mode) and name != "quarantine":  # what lies in there is never opened
            yield from _below(folder, Path(name))


def check_entries(folder: Path) -> None:
    """Raise a `StoreError` that names the first strange entry of a run's folder."""
    for path, wrong in strange_entries(folder):
        raise StoreError(
            f"{folder / path} {wrong}; a run holds plain files and folders alone: "
            f"`pfdist repair {folder}` moves it to quarantine"
        )


def _below(folder: Path, relative: Path) -> Iterator[tuple[Path, str]]:
    try:
        entries = sorted(os.scandir(folder / relative), key=lambda entry: entry.name)
        modes = [entry.stat(follow_symlinks=False).st_mode for entry in entries]
    except FileNotFoundError:  # published or removed meanwhile
        return
    except OSError as error:
        raise StoreError(f"cannot read {folder / relative}: {error.strerror}") from error
    holds_files = relative.parts[0] in ("parts", "tables") and len(relative.parts) == _TABLES_DEEP
    for entry, mode in zip(entries, modes, strict=True):
        wrong = _wrong(mode, file=holds_files)
        if wrong:
            yield relative / entry.name, wrong
        elif stat.S_ISDIR(mode):
            yield from _below(folder, relative / entry.name)


def _wrong(mode: int, *, file: bool = False, folder: bool = False) -> str:
    """Say what is wrong with an entry; empty if nothing is wrong."""
    if stat.S_ISLNK(mode):
        return "is a link"
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        return "is neither a file nor a folder"
    if file and stat.S_ISDIR(mode):
        return "is a folder where a file belongs"
    if folder and stat.S_ISREG(mode):
        return "is a file where a folder belongs"
    return ""
