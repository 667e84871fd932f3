"""A run.json or job.toml that was edited or damaged: one line that names the file."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from oracles.listed import rewrite
from pfdist.cli.main import main

ASSET = Path(__file__).parents[1] / "assets" / "schema-3"
RUN = json.loads((ASSET / "run.json").read_text())
JOB = (ASSET / "job.toml").read_text()


def _run(**changes: Any) -> bytes:
    return json.dumps(RUN | changes).encode()


def _job(old: str, new: str) -> bytes:
    assert old in JOB
    return JOB.replace(old, new, 1).encode()


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return shutil.copytree(ASSET, tmp_path / "run")


def _line(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    assert main(words) == 1
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert len(captured.err) < 1300
    return captured.err


DAMAGED = [
    ("run.json", b"\xff\xfe", "is damaged: text must be UTF-8"),
    ("run.json", _run()[:-9], "is damaged"),
    ("run.json", b"[1]", "is damaged"),
    ("run.json", b"{}", "is damaged"),
    ("run.json", _run(engine="numpy"), "is damaged: its content has another hash"),
    ("run.json", _run(schema_version="2"), "is damaged"),
    ("run.json", _run(schema_version=99), "newer pfdist"),
    ("job.toml", b"", "is damaged"),
    ("job.toml", b"a = " + b"[" * 99_999, "is damaged"),
    ("job.toml", _job("draws = 60", "draws = 61"), "is damaged: its content has another hash"),
    ("files.json", b"", "is damaged: its content has another hash"),
    ("files.json", b"[1]", "is damaged: its content has another hash"),
]


@pytest.mark.parametrize(("name", "content", "words"), DAMAGED)
def test_a_damaged_file_that_says_what_a_run_is_is_named(
    name: str, content: bytes, words: str, run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (run / name).write_bytes(content)
    line = _line(["status", str(run)], capsys)
    assert words in line
    assert "newer pfdist" in line or str(run / name) in line


@pytest.mark.parametrize("name", ["run.json", "job.toml", "files.json"])
def test_verify_finds_a_file_that_was_edited_whatever_it_holds(
    name: str, run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (run / name).write_bytes(b"\xff[[[")
    assert main(["verify", str(run)]) == 1
    assert f"{name} is damaged" in capsys.readouterr().out


def test_a_damaged_run_that_is_reused_names_the_file(
    run: Path, small_job: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (run / "run.json").write_text("[]")
    words = ["run", str(small_job.path), "--results", str(tmp_path / "new"), "--reuse", str(run)]
    assert f"{run / 'run.json'} is damaged" in _line(words, capsys)
    assert not (tmp_path / "new").exists()


def test_keys_that_are_lacking_have_their_defaults(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # As a version has written them that did not know the keys.
    text = _job('name = "genetic"\n', "").decode()
    rewrite(run / "job.toml", text)
    assert main(["status", str(run)]) == 0
    assert "finished" in capsys.readouterr().out
