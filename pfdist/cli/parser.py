"""The parser of the command line, made from the declared commands."""

import argparse
import sys
from collections.abc import Mapping
from itertools import takewhile
from typing import Any, NoReturn

import pfdist
from pfdist.cli.command import COMMANDS, Command, required_words
from pfdist.cli.words import joined, unknown_option
from pfdist.common.nearest import did_you_mean
from pfdist.errors import one_line, shown, shown_text

PROGRAM = (
    "pfdist finds the measurement times at which a particle filter errs least, and proves how good "
    "they are."
)
_BEGIN_WITH = ("plan", "why", "budget")  # commands, in the order in which they are tried
_EXIT_CODES = (
    "Exit codes: 0 done; 1 error; 2 wrong arguments; 130 interrupted by Ctrl-C; "
    "75 ended by SIGTERM or SIGUSR1, which batch systems send, or because no worker answers."
)
_GOES_ON = "If this command is interrupted, the same command goes on where it stopped. "


def make_parser() -> argparse.ArgumentParser:
    """Make the parser of the whole command line.

    The parsed arguments have an attribute ``called``, the chosen `Command`.
    """
    notes = f"`pfdist COMMAND --help` describes a command. {_EXIT_CODES}"
    parser = _Parser(
        prog="pfdist", epilog=f"{notes}\n\n{examples_text(way_in())}", formatter_class=HelpFormatter
    )
    parser.sentence = PROGRAM
    parser.add_argument("--version", action="version", version=f"pfdist {pfdist.__version__}")
    subparsers = parser.add_subparsers(required=True, metavar="COMMAND", title="commands")
    for name, command in COMMANDS.items():
        notes = (_GOES_ON if command.goes_on else "") + _EXIT_CODES
        examples = f"\n\n{examples_text(command.examples)}" if command.examples else ""
        added = subparsers.add_parser(
            name, help=command.description, epilog=notes + examples, formatter_class=HelpFormatter
        )
        added.sentence, added.declared = command.description, command
        added.set_defaults(called=command)
    return parser


def complete_parser() -> argparse.ArgumentParser:
    """Make the parser of the whole command line, with the arguments of every command."""
    parser = make_parser()
    for added in subparsers_of(parser).values():
        added.add_declared_arguments()
    return parser


def subparsers_of(parser: argparse.ArgumentParser) -> dict[str, "_Parser"]:
    """The parsers of all commands, by name."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return dict(action.choices)
    return {}


class _Parser(argparse.ArgumentParser):
    """A parser that gets the arguments of a command when it parses them.

    To add them may import modules that take long to load, and the other commands need no such
    module.
    """

    sentence: str = ""
    declared: Command | None = None

    def add_declared_arguments(self) -> None:
        """Add the arguments of the command, unless the parser has them."""
        if self.declared is not None:
            declared, self.declared = self.declared, None
            declared.add_arguments(self)
            self.add_argument("--debug", action="store_true", help="show the traceback of an error")
            self.usage = " ".join(f"{self.prog} {required_words(self)}".split()) + " [options]"

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        self.add_declared_arguments()
        words = joined(sys.argv[1:] if args is None else args, self._actions)
        # The words after a command are those of the parser of this command.
        own = takewhile(lambda word: word.startswith("-"), words) if self._subparsers else words
        options = [option for action in self._actions for option in action.option_strings]
        if unknown := unknown_option(own, options):
            meant = did_you_mean(unknown, options)
            keys = " (--set KEY=VALUE changes a key of the job)" if "--set" in options else ""
            self.error(f"unknown option {shown_text(unknown)}{keys}{meant}")
        return super().parse_known_args(words, namespace)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        if action.choices is not None and value not in action.choices:
            name = "/".join(action.option_strings) or action.metavar
            names = list(map(str, action.choices))
            raise argparse.ArgumentError(
                None,
                f"{name} must be one of {', '.join(names)}, got {shown(value)}"
                f"{did_you_mean(value, names)}",
            )

    def format_help(self) -> str:
        """The help: the sentence that describes the command, and what argparse makes."""
        formatter = self._get_formatter()
        formatter.add_text(self.sentence)
        return f"{formatter.format_help()}\n{super().format_help()}"

    def error(self, message: str) -> NoReturn:
        """Print what is wrong in one line without long values, and exit with 2."""
        text = shown_text(one_line(message))
        self.exit(2, f"{self.prog}: error: {text} (see `{self.prog} --help`)\n")


# --- the help: a sentence, the arguments, notes, and examples at the end --------------------------


class HelpFormatter(argparse.HelpFormatter):
    """A formatter that fills paragraphs, but keeps those with indented lines as they are."""

    def add_argument(self, action: argparse.Action) -> None:
        """Add an argument; argparse forgets that commands are indented below COMMAND."""
        super().add_argument(action)
        if isinstance(action, argparse._SubParsersAction):
            self._action_max_length += self._indent_increment

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        paragraphs = []
        for paragraph in text.split("\n\n"):
            has_indented_lines = "\n  " in paragraph
            filled = super()._fill_text(paragraph, width, indent)
            paragraphs.append(paragraph if has_indented_lines else filled)
        return "\n\n".join(paragraphs)


def examples_text(examples: Mapping[str, str], title: str = "examples:") -> str:
    """The paragraph that shows examples: each command line below what it does."""
    return "\n".join([title, *(f"  # {does}\n  {line}" for line, does in examples.items())])


def way_in() -> dict[str, str]:
    """The command lines to begin with: the first examples of some commands."""
    return dict(next(iter(COMMANDS[name].examples.items())) for name in _BEGIN_WITH)


def welcome() -> str:
    """The text that ``pfdist`` alone prints."""
    text = "\n\n".join(
        [
            PROGRAM,
            examples_text(way_in(), "Three commands to try:"),
            "`pfdist --help` lists all commands.",
        ]
    )
    formatter = HelpFormatter("pfdist")
    formatter.add_text(text)
    return formatter.format_help()
