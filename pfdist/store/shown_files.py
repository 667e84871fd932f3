"""The files of a run that people look at, told from other files of the same name."""

from collections.abc import Iterator
from pathlib import Path

from pfdist.errors import StoreError
from pfdist.store.replaceable import check_replaceable

REPORT = "report.html"
FIGURES_FOLDER = "figures"
FORMATS = ("png", "svg")
_MARK = b'<meta name="generator" content="pfdist">'
_START = 1024  # bytes of a report in which the mark stands


def check_page_replaceable(path: Path) -> None:
    """Raise an error unless a file is missing, or is an earlier report.

    Raises
    ------
    StoreError
    """
    check_replaceable(path, _is_page)


def has_report(path: Path) -> bool:
    """Say whether the folder of a run has a report, and not another file of this name."""
    try:
        check_page_replaceable(path / REPORT)
    except StoreError:
        return False
    return (path / REPORT).exists()


def figures_in(path: Path) -> Iterator[Path]:
    """Give the files of the figures in the folder of a run."""
    for file in (path / FIGURES_FOLDER).glob("*.*"):
        if file.suffix.removeprefix(".") in FORMATS:
            yield file


def _is_page(path: Path) -> bool:
    with path.open("rb") as file:
        return _MARK in file.read(_START)
