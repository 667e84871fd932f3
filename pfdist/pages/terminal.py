"""An answer as lines of a terminal: paragraphs, facts and tables that fit into its columns."""

import re
import shutil
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from itertools import zip_longest

from pfdist.common.parts import Block, Code, Facts, Page, Table, Text, without_empty_columns
from pfdist.errors import one_line

_NARROWEST, _USUAL, _WIDEST = 40, 80, 120  # columns of lines; the usual without a terminal
_NAME = 21  # characters of a fact's name
_LEAST = 24  # characters of a column of text that is cut into lines
_GAP = "  "
_GLUED = re.compile(  # spaces at which no line ends
    r"(?<=\d) (?=%)|(?<=\(95 % CI) |(?<=\bt) (?=[=\xa0])|(?<=\bt =) |(?<=\bt\xa0=) "
)
_WORD, _PIECE = re.compile(r"[^ ]+ ?| "), re.compile(r"[^_./ ]+[_./ ]?|[_./ ]")


def line_width() -> int:
    """Columns of the terminal, or of the variable COLUMNS; 80 if the output is not a terminal."""
    return min(max(_NARROWEST, shutil.get_terminal_size((_USUAL, 1)).columns), _WIDEST)


def lines_of(page: Page, *, verbose: bool = False) -> list[str]:
    """The lines of a page without its pictures; its details only if `verbose`."""
    is_path = "/" in page.subtitle  # which is not cut
    lines = lines_of_blocks(map(Text, page.alarms))
    lines += [""] * bool(lines and page.subtitle)
    lines += [one_line(page.subtitle)] if is_path else wrapped(page.subtitle)
    for section in page.sections:
        lines += lines_of_blocks(section.blocks, verbose=verbose)
    for warning in page.warnings:
        lines += ["", *wrapped(f"Note: {warning}")]
    return [*lines, *["", one_line(page.place)] * bool(page.place)]


def lines_of_blocks(blocks: Iterable[Block], *, verbose: bool = False) -> list[str]:
    """The lines of some parts, each after an empty line."""
    lines = list[str]()
    for block in blocks:
        if verbose or not block.detail:
            shown = list(_lines(block))
            lines += [""] * bool(shown) + shown
    return lines


def wrapped(text: str, start: str = "") -> list[str]:
    """The lines of a paragraph; the first begins with `start`, and the others are indented.

    No line begins with a percent sign or with an interval. A no-break space becomes a space. No
    path is cut.
    """
    indent = " " * min(len(start), _NAME + 3)
    lines = textwrap.wrap(
        _GLUED.sub("\xa0", one_line(text)), line_width(),
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
    """The lines of a table.

    Text is cut into lines, and optional columns are left out, until the columns fit. Heads are cut
    within names only if the table does not fit otherwise.

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
    for count in range(len(table.optional) + 1):
        shown = _columns(table, _PIECE, table.optional[:count])
        if _is_narrowed(shown):
            break
    whole = _columns(table, _WORD, table.optional[:count])
    shown = whole if _is_narrowed(whole) else shown
    height = max(len(each.head) for each in shown)
    heads = ([*[""] * (height - len(each.head)), *each.head] for each in shown)
    rows = zip(*(each.cells for each in shown), strict=True)
    cut = (map(_cut, row, (each.width for each in shown)) for row in rows)
    return [_line(line, shown) for row in (heads, *cut) for line in zip_longest(*row, fillvalue="")]


def _columns(table: Table, piece: re.Pattern[str], left_out: Sequence[str]) -> list["_Column"]:
    return [
        _Column(
            piece.findall(one_line(name)),
            [row[place].text for row in table.rows],
            all(row[place].is_number for row in table.rows),
        )
        for place, name in enumerate(table.head)
        if name not in left_out
    ]


def _is_narrowed(columns: Sequence["_Column"]) -> bool:
    """Whether columns fit, after the widest columns of text are narrowed."""
    excess = sum(each.width + len(_GAP) for each in columns) - len(_GAP) - line_width()
    while excess > 0 and (wide := [each for each in columns if each.width > each.least]):
        max(wide, key=lambda each: each.width).width -= 1
        excess -= 1
    return excess <= 0


def _line(cells: Iterable[str], columns: Iterable["_Column"]) -> str:
    parts = zip(cells, columns, strict=True)
    texts = (f"{cell:{'>' if each.is_number else '<'}{each.width}}" for cell, each in parts)
    return _GAP.join(texts).rstrip()


def _cut(text: str, width: int) -> list[str]:
    """A text in lines that end with words; they end within words if a word is too long."""
    is_long = any(len(word) > width for word in text.split(" "))
    pieces = (_PIECE if is_long else _WORD).findall(text)
    return _lines_of(
        [piece[at : at + width] for piece in pieces for at in range(0, len(piece), width)], width
    )


def _lines_of(pieces: Iterable[str], width: int) -> list[str]:
    lines = [""]
    for piece in pieces:
        if len((lines[-1] + piece).rstrip()) > width and lines[-1]:
            lines.append("")
        lines[-1] += piece
    return [line.rstrip() for line in lines]


class _Column:
    """A column of a table: its head is cut between pieces, and its text may be narrowed."""

    def __init__(self, pieces: Sequence[str], cells: Sequence[str], is_number: bool) -> None:
        self.cells, self.is_number = [one_line(cell) for cell in cells], is_number
        longest = max(map(len, [*self.cells, *(piece.rstrip() for piece in pieces)]), default=0)
        # so that most heads have two lines or fewer
        self.head = _lines_of(pieces, max(longest, -(-sum(map(len, pieces)) // 2)))
        self.width = max(map(len, [*self.head, *self.cells]), default=0)
        self.least = self.width if is_number else max(_LEAST, *map(len, self.head))
