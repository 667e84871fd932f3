"""Words of the command line that `simulate` alone reads."""

from pfdist.cli.words import folder_word

WORDS = {"simulate.out": folder_word("FILE", required=True)}
