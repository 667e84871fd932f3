"""Commands of the command line: functions in the chapters of `pfdist.cli.commands`."""

from argparse import ArgumentParser, Namespace
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from pfdist.common.registry import Registry

AddArguments = Callable[[ArgumentParser], None]
Call = Callable[[Namespace], None]


@dataclass(frozen=True)
class Command:
    """A command of the command line.

    Parameters
    ----------
    name : str
        The word after ``pfdist``.
    description : str
        The command in one line, for help and documentation.
    call : callable
        Does what the parsed arguments ask for, and prints the answer.
    adders : tuple of callable
        Each adds some of the command's arguments to a parser.
    goes_on : bool
        Whether the same command, given again, goes on from what an interrupted one committed.
    examples : mapping of str to str
        Whole command lines, each with what it does.
    """

    name: str
    description: str
    call: Call
    adders: tuple[AddArguments, ...] = ()
    goes_on: bool = False
    examples: Mapping[str, str] = field(default_factory=dict)

    def add_arguments(self, parser: ArgumentParser) -> None:
        """Add all arguments of the command to a parser."""
        for add in self.adders:
            add(parser)


COMMANDS: Registry[Command] = Registry("pfdist.cli.commands")


def command(
    name: str,
    *adders: AddArguments,
    goes_on: bool = False,
    examples: Mapping[str, str] | None = None,
) -> Callable[[Call], Call]:
    """Declare a function as a command; the first line of the docstring describes the command.

    The module of a command is imported for every command line, also for ``pfdist --help``.
    Therefore the function imports whatever takes long to load, such as NumPy, when it is called;
    so does a function that adds arguments.

    Parameters
    ----------
    name : str
        The word after ``pfdist``.
    adders : callable
        Each adds some of the command's arguments to a parser; see `pfdist.cli.arguments`.
    goes_on : bool
        Whether the same command, given again, goes on from what an interrupted one committed.
    examples : mapping of str to str, optional
        Whole command lines of at most 78 characters, each with what it does. The help of the
        command ends with them, and a test runs them. The first is the one to begin with.
    """

    def declare(call: Call) -> Call:
        description = (call.__doc__ or "").partition("\n")[0]
        declared = Command(name, description, call, adders, goes_on, examples or {})
        COMMANDS.declare(name, declared)
        return call

    return declare


def required_words(parser: ArgumentParser) -> str:
    """The arguments that must be given to a parser, for instance ``JOB --times TIMES``."""
    words = []
    for argument in parser._actions:
        if argument.required:
            words += [*argument.option_strings[:1], str(argument.metavar or argument.dest)]
    return " ".join(words)
