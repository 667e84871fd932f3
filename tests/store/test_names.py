"""The folder of a run may have any name that the file system takes."""

import io
import json
import os
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from oracles.in_turn import in_turn
from pfdist import Job
from pfdist.cli.main import main

SMALL = [
    "model.name=random_walk",
    "filter.engine=kalman",
    "search.genetic.generations=1",
    "search.random.evaluations=2",
    "comparison.draws=20",
]
NAMES = [
    pytest.param("exp:1", id="a colon", marks=pytest.mark.slow),
    pytest.param("~root", id="a tilde", marks=pytest.mark.slow),
    pytest.param(os.fsdecode(b"a\xffb"), id="not UTF-8", marks=pytest.mark.slow),
    pytest.param("-x", id="a dash", marks=pytest.mark.slow),
    pytest.param("a  b%41\n\x1b[2Jc", id="spaces, a percent sign and control characters"),
    pytest.param("[bold]:smile:[/x]*?[a]", id="marks and wild cards", marks=pytest.mark.slow),
]


Say = Callable[..., str]


@pytest.fixture
def say(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Say:
    """Run a command, which must succeed; give its standard output, a path's own bytes in it."""
    monkeypatch.chdir(tmp_path)

    def said(*words: str) -> str:
        out, error = io.BytesIO(), io.BytesIO()
        for stream, name in ((out, "stdout"), (error, "stderr")):
            monkeypatch.setattr(sys, name, io.TextIOWrapper(stream, "utf-8", write_through=True))
        assert main(words) == 0, error.getvalue()
        assert b"\x1b" not in out.getvalue() + error.getvalue()
        return os.fsdecode(out.getvalue())

    return said


@pytest.mark.usefixtures("no_figures")
@pytest.mark.parametrize("name", NAMES)
def test_a_run_lies_in_a_folder_of_any_name(name: str, small_job: Job, say: Say) -> None:
    job, printed = str(small_job.path), name.replace("\n", " ").replace("\x1b", "?")
    assert say("run", job, f"--results={name}", "--set", *SMALL).find(f": {printed}/tables") > 0
    assert Path(name, "run.json").exists()
    for command in ("status", "verify"):
        assert f"\n{printed}: " in "\n" + say(command, "--", name)
    assert json.loads(say("status", "--json", "--", name))["run"] == name
    new = f"{name}.new"
    words = ["run", job, f"--results={new}", f"--reuse={name}", "--set", *SMALL]
    assert "tables: " in say(*words, "comparison.draws=30")
    assert "finished" in say("status", "--", new)


@pytest.mark.plugins("why")
@pytest.mark.parametrize(
    "name", [pytest.param("n" * 256, id="256 characters"), pytest.param("d/" * 3000, id="deep")]
)
@in_turn("command", ["status", "verify", "plot", "why"])
def test_a_name_that_no_file_can_have_is_refused_in_one_line(
    name: str, command: str, said: Callable[..., str]
) -> None:
    error = said(command, name, code=1)
    assert error.count("\n") == 1
    assert len(error) < 1300
