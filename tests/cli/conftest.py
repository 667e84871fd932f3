"""The command line, called as a user calls it."""

import shlex
from collections.abc import Callable
from typing import NamedTuple

import pytest

from pfdist.cli.main import main


class Called(NamedTuple):
    code: object
    out: str
    err: str


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str]) -> Callable[..., Called]:
    """Call pfdist with a line, or with words; give the exit code and what is printed."""

    def called(line: str, *words: object) -> Called:
        try:
            code: object = main([*shlex.split(line), *map(str, words)])
        except SystemExit as stop:
            code = stop.code
        return Called(code, *capsys.readouterr())

    return called
