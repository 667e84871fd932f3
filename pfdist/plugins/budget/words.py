"""Words of the command line that `budget` alone reads."""

from typing import Any

from cyclopts import Parameter

from pfdist.cli.words import Word, read_each
from pfdist.common.parsing import whole_numbers

WORDS = {
    "budget.measurements": Word(
        Any,
        Parameter(metavar="NUMBERS", converter=read_each(lambda text: set(whole_numbers(text)))),
    ),
}
