"""The parts of a report: what a page holds, whatever it looks like."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import compress
from typing import ClassVar

Value = float | str | None
_SHORT = 14  # letters of a text that needs no wide column


@dataclass(frozen=True)
class Text:
    """A paragraph of plain text.

    Parameters
    ----------
    text : str
    prominent : bool
        Whether it is the answer that a reader looks for.
    """

    kind: ClassVar[str] = "text"
    text: str
    prominent: bool = False


@dataclass(frozen=True)
class Code:
    """Text to be copied, line by line.

    Parameters
    ----------
    text : str
    title : str
        Says what it is; folded away under this title if there is one.
    """

    kind: ClassVar[str] = "code"
    text: str
    title: str = ""


@dataclass(frozen=True)
class Cell:
    """A cell of a table.

    Parameters
    ----------
    text : str
    value : float, str or None
        The key of the row in its column; by default the text.
    link : str
        Address of a file beside the page, percent-encoded; empty for none.
    linked : str
        Says what the link leads to, for those who hear links without their rows.
    """

    text: str
    value: Value = None
    link: str = ""
    linked: str = ""

    @property
    def key(self) -> Value:
        """The key by which rows are sorted."""
        return self.text if self.value is None else self.value

    @property
    def is_number(self) -> bool:
        """Whether the cell holds a number, or is empty."""
        return not self.text or isinstance(self.value, float | int)

    @property
    def is_short(self) -> bool:
        """Whether the text needs no wide column."""
        return len(self.text) <= _SHORT


@dataclass(frozen=True)
class Table:
    """A table whose rows a reader can sort.

    Parameters
    ----------
    caption : str
    head : sequence of str
    rows : sequence of sequences of Cell
    folded : bool
        Whether the table is folded away under its caption.
    """

    kind: ClassVar[str] = "table"
    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    folded: bool = False


def without_empty_columns(table: Table) -> Table:
    """Give a table without the columns in which no row has a text.

    Examples
    --------
    >>> table = Table("Searches", ("search", "why"), [[Cell("genetic"), Cell("")]])
    >>> without_empty_columns(table).head
    ['search']
    """
    kept = [any(row[column].text for row in table.rows) for column in range(len(table.head))]
    rows = [list(compress(row, kept)) for row in table.rows]
    return replace(table, head=list(compress(table.head, kept)), rows=rows)


@dataclass(frozen=True)
class Facts:
    """Names with their values.

    Parameters
    ----------
    facts : sequence of (str, str)
    """

    kind: ClassVar[str] = "facts"
    facts: Sequence[tuple[str, str]]


@dataclass(frozen=True)
class Picture:
    """A figure.

    Parameters
    ----------
    title : str
        A sentence that says what to see.
    description : str
        A line for those who cannot see the figure.
    svg : str
        An element ``svg`` that names nothing outside itself.
    """

    kind: ClassVar[str] = "picture"
    title: str
    description: str
    svg: str


Block = Text | Code | Table | Facts | Picture


@dataclass(frozen=True)
class Section:
    """A section of a page.

    Parameters
    ----------
    title : str
    blocks : sequence of blocks
    """

    title: str
    blocks: Sequence[Block]


@dataclass(frozen=True)
class Page:
    """A report.

    Parameters
    ----------
    title : str
    subtitle : str
    sections : sequence of Section
    warnings : sequence of str
        Sentences to be read before anything else, for instance that the run is not finished.
    seconds : int
        After so many seconds the page reloads itself; 0 for never.
    source : str
        Says from what the page is made, in its last line.
    links : str
        Says where links of the page lead; empty for a page without links.
    """

    title: str
    subtitle: str
    sections: Sequence[Section]
    warnings: Sequence[str] = field(default_factory=tuple)
    seconds: int = 0
    source: str = "from tables alone"
    links: str = ""
