"""The parts of an answer: its content, without its appearance.

Each answer is made once, as a `Page` of parts. `pages.terminal`, `pages.html` and `common.shown`,
for notebooks, show it. Terminals show a part that is a detail only with ``--verbose``; pages fold
the details of a section away.
"""

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
        Whether it is the main answer.
    detail : bool
    """

    kind: ClassVar[str] = "text"
    text: str
    prominent: bool = False
    detail: bool = False


@dataclass(frozen=True)
class Code:
    """Text to be copied, line by line.

    Parameters
    ----------
    text : str
    title : str
        If there is a title, the text is folded away under it.
    """

    kind: ClassVar[str] = "code"
    text: str
    title: str = ""
    detail: bool = True


@dataclass(frozen=True)
class Cell:
    """A cell of a table.

    Parameters
    ----------
    text : str
    value : float, str or None
        The key of the row in its column; by default the text.
    """

    text: str
    value: Value = None

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
    detail : bool
    optional : sequence of str
        Columns that a narrow terminal leaves out, in this order; pages and JSON have them.
    """

    kind: ClassVar[str] = "table"
    caption: str
    head: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    detail: bool = False
    optional: Sequence[str] = ()


def without_empty_columns(table: Table) -> Table:
    """A table without the columns in which no row has a text.

    Examples
    --------
    >>> table = Table("Searches", ("search", "why"), [[Cell("genetic"), Cell("")]])
    >>> without_empty_columns(table).head
    ['search']
    """
    empty = (not any(row[place].text for row in table.rows) for place in range(len(table.head)))
    return without_column(table, *compress(table.head, empty))


def without_column(table: Table, *names: str) -> Table:
    """A table without the columns of these names."""
    stays = [name not in names for name in table.head]
    rows = [list(compress(row, stays)) for row in table.rows]
    return replace(table, head=list(compress(table.head, stays)), rows=rows)


@dataclass(frozen=True)
class Facts:
    """Names with their values.

    Parameters
    ----------
    facts : sequence of (str, str)
    title : str
    detail : bool
    """

    kind: ClassVar[str] = "facts"
    facts: Sequence[tuple[str, str]]
    title: str = ""
    detail: bool = False


@dataclass(frozen=True)
class Picture:
    """A figure.

    Parameters
    ----------
    title : str
        A sentence about what the figure shows.
    description : str
        A line for readers who cannot see the figure.
    svg : str
        An element ``svg`` without references to anything outside it.
    wide : bool
        Whether it has no room for words beside it.
    """

    kind: ClassVar[str] = "picture"
    title: str
    description: str
    svg: str
    wide: bool = False
    detail: bool = False


@dataclass(frozen=True)
class Figures:
    """A placeholder for figures of the run, which reports replace by pictures.

    Parameters
    ----------
    names : sequence of str
        Names under which the figures are declared.
    sets : sequence of str, optional
        The sets whose figures are shown; by default all.
    """

    kind: ClassVar[str] = "figures"
    names: Sequence[str]
    sets: Sequence[str] | None = None
    detail: bool = False


Block = Text | Code | Table | Facts | Picture | Figures


@dataclass(frozen=True)
class Section:
    """A section of a page.

    Parameters
    ----------
    title : str
    blocks : sequence of blocks
    folded : bool
        Pages have its title alone, under which it is folded away; it is not printed.
    """

    title: str
    blocks: Sequence[Block]
    folded: bool = False


@dataclass(frozen=True)
class Page:
    """An answer.

    Parameters
    ----------
    title : str
    subtitle : str
        The line below the title of a report; the first line in a terminal.
    sections : sequence of Section
    alarms : sequence of str
        Sentences that put the answer in doubt: everywhere they come before it.
    warnings : sequence of str
        Further sentences, for instance that the run is not finished: a terminal has them last.
    seconds : int
        Seconds after which the page reloads itself; 0 for never.
    source : str
        The source of the page, for its last line.
    place : str
        Where the answer is kept and how it was computed: the last line in a terminal.
    """

    title: str
    subtitle: str
    sections: Sequence[Section]
    warnings: Sequence[str] = field(default_factory=tuple)
    seconds: int = 0
    source: str = "from tables alone"
    place: str = ""
    alarms: Sequence[str] = field(default_factory=tuple)
