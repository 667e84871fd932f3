"""Reports as files: one self-contained HTML file, made from tables alone."""

from pathlib import Path

from pfdist.documents.html import as_html
from pfdist.documents.parts import Page
from pfdist.errors import StoreError
from pfdist.store import remove_file, write_file
from pfdist.store.folder import REPORT, check_page_replaceable


def write_page(page: Page, path: Path) -> None:
    """Write a page to a file.

    Raises
    ------
    StoreError
        The file cannot be written, or another file than an earlier report has this name.
    """
    check_page_replaceable(path)
    html = as_html(page)
    write_file(path, lambda file: file.write_text(html, encoding="utf-8", errors="replace"))


def remove_report(path: Path) -> None:
    """Remove the report of the run in a folder, if there is an earlier report.

    Raises
    ------
    StoreError
        The report cannot be removed. If it stayed, nobody would make a new one.
    """
    try:
        check_page_replaceable(path / REPORT)
    except StoreError:  # it is the user's own file
        return
    remove_file(path / REPORT)
