"""A run.json or job.toml that was edited or damaged: one line that names the file."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from pfdist.cli.main import main

ASSET = Path(__file__).parents[1] / "assets" / "schema-3"
RUN = json.loads((ASSET / "run.json").read_text())
JOB = (ASSET / "job.toml").read_text()


def _run(**changes: Any) -> bytes:
    return json.dumps(RUN | changes).encode()


def _job(old: str, new: str) -> bytes:
    assert old in JOB
    return JOB.replace(old, new, 1).encode()


def _provenance(**changes: Any) -> bytes:
    return _run(provenance=RUN["provenance"] | changes)


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
    ("run.json", b"\xff\xfe", "UTF-8"),
    ("run.json", _run()[:-9], "line 1"),
    ("run.json", b"[1]", "one JSON object"),
    ("run.json", b"{}", "schema_version must be given"),
    ("run.json", _run(schema_version="2"), "schema_version"),
    ("run.json", _run(schema_version=-1), "schema_version"),
    ("run.json", _run(schema_version=99), "newer pfdist"),
    ("run.json", _run(estimations={"genetic": {"particles": "40"}}), "particles"),
    ("run.json", _run(provenance="x" * 10**6), "provenance"),
    ("run.json", _provenance(folder="a\0b"), "folder must"),
    ("run.json", _provenance(processor=[1]), "processor"),
    ("run.json", _run(model=[1]), "model must"),
    ("job.toml", b"", "must be given"),
    ("job.toml", b"a = " + b"[" * 99_999, "16 deep"),
    ("job.toml", _job("[[search]]", "[[seek]]"), "overwrite"),
    ("job.toml", _job("draws = 60", "draws = '60'"), "draws"),
    ("job.toml", _job('name = "genetic"', 'name = "../x"'), "name must"),
]


@pytest.mark.parametrize(
    ("command", "damage"),
    [("status", damage) for damage in DAMAGED]
    + [(command, damage) for command in ("plot", "why") for damage in (DAMAGED[0], DAMAGED[-1])],
)
def test_a_damaged_file_that_says_what_a_run_is_is_named(
    command: str, damage: tuple[str, bytes, str], run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name, content, words = damage
    (run / name).write_bytes(content)
    named = run / "job.toml" if command == "why" else run
    line = _line([command, str(named)], capsys)
    assert words in line
    assert "newer pfdist" in line or str(run / name) in line


@pytest.mark.parametrize("name", ["run.json", "job.toml"])
def test_verify_and_repair_find_a_file_that_was_edited_whatever_it_holds(
    name: str, run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (run / name).write_bytes(b"\xff[[[")
    assert main(["verify", str(run)]) == 1
    assert f"{name} is not what was committed" in capsys.readouterr().out
    assert main(["repair", str(run)]) == 0
    assert f"it is now quarantine/{name}" in capsys.readouterr().out


def test_a_damaged_run_that_is_reused_names_the_file(
    run: Path, small_job: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (run / "run.json").write_text("[]")
    words = ["run", str(small_job.path), "--results", str(tmp_path / "new"), "--reuse", str(run)]
    assert f"{run / 'run.json'}: " in _line(words, capsys)
    assert not (tmp_path / "new").exists()


def test_keys_that_are_lacking_have_their_defaults(
    run: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    # As a version has written them that did not know the keys.
    monkeypatch.setattr("pfdist.analysis.stored_run.check_key", lambda *_: None)
    (run / "job.toml").write_bytes(_job('name = "genetic"\n', ""))
    assert main(["status", str(run)]) == 0
    assert "finished" in capsys.readouterr().out
