"""Results as a prompt and a notebook show them: a title, and below it a small table."""

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape


@dataclass(frozen=True)
class Card:
    """A title and a table that show a result."""

    title: str  # the result in a line
    head: Sequence[str] = ()  # names of the table's columns
    rows: Sequence[Sequence[str]] = ()

    @property
    def html(self) -> str:
        """The card as HTML; all texts are escaped.

        >>> Card("a < b", ["t"], [["1"]]).html
        '<p>a &lt; b</p><table><tr><th>t</th></tr><tr><td>1</td></tr></table>'
        """
        head = "".join(f"<th>{escape(name)}</th>" for name in self.head)
        rows = ["".join(f"<td>{escape(text)}</td>" for text in row) for row in self.rows]
        table = "".join(f"<tr>{row}</tr>" for row in [head, *rows] if row)
        return f"<p>{escape(self.title)}</p>" + (f"<table>{table}</table>" if table else "")


class Shown:
    """A result that a prompt shows as a line, and a notebook as a table.

    A class that inherits from this one defines `_card`.
    """

    def _card(self) -> Card:
        raise NotImplementedError

    def __repr__(self) -> str:
        return f"<{self._card().title}>"

    def _repr_html_(self) -> str:
        return self._card().html
