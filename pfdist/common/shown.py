"""Results as one line at a prompt, as HTML in a notebook, and as a page.

The terminal also prints the page of a result; for a run, it prints the answer to the question.
"""

import re
from collections.abc import Iterable
from html import escape

from pfdist.common.parts import Block, Facts, Page, Picture, Table, Text, without_empty_columns
from pfdist.errors import one_line, printable

_MARKED = re.compile(r"`([^`]+)`|(?<![\w/.-])(\w{1,12}(?:-\w{1,8}){1,2})(?![\w/-]|\.\w)")
_WHOLE = "white-space: nowrap"


class Shown:
    """A result: one line with its warnings at a prompt, the whole answer in a notebook.

    A class that inherits from this one defines `_page`.
    """

    def _page(self) -> Page:
        raise NotImplementedError

    def __repr__(self) -> str:
        page = self._page()
        blocks = [block for section in page.sections for block in section.blocks]
        said = [block.text for block in blocks if isinstance(block, Text) and block.prominent]
        answer = page.subtitle or " ".join(said) or page.place
        return one_line(f"<{' | '.join([*page.alarms, answer, *page.warnings])}>")

    def _repr_html_(self) -> str:
        return as_fragment(self._page())


def as_fragment(page: Page) -> str:
    """A page as an HTML fragment, without details; all texts are escaped.

    Examples
    --------
    >>> from pfdist.common.parts import Section
    >>> as_fragment(Page("", "a < b", [Section("", [Facts([("t", "1")])])]))
    '<p>a &lt; b</p><table><tr><th>t</th><td>1</td></tr></table>'
    """
    blocks = (block for section in page.sections for block in section.blocks)
    shown = [_of_block(block) for block in blocks if not block.detail]
    warnings = (f"<p>Note: {_shown(warning)}</p>" for warning in page.warnings)
    texts = (*page.alarms, page.subtitle, page.place)
    *first, last = (f"<p>{_shown(text)}</p>" * bool(text) for text in texts)
    return "".join([*first, *shown, *warnings, last])


def marked(text: str) -> str:
    """A text as HTML: what stands between backticks is code, and short words keep hyphens.

    Examples
    --------
    >>> marked("a < b: see `pfdist why`")
    'a &lt; b: see <code>pfdist why</code>'
    """

    def element(match: re.Match[str]) -> str:
        code, whole = match.groups()
        code = code and code.replace("\xa0", " ")  # it is copied
        return f"<code>{code}</code>" if code else f'<span style="{_WHOLE}">{whole}</span>'

    return _MARKED.sub(element, escape(text))


def _shown(text: str) -> str:
    return marked(printable(text))


def _of_block(block: Block) -> str:
    match block:
        case Text(text):
            return f"<p>{_shown(text)}</p>"
        case Facts(facts):
            return _table(_cells("th", [name]) + _cells("td", [value]) for name, value in facts)
        case Table():
            shown = without_empty_columns(block)
            rows = (_cells("td", (cell.text for cell in row)) for row in shown.rows)
            caption = f"<p>{_shown(block.caption)}</p>" if block.caption else ""
            return caption + _table([_cells("th", shown.head), *rows])
        case Picture():
            look = "background: white; color: black; max-width: 44rem"
            return f'<div style="{look}">{block.svg}</div><p>{_shown(block.title)}</p>'
    return ""


def _cells(kind: str, texts: Iterable[str]) -> str:
    return "".join(f"<{kind}>{_shown(text)}</{kind}>" for text in texts)


def _table(rows: Iterable[str]) -> str:
    return "<table>" + "".join(f"<tr>{row}</tr>" for row in rows) + "</table>"
