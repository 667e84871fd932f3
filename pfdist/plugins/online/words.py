"""Words of the command line that `next` alone reads."""

from pfdist.cli.words import number_word
from pfdist.common.parsing import finite_number

WORDS = {
    "next.within": number_word("TIME", finite_number),
}
