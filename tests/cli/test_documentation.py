"""The manual's lists of commands and figures are those of the declarations."""

import argparse
from pathlib import Path

from pfdist.cli.command import COMMANDS, Command
from pfdist.plots.figure import FIGURES

USING = (Path(__file__).parents[2] / "docs" / "using.md").read_text()


def _usage(command: Command) -> str:
    """The command with every argument that must be given."""
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    words = ["pfdist", command.name]
    for action in parser._actions:
        if action.required:
            words += [*action.option_strings[:1], str(action.metavar)]
    return " ".join(words)


def _table(head: tuple[str, str], rows: list[tuple[str, str]]) -> str:
    lines = [f"| {head[0]} | {head[1]} |", "|---|---|"]
    return "\n".join([*lines, *(f"| `{name}` | {told} |" for name, told in rows)])


def test_the_manual_lists_every_command_that_ships() -> None:
    rows = [
        (_usage(command), command.description)
        for command in COMMANDS.values()
        if command.call.__module__.startswith("pfdist.")
    ]
    assert _table(("command", "what it does"), rows) in USING


def test_the_manual_lists_every_figure_that_ships() -> None:
    rows = [
        (f"{figure.name}-SET" if figure.each_set else figure.name, figure.description)
        for figure in FIGURES.values()
        if figure.plot.__module__.startswith("pfdist.")
    ]
    assert _table(("file", "what it shows"), rows) in USING


def test_every_command_line_in_the_manual_is_understood() -> None:
    lines = [line.split() for line in USING.splitlines() if line.startswith("pfdist ")]
    assert lines
    for _, name, *words in lines:
        parser = argparse.ArgumentParser(exit_on_error=False)
        COMMANDS[name].add_arguments(parser)
        parser.parse_args(words)
