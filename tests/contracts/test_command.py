"""The contract of every command of the command line."""

import argparse

import pytest

from pfdist.cli.command import COMMANDS
from pfdist.cli.main import main

every = pytest.mark.parametrize("name", COMMANDS)
COLUMNS = 80


@every
def test_one_sentence_describes_it(name: str) -> None:
    description = COMMANDS[name].description
    assert description.endswith(".")
    assert len(description) <= COLUMNS


@every
def test_every_argument_is_described(name: str) -> None:
    parser = argparse.ArgumentParser()
    COMMANDS[name].add_arguments(parser)
    arguments = [action for action in parser._actions if action.dest != "help"]
    assert [action.dest for action in arguments if not action.help] == []


@every
def test_its_help_fits_a_terminal_says_whether_it_goes_on_and_ends_with_examples(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("COLUMNS", str(COLUMNS))
    with pytest.raises(SystemExit) as stop:
        main([name, "--help"])
    assert stop.value.code == 0
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= COLUMNS
    words = " ".join(text.split())
    assert words.startswith(f"{COMMANDS[name].description} usage: pfdist {name} ")
    assert ("the same command goes on" in words) is COMMANDS[name].goes_on
    examples = COMMANDS[name].examples
    assert examples
    assert all(f"pfdist {name}" in line for line in examples)
    expected = [text for line, does in examples.items() for text in (f"  # {does}", f"  {line}")]
    assert text.partition("\nexamples:\n")[2].splitlines() == expected


@every
def test_an_unknown_option_is_refused_with_2(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        main([name, "--unknown-option"])
    assert stop.value.code == 2
    assert ": error: " in capsys.readouterr().err.splitlines()[-1]
