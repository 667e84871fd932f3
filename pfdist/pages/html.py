"""A page as one HTML file that loads nothing.

A name in a run's files cannot become markup: the template escapes every text, and the page allows
no script but its own.
"""

import base64
import hashlib
import re
from importlib.resources import files

from jinja2 import Environment, StrictUndefined

from pfdist.common.parts import Page
from pfdist.common.shown import marked
from pfdist.errors import printable

_FOLDER = files("pfdist.pages")
_GLUED = re.compile(r" (?==)|(?<=[\d,]) (?=%)|(?<=\d) (?=±|[^\W\d])|(?<=[=±]) ")


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
    environment.filters |= {"words": _words, "as_it_is": lambda text: _Code(printable(text))}
    environment.filters["marked"] = lambda text: marked(str(_harmless(text)))
    style, script = (_text(name) for name in ("style.css", "sort.js"))
    # The page's security policy allows the script with this hash, and no other.
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    return environment.from_string(_text("page.html")).render(
        page=page, style=style, script=script, digest=digest
    )


class _Code(str):
    """A text whose spaces are copied as they are."""

    __slots__ = ()


def _harmless(value: object) -> object:
    """A text without control characters; a number stays on one line with its unit or noun.

    Markup is a subclass of str, and is left as it is.
    """
    return _GLUED.sub("\xa0", printable(value)) if type(value) is str else value


def _words(name: str) -> list[str]:
    """Split a name after each dot and underscore, where a line may break."""
    return re.split(r"(?<=[._])(?=\S)", str(_harmless(name)))


def _text(name: str) -> str:
    return (_FOLDER / name).read_text(encoding="utf-8")
