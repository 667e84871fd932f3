"""A run.json or job.toml that was edited or damaged: one line that names the file."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from oracles.listed import rewrite
from pfdist.cli.main import main
from pfdist.results.stored_run import read_recorded

ASSET = Path(__file__).parents[1] / "assets" / "kept"
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
    ("run.json", b"{}", "is damaged"),
    ("run.json", _run(engine="numpy"), "is damaged: its content has another hash"),
    ("run.json", _run(schema_version="2"), "is damaged"),
    ("run.json", _run(schema_version=99), "pfdist 0.4.0 reads and writes"),
    ("job.toml", b"a = " + b"[" * 99_999, "is damaged"),
    ("job.toml", _job("draws = 60", "draws = 61"), "is damaged: its content has another hash"),
    ("files.json", b"", "is damaged: its content has another hash"),
]


@pytest.mark.parametrize(("name", "content", "words"), DAMAGED)
def test_a_damaged_file_that_says_what_a_run_is_is_named(
    name: str, content: bytes, words: str, run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (run / name).write_bytes(content)
    line = _line(["status", str(run)], capsys)
    assert words in line
    assert "schema version" in line or str(run / name) in line


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


def test_keys_that_are_lacking_have_their_defaults(run: Path, said: Callable[..., str]) -> None:
    # As a version has written them that did not know the keys.
    text = _job('name = "genetic"\n', "").decode()
    rewrite(run / "job.toml", text)
    assert "finished" in said("status", run)


# --- what this machine or this version lacks is not damaged ---------------------------------------

SEARCH = _job('method = "genetic"', 'method = "greedy"').decode()
"""The job of a run by a search and a model that were installed elsewhere."""
ELSEWHERE = SEARCH.replace('name = "ungm"', 'name = "lost_models"', 1)


@pytest.mark.plugins("runs")
@pytest.mark.parametrize(
    "line",
    [
        "status run",
        "status run --json",
        "verify run",
        "list run",
        "table run",
        pytest.param("report run", marks=pytest.mark.slow),
        pytest.param("plot run", marks=pytest.mark.slow),
    ],
)
def test_a_run_is_read_without_its_search_and_its_model(
    line: str, run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(run.parent)
    rewrite(run / "job.toml", ELSEWHERE)
    assert main(line.split()) == 0, capsys.readouterr().err
    assert "unreadable" not in capsys.readouterr().out


@pytest.mark.plugins("online")
def test_a_recorded_search_keeps_its_own_keys(run: Path) -> None:
    text = SEARCH.replace("[comparison]", "[online]\ndraws = 5\n[comparison]", 1)
    online = '[online.search]\nname = "x"\nmethod = "greedy"\nkept = 7\n'
    rewrite(run / "job.toml", text.replace("[comparison]", f"{online}[comparison]", 1))
    _, job = read_recorded(run)
    genetic, survivors = job["search"]
    assert (genetic["method"], genetic["name"], genetic["population"]) == ("greedy", "genetic", 6)
    assert survivors["method"] == "survivors"
    assert job["online"]["search"] == {"name": "x", "method": "greedy", "kept": 7}
    assert job["online"]["judging_draws"] == 1024  # a default that the file lacks


@pytest.mark.plugins("online", "why")
@pytest.mark.parametrize(
    "line",
    ["run run", "why run", "bound run", "evaluate run --times 0,3", "next run no"],
)
def test_a_command_that_needs_a_search_says_which_and_what_to_do(
    line: str, run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(run.parent)
    rewrite(run / "job.toml", SEARCH)
    error = _line(line.split(), capsys)
    assert "got 'greedy'; another method needs its package installed, or in Python" in error
    assert "run/job.toml" in error
    assert "damaged" not in error


CLOCK = (
    "measurement_budget = 4\n",
    'measurement_budget = 4\n[problem.clock]\nstart = "2026-04-01"\nstep = "1 d"\n'
    'timezone = "Mars/Base"\n',
)
NEWER = [
    (
        _job("particles = 40", "particles = 40\nbrightness = 1"),
        "unknown key 'brightness' in [filter]",
    ),
    (_job('engine = "auto"', 'engine = "quantum"'), "filter.engine must be"),
    (_job(*CLOCK), "timezone must be a name of the IANA database, as Europe/Brussels, got 'Mars/B"),
]


@pytest.mark.plugins("runs")
@pytest.mark.parametrize(("job", "words"), NEWER)
def test_what_this_version_or_machine_lacks_is_named_and_not_called_damaged(
    job: bytes, words: str, run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rewrite(run / "job.toml", job.decode())
    line = _line(["status", str(run)], capsys)
    assert f"{run / 'job.toml'} is undamaged, but pfdist " in line
    assert words in line
    assert "remove it" not in line
    assert main(["list", str(run)]) == 0
    assert "unreadable" in capsys.readouterr().out


def test_an_operation_of_a_newer_version_is_named_where_the_model_is_needed(
    run: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (run / "model.json").read_text()
    assert '"cos"' in text
    rewrite(run / "model.json", text.replace('"cos"', '"zeta"'))
    assert main(["status", str(run)]) == 0
    capsys.readouterr()
    line = _line(["evaluate", str(run), "--times", "0,3"], capsys)
    assert "model.json is undamaged, but pfdist " in line
    assert "unknown operation 'zeta'" in line
