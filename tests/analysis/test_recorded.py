"""A run.json or job.toml that was edited or damaged: one line that names the file."""

import json
import re
import shutil
from pathlib import Path
from typing import Any

import pytest

from pfdist.cli.main import main

ASSET = Path(__file__).parents[1] / "assets" / "schema-3"
RUN = json.loads((ASSET / "run.json").read_text())
JOB = (ASSET / "job.toml").read_text()
COMMANDS = ["status", "plot", "why"]


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


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        pytest.param("run.json", b"", "line 1", id="run.json is empty"),
        pytest.param("run.json", b"\0" * 4096, "line 1", id="run.json is NUL"),
        pytest.param("run.json", b"\xff\xfe", "UTF-8", id="run.json is not UTF-8"),
        pytest.param("run.json", b"[" * 100_000, "16 deep", id="run.json nests deeply"),
        pytest.param("run.json", b" " * 16_000_001, "16,000,000 bytes", id="run.json is huge"),
        pytest.param("run.json", b"[1]", "one JSON object", id="run.json is a list"),
        pytest.param("run.json", b"null", "one JSON object", id="run.json is null"),
        pytest.param("run.json", b"{}", "schema_version must be given", id="run.json is {}"),
        pytest.param("run.json", _run()[:-9], "line 1", id="run.json is cut"),
        pytest.param("run.json", _run(schema_version="2"), "schema_version", id="version a text"),
        pytest.param("run.json", _run(schema_version=None), "schema_version", id="version null"),
        pytest.param("run.json", _run(schema_version=-1), "schema_version", id="version -1"),
        pytest.param("run.json", _run(schema_version=10**30), "64 bits", id="version 10^30"),
        pytest.param("run.json", _run(schema_version=99), "newer pfdist", id="a newer version"),
        pytest.param("run.json", _run(estimations=[]), "estimations", id="estimations a list"),
        pytest.param(
            "run.json", _run(estimations={"genetic": 3}), "genetic", id="estimation a number"
        ),
        pytest.param(
            "run.json", _run(estimations={"genetic": {"particles": "40"}}), "particles",
            id="particles a text",
        ),
        pytest.param("run.json", _run(provenance=3), "provenance must", id="provenance a number"),
        pytest.param("run.json", _run(provenance="x" * 10**6), "provenance", id="provenance 1 MB"),
        pytest.param("run.json", _provenance(folder=3), "folder must", id="folder a number"),
        pytest.param("run.json", _provenance(folder="a\0b"), "folder must", id="folder with NUL"),
        pytest.param("run.json", _provenance(processor=[1]), "processor", id="processor a list"),
        pytest.param("run.json", _provenance(libraries=["a"]), "libraries", id="libraries a list"),
        pytest.param("run.json", _run(model=[1]), "model must", id="model a list"),
        pytest.param("job.toml", b"", "must be given", id="job.toml is empty"),
        pytest.param("job.toml", b"\xff", "UTF-8", id="job.toml is not UTF-8"),
        pytest.param("job.toml", b"a = " + b"[" * 99_999, "16 deep", id="job.toml nests"),
        pytest.param("job.toml", b"#" * 16_000_001, "16,000,000", id="job.toml is huge"),
        pytest.param("job.toml", _job("[problem]", "[[problem]]"), "problem", id="problem a list"),
        pytest.param("job.toml", _job("[[search]]", "[[seek]]"), "overwrite", id="search renamed"),
        pytest.param("job.toml", _job("[comparison]", "[compare]"), "compare", id="no comparison"),
        pytest.param("job.toml", _job("[filter]", "[[filter]]"), "filter", id="filter a list"),
        pytest.param("job.toml", _job("draws = 60", "draws = '60'"), "draws", id="draws a text"),
        pytest.param(
            "job.toml", _job('name = "genetic"', 'name = "../x"'), "name must", id="a path"
        ),
        pytest.param(
            "job.toml", _job('method = "genetic"', 'method = "x"'), "method", id="no such method"
        ),
        pytest.param(
            "job.toml", _job("horizon = 12", "horizon = " + "9" * 5000), "digits", id="5,000 digits"
        ),
    ],
)  # fmt: skip
def test_a_damaged_file_that_says_what_a_run_is_is_named(
    name: str,
    content: bytes,
    words: str,
    command: str,
    run: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (run / name).write_bytes(content)
    named = run / "job.toml" if command == "why" else run
    line = _line([command, str(named)], capsys)
    assert re.search(words, line), line
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
    monkeypatch.setattr("pfdist.analysis.recorded.check_key", lambda *_: None)
    (run / "job.toml").write_bytes(_job('name = "genetic"\n', ""))
    assert main(["status", str(run)]) == 0
    assert "finished" in capsys.readouterr().out
