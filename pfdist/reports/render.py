"""From a page to one self-contained HTML file.

A name in a run's files cannot become markup: the template escapes every text, and the page allows
no script but its own.
"""

import base64
import hashlib
import re
from importlib.resources import files
from pathlib import Path

from jinja2 import Environment, StrictUndefined

from pfdist.reports.parts import Page
from pfdist.store import write_file
from pfdist.store.folder import check_page_replaceable

_FOLDER = files("pfdist.reports")


def as_html(page: Page) -> str:
    """Give a page as an HTML document that loads nothing.

    Parameters
    ----------
    page : Page
    """
    environment = Environment(
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_unbroken,
    )
    environment.filters["words"] = _words
    style, script = (_text(name) for name in ("style.css", "sort.js"))
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return environment.from_string(_text("page.html")).render(
        page=page, style=style, script=script, digest=digest
    )


def _unbroken(value: object) -> object:
    """Keep a number and its sign of per cent on one line."""
    return value.replace(" %", "\xa0%") if type(value) is str else value


def _words(name: str) -> list[str]:
    """Split a name after each point and underscore, where a line may break."""
    return re.split(r"(?<=[._])(?=\S)", name)


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


def _text(name: str) -> str:
    return (_FOLDER / name).read_text(encoding="utf-8")
