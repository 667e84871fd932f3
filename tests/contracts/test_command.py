"""The contract of every command of the command line."""

import inspect
import pkgutil
import re
from collections.abc import Callable
from typing import Any

import pytest

from pfdist.cli.commands import COMMANDS, GROUPS
from pfdist.cli.program import program

every = pytest.mark.parametrize("name", COMMANDS)
COLUMNS = 80
Call = Callable[..., Any]


@every
def test_one_sentence_describes_it_and_begins_the_docstring_of_its_function(name: str) -> None:
    sentence = COMMANDS[name].sentence
    assert sentence.endswith(".")
    assert len(sentence) <= COLUMNS
    function = pkgutil.resolve_name(COMMANDS[name].function)
    assert (inspect.getdoc(function) or "").partition("\n")[0] == sentence


@every
def test_every_argument_is_described(name: str) -> None:
    arguments = program()[name].assemble_argument_collection(parse_docstring=True)
    assert [each.name for each in arguments if not each.parameter.help] == []


def test_the_help_of_the_program_has_its_groups_in_order(call: Call) -> None:
    text = call("--help").out
    heads = re.findall(r"^╭─ ([\w ]+) ─", text, re.MULTILINE)
    assert heads == ["Commands", *(group for group, names in GROUPS.items() if names)]
    for group, names in GROUPS.items():
        block = text.partition(f"╭─ {group} ")[2].partition("╰")[0]
        shown = re.findall(r"^│ ([a-z-]+) ", block, re.MULTILINE)
        assert shown == [name for name in names if name in COMMANDS]


@every
def test_its_help_fits_a_terminal_says_whether_it_goes_on_and_ends_with_examples(
    name: str, call: Call
) -> None:
    code, text, error = call(name, "--help")
    assert (code, error) == (0, "")
    assert max(map(len, text.splitlines())) <= COLUMNS
    words = " ".join(text.split())
    assert words.startswith(f"Usage: pfdist {name} ")
    function = pkgutil.resolve_name(COMMANDS[name].function)
    about = (inspect.getdoc(function) or "").partition("\nParameters\n---")[0]
    assert " ".join(about.replace("``", "").split()) in words
    assert ("the same command resumes" in words) is COMMANDS[name].resumes
    examples = COMMANDS[name].examples
    assert examples
    assert all(f"pfdist {name}" in line for line in examples)
    expected = [text for line, does in examples.items() for text in (f" # {does}", f" {line}")]
    shown = text.partition("\nExamples:")[2].splitlines()
    assert [each.rstrip() for each in shown if each.strip()] == expected


@every
def test_an_unknown_option_is_refused_with_2(name: str, call: Call) -> None:
    code, _, error = call(name, "--unknown-option")
    assert code == 2
    assert error.startswith(f"pfdist {name}: error: Unknown option: --unknown-option")
