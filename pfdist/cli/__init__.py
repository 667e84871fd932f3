"""The command line: parse the arguments, call `pfdist.api`, print. There is no logic here."""
