"""Words of the command line that `table` alone reads."""

from pfdist.cli.words import file_word

WORDS = {"table.runs": file_word("RUN", required=True)}
