"""From a page to one self-contained HTML file.

A name in a run's files cannot become markup: the template escapes every text, and the page allows
no script but its own.
"""

import base64
import hashlib
import re
from importlib.resources import files

from jinja2 import Environment, StrictUndefined

from pfdist.common.parts import Page
from pfdist.errors import printable

_FOLDER = files("pfdist.pages")


def as_html(page: Page) -> str:
    """A page as the text of an HTML document that loads nothing.

    Parameters
    ----------
    page : Page

    Returns
    -------
    str
    """
    environment = Environment(
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_harmless,
    )
    environment.filters["words"] = _words
    style, script = (_text(name) for name in ("style.css", "sort.js"))
    # The page's security policy allows the script with this hash, and no other.
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return environment.from_string(_text("page.html")).render(
        page=page, style=style, script=script, digest=digest
    )


def _harmless(value: object) -> object:
    """A text without control characters; a number and its per cent sign stay on one line.

    Markup is a subclass of str, and is left as it is.
    """
    return printable(value).replace(" %", "\xa0%") if type(value) is str else value


def _words(name: str) -> list[str]:
    """Split a name after each dot and underscore, where a line may break."""
    return re.split(r"(?<=[._])(?=\S)", printable(name))


def _text(name: str) -> str:
    return (_FOLDER / name).read_text(encoding="utf-8")
