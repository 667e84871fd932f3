"""Results as one line at a prompt, as HTML in a notebook, and as a page.

The terminal also prints the page of a result; for a run, it prints the answer to the question.
"""

from collections.abc import Iterable
from html import escape

from pfdist.common.parts import Block, Facts, Page, Table, Text, without_empty_columns
from pfdist.errors import one_line, printable


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
        answer = page.subtitle or " ".join(said)
        return one_line(f"<{' | '.join([*page.alarms, answer, *page.warnings])}>")

    def _repr_html_(self) -> str:
        return as_fragment(self._page())


def as_fragment(page: Page) -> str:
    """A page as an HTML fragment, without details and pictures; all texts are escaped.

    Examples
    --------
    >>> from pfdist.common.parts import Section
    >>> as_fragment(Page("", "a < b", [Section("", [Facts([("t", "1")])])]))
    '<p>a &lt; b</p><table><tr><th>t</th><td>1</td></tr></table>'
    """
    blocks = (block for section in page.sections for block in section.blocks)
    shown = [_of_block(block) for block in blocks if not block.detail]
    warnings = (f"<p>Note: {_escaped(warning)}</p>" for warning in page.warnings)
    texts = (*page.alarms, page.subtitle, page.place)
    *first, last = (f"<p>{_escaped(text)}</p>" * bool(text) for text in texts)
    return "".join([*first, *shown, *warnings, last])


def _escaped(text: str) -> str:
    return escape(printable(text))


def _of_block(block: Block) -> str:
    match block:
        case Text(text):
            return f"<p>{_escaped(text)}</p>"
        case Facts(facts):
            return _table(_cells("th", [name]) + _cells("td", [value]) for name, value in facts)
        case Table():
            shown = without_empty_columns(block)
            rows = (_cells("td", (cell.text for cell in row)) for row in shown.rows)
            caption = f"<p>{_escaped(block.caption)}</p>" if block.caption else ""
            return caption + _table([_cells("th", shown.head), *rows])
    return ""


def _cells(kind: str, texts: Iterable[str]) -> str:
    return "".join(f"<{kind}>{_escaped(text)}</{kind}>" for text in texts)


def _table(rows: Iterable[str]) -> str:
    return "<table>" + "".join(f"<tr>{row}</tr>" for row in rows) + "</table>"
