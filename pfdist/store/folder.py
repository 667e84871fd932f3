"""The entries of a run's folder, and a search for runs; no file of a run is read here.

A run's folder may come from an untrusted source, for instance from an archive with links. A link
may lead out of the folder, and opening a pipe may wait for ever. So a caller checks the entries
(`check_entries`) before it opens the first file, and only plain files of tables are opened.
"""

import os
import re
import stat
from collections.abc import Iterator
from functools import partial
from pathlib import Path

from pfdist.common.nearest import did_you_mean_path
from pfdist.errors import StoreError
from pfdist.store.files import begins_with, check_replaceable, reading
from pfdist.store.schema import KEYS

MODELS = "model.json"
ABOUT = ("job.toml", "run.json", MODELS)
RULE = "rule.json"
ANSWERS = {RULE: "pfdist rule"}
"""Files with the last answer of a question about the run, and the command that asks it again."""
LISTED = (*ABOUT, *ANSWERS)
"""Files, listed with their hashes, that are not made from tables."""
FILES, FIGURES_FOLDER, REPORT, SUMMARY = "files.json", "figures", "report.html", "sets.json"
FORMATS = ("png", "svg", "pdf")
"""File name extensions of figures."""

_MARK = b'<meta name="generator" content="pfdist">'
_START = 1024  # bytes of a report in which the mark stands


def holds_run(path: Path) -> bool:
    """Whether a folder holds a run, that is, has a run.json.

    A start writes job.toml and model.json first, and run.json last. So an interrupted start has no
    run.json.
    """
    with reading(path):
        return (path / "run.json").exists()


def is_job_of_run(job_file: Path) -> bool:
    """Whether a job file is the job.toml in the folder of a run."""
    return job_file.name == "job.toml" and _has_run_json(job_file.parent)


def folder_of_run(job_file: Path) -> Path:
    """Folder of a job's run: results/NAME for NAME.toml.

    A job.toml in the folder of a run belongs to that run.
    """
    if not is_job_of_run(job_file):
        return Path("results") / job_file.stem
    folder = job_file.parent
    return folder if folder.name not in ("", "..") else Path(os.path.abspath(folder))


def no_run(path: Path, lacking: str) -> StoreError:
    """The error for a folder that lacks a file of a run; it suggests a similar run."""
    if path.suffix == ".toml" and path.is_file():
        run = folder_of_run(path)
        return StoreError(f"a run must be a folder, got the job file {path}: its run is {run}")
    if path.is_dir() and (point := next(runs_below(path, 1), path)) != path:
        return StoreError(
            f"{path} holds several runs, as a sweep does: name one of them, such as {point}; "
            "`pfdist table` and `pfdist plot` show all"
        )
    meant = did_you_mean_path(path, (path.parent, Path("results")), _has_run_json)
    return StoreError(f"{path} holds no run: it has no {lacking}{meant}")


def _has_run_json(path: Path) -> bool:
    return (path / "run.json").is_file()


def check_page_replaceable(path: Path) -> None:
    """Raise `StoreError` if a file exists that is not an earlier report."""
    check_replaceable(path, partial(begins_with, mark=_MARK, most=_START))


def has_report(path: Path) -> bool:
    """Whether the folder of a run has a report, rather than another file of this name."""
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


def check_entries(folder: Path) -> None:
    """Raise `StoreError` if a link, a pipe or another entry replaces a file or folder.

    Entries with other names belong to the user.
    """
    below = [f"{place}/{table}" for place in ("tables", "parts") for table in KEYS]
    for is_right, what, names in (
        (stat.S_ISREG, "file", (*LISTED, FILES, REPORT)),
        (stat.S_ISDIR, "folder", ("tables", "parts", FIGURES_FOLDER, *below)),
    ):
        for name in names:
            path = f"{folder}/{name}"  # a `Path` takes longer than the look
            try:
                mode = os.lstat(path).st_mode
            except (FileNotFoundError, NotADirectoryError):
                continue
            except OSError:
                with reading(Path(path)):
                    raise
            if not is_right(mode):
                raise StoreError(
                    f"{path} must be a plain {what}, got {_kind(mode)}: remove it, and run the "
                    "same command again"
                )


def _kind(mode: int) -> str:
    kinds = {stat.S_IFLNK: "a link", stat.S_IFDIR: "a folder", stat.S_IFREG: "a file"}
    return kinds.get(stat.S_IFMT(mode), "a pipe or a device")


def runs_below(folder: Path, depth: int) -> Iterator[Path]:
    """Yield the folders of runs, in the order of their names; numbers are ordered as numbers.

    Folders within a run are skipped, and so are hidden folders, links, and folders more than
    `depth` levels below this one. An inner folder that cannot be listed is yielded like a run:
    opening it raises the error. Raises `StoreError` if the folder itself cannot be listed.
    """
    with reading(folder, "list"):
        entries = _listed(folder)
    yield from _runs_in(folder, entries, depth)


def _runs_in(folder: Path, entries: dict[str, bool], depth: int) -> Iterator[Path]:
    if entries.keys() & {"run.json", FILES}:
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
    """The bytes of all files in a folder, and its last change in seconds since 1970.

    Everything in the folder counts; links are not followed. Entries that cannot be read or that
    vanish meanwhile are left out.
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
"""A number in a name; a minus belongs to it only after =, as in names of a sweep's points."""


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
