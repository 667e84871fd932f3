"""Tables of a terminal: aligned columns below heads of one or more lines."""

import re
from collections.abc import Sequence
from typing import NamedTuple

_PIECE = re.compile(r"[^_. ]+[_. ]?|[_. ]")
_GAP = "  "


class Column(NamedTuple):
    """A column of a table.

    Parameters
    ----------
    head : str
        It is cut after spaces, points and underscores if all cells are narrower.
    cells : sequence of str
    is_number : bool
        Whether the cells end at the same place; else they begin there.
    """

    head: str
    cells: Sequence[str]
    is_number: bool = False

    @property
    def lines(self) -> list[str]:
        """The lines of the head."""
        pieces = _PIECE.findall(self.head)
        most = max(map(len, [*self.cells, *(piece.rstrip() for piece in pieces)]), default=0)
        lines = [""]
        for piece in pieces:
            if len((lines[-1] + piece).rstrip()) > most and lines[-1]:
                lines.append("")
            lines[-1] += piece
        return [line.rstrip() for line in lines]

    @property
    def width(self) -> int:
        """Characters of the longest line of the head, or of the longest cell."""
        return max(map(len, [*self.lines, *self.cells]), default=0)


def width_of(columns: Sequence[Column]) -> int:
    """Give the width of a table with these columns, in characters."""
    return sum(column.width for column in columns) + len(_GAP) * (len(columns) - 1)


def aligned(columns: Sequence[Column]) -> list[str]:
    """Give the lines of a table; the heads end in the same line.

    Parameters
    ----------
    columns : sequence of Column
        With as many cells each.

    Examples
    --------
    >>> columns = Column("set", ["a", "bcd"]), Column("job_seed", ["1", "10"], True)
    >>> for line in aligned(columns):
    ...     print(line)
         job_
    set  seed
    a       1
    bcd    10
    """
    height = max(len(column.lines) for column in columns)
    filled = [
        [*[""] * (height - len(column.lines)), *column.lines, *column.cells] for column in columns
    ]
    places = [(column.width, ">" if column.is_number else "<") for column in columns]
    return [
        _GAP.join(
            f"{cell:{side}{width}}" for cell, (width, side) in zip(row, places, strict=True)
        ).rstrip()
        for row in zip(*filled, strict=True)
    ]
