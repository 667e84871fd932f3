"""Pages as files: each report or answer is one self-contained HTML file."""

from pathlib import Path

from pfdist.documents.parts import Page
from pfdist.errors import StoreError
from pfdist.store import remove_file, write_file
from pfdist.store.folder import REPORT, check_page_replaceable


def write_page(page: Page, path: Path) -> None:
    """Write a page to an HTML file, atomically.

    Parameters
    ----------
    page : Page
    path : Path
        The file. An earlier page of pfdist is replaced, and nothing else.

    Raises
    ------
    StoreError
        The file cannot be written, or a file of another kind has this name.
    """
    from pfdist.documents.html import as_html  # noqa: PLC0415  Jinja loads if a page is made

    check_page_replaceable(path)
    html = as_html(page)
    write_file(path, lambda file: file.write_text(html, encoding="utf-8", errors="replace"))


def remove_report(path: Path) -> None:
    """Remove the report of the run in a folder, if there is one.

    A run writes its report only if the folder has none. So an old report must be removed before
    the run goes on; otherwise it would stay for ever.

    Parameters
    ----------
    path : Path
        Folder of the run. A file of the user with the report's name is not touched.

    Raises
    ------
    StoreError
        The report cannot be removed.
    """
    try:
        check_page_replaceable(path / REPORT)
    except StoreError:  # it is the user's own file
        return
    remove_file(path / REPORT)
