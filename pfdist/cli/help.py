"""The help of the command line: a sentence, the arguments, notes, and examples at the end."""

import argparse
from collections.abc import Mapping

from pfdist.cli.command import COMMANDS

PROGRAM = (
    "pfdist finds the measurement times at which a particle filter errs least, and proves how good "
    "they are."
)
_BEGIN_WITH = ("plan", "why", "budget")  # commands, in the order in which they are tried


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
