"""The command line: parse the arguments, call `pfdist.questions`, print. There is no logic here."""
