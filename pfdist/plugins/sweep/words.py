"""Words of the command line that `sweep` alone reads."""

from typing import Any

from cyclopts import Parameter

from pfdist.cli.words import Word, read_each, texts_word
from pfdist.common.parsing import whole_number
from pfdist.errors import shown
from pfdist.plugins.sweep.sweep_points import values_by_key


def _part(text: str) -> tuple[int, int]:
    """The numbers of ``3/200``; `SweepJob.part` checks them."""
    number, _, parts = text.partition("/")
    try:
        return whole_number(number), whole_number(parts)
    except ValueError as error:
        raise ValueError(f"must be K/N, as 3/200, got {shown(text)}") from error


WORDS = {
    "over": texts_word("KEY=VALUES", values_by_key),
    "part": Word(Any, Parameter(metavar="K/N", converter=read_each(_part))),
}
