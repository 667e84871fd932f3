"""A model that prints or ends the process: the answer stays an answer, and an error is one line."""

import json
from pathlib import Path

import pytest

from oracles.model_text import MEASURED
from pfdist.cli.main import main

MODEL = (
    """
import os
import subprocess
import sys
from pfdist import StateSpaceModel


class Own(BaseException):
    pass


class Interrupted(KeyboardInterrupt):
    pass


class Untold(Exception):
    def __str__(self):
        raise RuntimeError("no text")


def act():
    ACT


IMPORT


def transition(x, t, w, p):
    if t == 2:
        FORMULA
    return (0.5 * x[0] + w[0],)


model = StateSpaceModel(
    name="mine",
    initial=lambda w, p: (w[0],),
    transition=transition,
"""
    + MEASURED
    + """)
"""
)
JOB = """
seed = 1
[model]
name = "mine.py:model"
[problem]
horizon = 4
measurement_budget = 2
[filter]
engine = "numpy"
particles = 5
[[search]]
method = "random"
"""


def evaluating(folder: Path, act: str, where: str, *options: str) -> list[str]:
    text = MODEL.replace("ACT", act)
    for place in ("IMPORT", "FORMULA"):
        text = text.replace(place, "act()" if place == where else "pass")
    (folder / "mine.py").write_text(text)
    (folder / "mine.toml").write_text(JOB)
    return ["evaluate", str(folder / "mine.toml"), "--times", "0,3", "--draws", "4", *options]


@pytest.mark.parametrize("where", ["IMPORT", "FORMULA"])
@pytest.mark.parametrize(
    ("act", "says"),
    [
        pytest.param("sys.exit(0)", "SystemExit: 0", id="sys.exit with 0"),
        pytest.param("raise Own('mine')", "Own", id="a BaseException of its own"),
        pytest.param("raise Interrupted('x')", "Interrupted", id="a KeyboardInterrupt's class"),
        pytest.param("raise StopIteration", "StopIteration", id="StopIteration"),
        pytest.param("act()", "RecursionError: maximum recursion", id="endless recursion"),
        pytest.param("raise ValueError('a\\nb')", "ValueError: a b", id="an error of two lines"),
        pytest.param("raise ValueError('a' * 10**6)", "aaa ...", id="an error of a megabyte"),
        pytest.param("raise Untold", "Untold", id="an error that cannot be told"),
    ],
)
def test_a_model_that_ends_everything_ends_in_one_line(
    act: str, says: str, where: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(evaluating(tmp_path, act, where)) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("pfdist: model")
    assert says in line
    assert "mine.py:" in line
    assert len(line) < 1000


@pytest.mark.parametrize("where", ["IMPORT", "FORMULA"])
@pytest.mark.parametrize(
    "act",
    [
        pytest.param("print('spam')", id="print"),
        pytest.param("sys.__stdout__.write('spam'); sys.__stdout__.flush()", id="sys.__stdout__"),
        pytest.param("os.write(1, b'spam')", id="the descriptor"),
        pytest.param("subprocess.run(['echo', 'spam'])", id="another process"),
        pytest.param("sys.stdout = None", id="no standard output"),
    ],
)
def test_json_is_json_whatever_a_model_prints(
    act: str, where: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    assert main(evaluating(tmp_path, act, where, "--json")) == 0
    told = capfd.readouterr()
    assert json.loads(told.out)["draws"] == 4
    assert ("spam" in told.err) == ("spam" in act)
