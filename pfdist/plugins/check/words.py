"""Words of the command line that `check-model` alone reads."""

from pfdist.cli.words import text_word

WORDS = {"check-model.times": text_word("TIMES")}
