"""An answer as lines of a terminal: paragraphs, facts, and tables that fit into 80 columns."""

import re
import textwrap
from collections.abc import Iterable, Iterator, Sequence

from pfdist.common.parts import Block, Code, Facts, Page, Table, Text, without_empty_columns
from pfdist.errors import one_line

COLUMNS = 80
_NAME = 21  # characters of a fact's name
_LEAST = 24  # characters of a last column that is cut into lines
_GAP = "  "
_GLUED = re.compile(r"(?<=\d) (?=%)|(?<=\(95 %:) ")  # spaces at which no line ends
_WORD, _PIECE = re.compile(r"[^ ]+ ?| "), re.compile(r"[^_. ]+[_. ]?|[_. ]")


def lines_of(page: Page, *, verbose: bool = False) -> list[str]:
    """The lines of a page, without its pictures; without its details unless they are asked for."""
    lines = [one_line(page.subtitle)]  # it may hold a path, which is not cut
    for section in page.sections:
        lines += lines_of_blocks(section.blocks, verbose=verbose)
    for warning in page.warnings:
        lines += ["", *wrapped(f"Note: {warning}")]
    return lines


def lines_of_blocks(blocks: Iterable[Block], *, verbose: bool = False) -> list[str]:
    """The lines of some parts, each after an empty line."""
    lines = list[str]()
    for block in blocks:
        if verbose or not block.detail:
            shown = list(_lines(block))
            lines += [""] * bool(shown) + shown
    return lines


def wrapped(text: str, start: str = "") -> list[str]:
    """A paragraph in lines; beside the text that the first line starts with, if there is one.

    No line begins with a percent sign or with an interval. A no-break space becomes a space. No
    path is cut.
    """
    indent = " " * min(len(start), _NAME + 3)
    lines = textwrap.wrap(
        _GLUED.sub("\xa0", one_line(text)), COLUMNS,
        initial_indent=one_line(start), subsequent_indent=indent,
        break_on_hyphens=False, break_long_words="/" not in text,
    )  # fmt: skip
    return [line.replace("\xa0", " ") for line in lines]


def _lines(block: Block) -> Iterator[str]:
    match block:
        case Text(text):
            yield from wrapped(text)
        case Code(text):
            yield from map(one_line, text.splitlines())
        case Facts(facts, title):
            yield from wrapped(title)
            for name, value in facts:
                yield from wrapped(value, f"  {name:<{_NAME}} ")
        case Table() if block.rows:
            yield from wrapped(block.caption)
            yield from aligned(block)


def aligned(table: Table) -> list[str]:
    """The lines of a table; optional columns are left out, and named, until the others fit.

    Heads are cut within names only if the table does not fit otherwise. If the columns do not fit
    either, the text of the last column goes on in the next lines.

    Examples
    --------
    >>> from pfdist.common.parts import Cell
    >>> rows = [[Cell("a"), Cell("1", 1)], [Cell("bcd"), Cell("10", 10)]]
    >>> for line in aligned(Table("", ["set", "expected job_seed"], rows)):
    ...     print(line)
         expected
    set  job_seed
    a           1
    bcd        10
    """
    table = without_empty_columns(table)
    columns = _columns(table, _PIECE)
    left_out = list[str]()
    for name in table.optional:
        if name in columns and _width(columns.values()) > COLUMNS:
            del columns[name]
            left_out.append(name)
    whole = {name: column for name, column in _columns(table, _WORD).items() if name in columns}
    columns = whole if _width(whole.values()) <= COLUMNS else columns
    *others, last = columns.values()
    room = COLUMNS - _width(columns.values()) + last.width
    if room < last.width and not last.is_number:
        last.width = max(room, _LEAST)
    height = max(len(column.head) for column in columns.values())
    heads = zip(
        *([*[""] * (height - len(each.head)), *each.head] for each in (*others, last)), strict=True
    )
    lines = [_line(head, columns.values()) for head in heads]
    for row in zip(*(column.cells for column in columns.values()), strict=True):
        *cells, end = row
        ends = textwrap.wrap(end, last.width) if len(end) > last.width else [end]
        lines.append(_line([*cells, ends[0]], columns.values()))
        lines += (_line([*[""] * len(cells), more], columns.values()) for more in ends[1:])
    names = ", ".join(one_line(name) for name in left_out)
    return lines + wrapped(f"Left out: {names}. See --json.") * bool(names)


def _columns(table: Table, piece: re.Pattern[str]) -> dict[str, "_Column"]:
    return {
        name: _Column(
            piece.findall(one_line(name)),
            [row[place].text for row in table.rows],
            all(row[place].is_number for row in table.rows),
        )
        for place, name in enumerate(table.head)
    }


def _line(cells: Iterable[str], columns: Iterable["_Column"]) -> str:
    parts = zip(cells, columns, strict=True)
    texts = (f"{cell:{'>' if each.is_number else '<'}{each.width}}" for cell, each in parts)
    return _GAP.join(texts).rstrip()


class _Column:
    """A column of a table: its head is cut between some pieces."""

    def __init__(self, pieces: Sequence[str], cells: Sequence[str], is_number: bool) -> None:
        self.cells, self.is_number = [one_line(cell) for cell in cells], is_number
        longest = max(map(len, [*self.cells, *(piece.rstrip() for piece in pieces)]), default=0)
        most = max(
            longest, -(-sum(map(len, pieces)) // 2)
        )  # so that most heads have two lines or fewer
        lines = [""]
        for piece in pieces:
            if len((lines[-1] + piece).rstrip()) > most and lines[-1]:
                lines.append("")
            lines[-1] += piece
        self.head = [line.rstrip() for line in lines]
        self.width = max(map(len, [*self.head, *self.cells]), default=0)


def _width(columns: Iterable[_Column]) -> int:
    widths = [column.width for column in columns]
    return sum(widths) + len(_GAP) * (len(widths) - 1)
