"""Words of the command line that `backtest` alone reads."""

from pfdist.cli.words import number_word
from pfdist.common.parsing import finite_number

WORDS = {"backtest.within": number_word("TIME", finite_number)}
