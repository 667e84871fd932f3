"""Words of the command line that `filter` alone reads."""

from pfdist.cli.words import number_word
from pfdist.common.parsing import finite_number

WORDS = {"filter.within": number_word("TIME", finite_number)}
