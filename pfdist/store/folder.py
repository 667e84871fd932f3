"""The entries of a run's folder, and which folders hold a run; no file of a run is read here.

A run's folder may come from anywhere, for instance from an archive, which keeps links. A link would
lead out of the folder, and opening a pipe would wait for ever: neither is ever opened. So a caller
checks the entries (`check_entries`, `strange_entries`) before it opens the first file.
"""

import os
import re
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from pfdist.common.nearest import did_you_mean_path
from pfdist.errors import StoreError
from pfdist.store.files import begins_with, check_replaceable, reading
from pfdist.store.files import remove as remove_file

ABOUT = ("job.toml", "run.json")
MANIFEST, QUARANTINE, FIGURES_FOLDER, REPORT = "manifest", "quarantine", "figures", "report.html"
FORMATS = ("png", "svg")
"""Endings of the files of figures."""

MISSING = "is missing"
_FILES = (*ABOUT, ".lock", MANIFEST, REPORT)
_FOLDERS = ("parts", "tables", QUARANTINE, FIGURES_FOLDER)  # entries of other names are the user's
_TABLES_DEEP = 2  # tables/<table>/ and parts/<table>/ hold only files
# A start that was cut short, and a run that has lost its run.json, have these.
_TRACES = ({"job.toml", MANIFEST}, {"tables", MANIFEST})
_MARK = b'<meta name="generator" content="pfdist">'
_START = 1024  # bytes of a report in which the mark stands


def holds_run(path: Path) -> bool:
    """Whether a folder holds a run, which has a run.json.

    A start writes job.toml first, and run.json last. So a start that was cut short has no run.json.
    """
    with reading(path):
        return (path / "run.json").exists()


def is_job_of_run(job_file: Path) -> bool:
    """Whether a job file is the job.toml in the folder of a run."""
    return job_file.name == "job.toml" and _has_run_json(job_file.parent)


def folder_of_run(job_file: Path) -> Path:
    """Folder of a job's run: results/NAME for NAME.toml.

    A job.toml that a run keeps belongs to the run in its folder.
    """
    if not is_job_of_run(job_file):
        return Path("results") / job_file.stem
    folder = job_file.parent
    return folder if folder.name not in ("", "..") else Path(os.path.abspath(folder))


def no_run(path: Path, lacking: str = "run.json") -> StoreError:
    """The error for a folder that lacks a file of a run; it names a run that may be meant."""
    if path.suffix == ".toml" and path.is_file():
        run = folder_of_run(path)
        return StoreError(f"a run must be a folder, got the job file {path}: its run is {run}")
    meant = did_you_mean_path(path, (path.parent, Path("results")), _has_run_json)
    return StoreError(f"{path} holds no run: there is no {lacking} in it{meant}")


def _has_run_json(path: Path) -> bool:
    return (path / "run.json").is_file()


def is_plain_file(path: Path) -> bool:
    """Whether a path is a plain file; nothing else is ever opened."""
    try:
        return stat.S_ISREG(os.lstat(path).st_mode)
    except OSError:
        return False


def check_page_replaceable(path: Path) -> None:
    """Raise a `StoreError` unless a file is missing, or is an earlier report."""
    check_replaceable(path, partial(begins_with, mark=_MARK, most=_START))


def has_report(path: Path) -> bool:
    """Whether the folder of a run has a report, and not another file of this name."""
    try:
        check_page_replaceable(path / REPORT)
    except StoreError:
        return False
    return (path / REPORT).exists()


def figures_in(path: Path) -> Iterator[Path]:
    """Files of the figures in the folder of a run."""
    for file in (path / FIGURES_FOLDER).glob("*.*"):
        if file.suffix.removeprefix(".") in FORMATS:
            yield file


def remove_figures(path: Path) -> None:
    """Remove every PNG and SVG file from the folder ``figures`` of the run in a folder."""
    for file in figures_in(path):
        remove_file(file)


@dataclass(frozen=True)
class Damage:
    """A file that is not what was committed."""

    path: Path  # relative to the run's folder
    what: str  # the damage

    @property
    def is_missing(self) -> bool:
        """Whether the file is not there: nothing has to be moved, and the job makes it again."""
        return self.what == MISSING


def strange_entries(folder: Path) -> Iterator[Damage]:
    """Links, pipes, devices, and folders in place of files. Links are not followed.

    Each folder is looked at before its entries are listed. Raises `StoreError` if one cannot be
    listed.
    """
    for name in (*_FILES, *_FOLDERS):
        path = folder / name
        with reading(path):
            try:
                mode = path.lstat().st_mode
            except (FileNotFoundError, NotADirectoryError):
                continue
        if wrong := _wrong(mode, file=name in _FILES, folder=name in _FOLDERS):
            yield Damage(Path(name), wrong)
        elif stat.S_ISDIR(mode) and name != QUARANTINE:  # files in quarantine are never opened
            yield from _strange_below(folder, Path(name))


