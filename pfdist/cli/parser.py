"""The parser of the command line, made from the declared commands."""

import argparse
from typing import Any, NoReturn

import pfdist
from pfdist.cli.command import COMMANDS, Command
from pfdist.errors import one_line, shown_text

_EXIT_CODES = (
    "Exit codes: 0 done; 1 error; 2 wrong arguments; 130 interrupted by Ctrl-C; "
    "75 ended by SIGTERM or SIGUSR1, which batch systems send."
)
_GOES_ON = "If this command is interrupted, the same command goes on where it stopped. "


def make_parser() -> argparse.ArgumentParser:
    """Make the parser of the whole command line.

    The parsed arguments have an attribute ``called``, the chosen `Command`.

    Raises
    ------
    PfdistError
        A command that an installed package adds cannot be loaded.
    """
    parser = _Parser(
        prog="pfdist",
        description="Find the measurement times at which a particle filter errs least, and prove "
        "them on fresh draws. Start with `pfdist plan JOB`.",
        epilog=f"`pfdist COMMAND --help` describes a command. {_EXIT_CODES}",
    )
    parser.add_argument("--version", action="version", version=f"pfdist {pfdist.__version__}")
    subparsers = parser.add_subparsers(required=True, metavar="COMMAND")
    for name, command in COMMANDS.items():
        added = subparsers.add_parser(
            name,
            help=command.description,
            description=command.description,
            epilog=(_GOES_ON if command.goes_on else "") + _EXIT_CODES,
        )
        added.declared = command
        added.set_defaults(called=command)
    return parser


class _Parser(argparse.ArgumentParser):
    """A parser that gets the arguments of a command when it parses them.

    To add them may import modules that take long to load, and the other commands need no such
    module.
    """

    declared: Command | None = None

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        if self.declared is not None:
            declared, self.declared = self.declared, None
            declared.add_arguments(self)
            self.add_argument("--debug", action="store_true", help="show the traceback of an error")
        return super().parse_known_args(args, namespace)

    def error(self, message: str) -> NoReturn:
        """Print what is wrong in one line without long values, and exit with 2."""
        super().error(shown_text(one_line(message)))