def check_entries(folder: Path) -> None:
    """Raise a `StoreError` that names the first strange entry of a run's folder."""
    for damage in strange_entries(folder):
        moves = f"`pfdist repair {folder}` moves it to quarantine"
        raise StoreError(
            f"{folder / damage.path} {damage.what}; a run holds plain files and folders alone: "
            f"{'remove it' if damage.path.parts[0] == MANIFEST else moves}"
        )


def _strange_below(folder: Path, relative: Path) -> Iterator[Damage]:
    with reading(folder / relative):
        try:
            entries = sorted(os.scandir(folder / relative), key=lambda entry: entry.name)
            modes = [entry.stat(follow_symlinks=False).st_mode for entry in entries]
        except FileNotFoundError:  # a driver published meanwhile: it works on this folder now
            return
    holds_files = relative.parts[0] in ("parts", "tables") and len(relative.parts) == _TABLES_DEEP
    for entry, mode in zip(entries, modes, strict=True):
        if wrong := _wrong(mode, file=holds_files):
            yield Damage(relative / entry.name, wrong)
        elif stat.S_ISDIR(mode):
            yield from _strange_below(folder, relative / entry.name)


def _wrong(mode: int, *, file: bool = False, folder: bool = False) -> str:
    """The fault of an entry; empty if nothing is wrong."""
    if stat.S_ISLNK(mode):
        return "is a link"
    if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        return "is neither a file nor a folder"
    if file and stat.S_ISDIR(mode):
        return "is a folder where a file belongs"
    if folder and stat.S_ISREG(mode):
        return "is a file where a folder belongs"
    return ""


def runs_below(folder: Path, depth: int) -> Iterator[Path]:
    """Yield the folders of runs, in the order of their names; numbers are ordered as numbers.

    A folder that holds a run is the only one, because folders within a run are skipped. So are
    hidden folders, links, and folders more than `depth` levels below this one. A folder below that
    cannot be listed is yielded as if it held a run: opening it says why. Raises `StoreError` if the
    folder itself cannot be listed.
    """
    with reading(folder, "list"):
        entries = _listed(folder)
    yield from _runs_in(folder, entries, depth)


def _runs_in(folder: Path, entries: dict[str, bool], depth: int) -> Iterator[Path]:
    if "run.json" in entries or any(traces <= entries.keys() for traces in _TRACES):
        yield folder
    elif depth:
        for name in sorted(entries, key=natural_key):
            if entries[name] and not name.startswith("."):
                try:
                    inner = _listed(folder / name)
                except OSError:
                    yield folder / name
                else:
                    yield from _runs_in(folder / name, inner, depth - 1)


def _listed(folder: Path) -> dict[str, bool]:
    """Names of all entries, and whether each is a folder and no link."""
    with os.scandir(folder) as entries:
        return {entry.name: entry.is_dir(follow_symlinks=False) for entry in entries}


def extent(folder: Path) -> tuple[int, float]:
    """The bytes of all files in a folder, and when it changed last, in seconds since 1970.

    Everything in the folder counts, and links count as themselves. Entries that cannot be read, or
    that vanish meanwhile, are left out.
    """
    total, changed, waiting = 0, 0.0, [os.fspath(folder)]
    while waiting:
        try:
            with os.scandir(waiting.pop()) as listing:
                entries = list(listing)
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
    return total, changed


_NUMBER = re.compile(r"((?:(?<==)-)?[0-9]+(?:\.[0-9]+)?(?:e[-+][0-9]+)?)")
"""A number in a name. A minus counts after =, as in the names of a sweep's points."""


def natural_key(name: str) -> list[tuple[float, str]]:
    """A key by which names are sorted, with numbers in them ordered as numbers, and then as text.

    >>> sorted(["n10", "n9", "n9b", "m", "n09"], key=natural_key)
    ['m', 'n09', 'n9', 'n9b', 'n10']
    >>> sorted(["sd=0.1", "sd=-2", "sd=0.05", "sd=1e-05"], key=natural_key)
    ['sd=-2', 'sd=1e-05', 'sd=0.05', 'sd=0.1']
    """
    parts = _NUMBER.split(name)
    return [(float(part), "") if index % 2 else (0, part) for index, part in enumerate(parts)] + [
        (0, name)
    ]
