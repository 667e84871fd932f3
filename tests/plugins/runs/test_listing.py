"""The runs below a folder: what each has found, and no damaged folder that ends the list."""

import os
import shutil
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest

import pfdist
from oracles.listed import forget, rewrite
from pfdist.errors import StoreError
from pfdist.store import held

SHORT = ["comparison.draws=60", "search.genetic.generations=1", "filter.particles=10"]
KALMAN = ["model.name=random_walk", "filter.engine=kalman"]


@pytest.fixture
def runs(finished: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Finished runs, two levels deep."""
    folder = tmp_path_factory.mktemp("list")
    for name, changes in {"plain": [], "sweep/n-10": ["seed=2"], "sweep/n-9": KALMAN}.items():
        shutil.copytree(finished(*SHORT, *changes), folder / name)
    return folder


@pytest.fixture
def run(runs: Path, tmp_path: Path) -> Path:
    """A finished run, alone in the folder ``tmp_path``."""
    return shutil.copytree(runs / "plain", tmp_path / "run")


def _row(folder: Path) -> dict[Any, Any]:
    (row,) = pfdist.list_runs(folder).to_dict("records")
    return row


def test_the_best_set_and_its_gain_are_those_of_the_summary(runs: Path) -> None:
    frame = pfdist.list_runs(runs)
    assert frame["run"].tolist() == ["plain", "sweep/n-9", "sweep/n-10"]
    assert set(frame["state"]) == {"finished"}
    for row in frame.to_dict("records"):
        best = pfdist.open_run(runs / row["run"]).best
        assert (row["best"], row["reference"]) == (best.name, best.reference)
        assert row["draws"] == row["draws_wanted"] == 60
        if best.beats_search:
            assert row["found"] == "regular: the search found nothing better"
            continue
        assert row["gain_of_means"] == best.gain_of_means
        low, high = best.gain_of_means_low, best.gain_of_means_high
        is_clear = low is None or not low <= 0.0 <= high
        assert ("no clear difference from regular" in row["found"]) == (not is_clear)
        assert (" % " in row["found"]) == is_clear
    assert len({"no clear" in found for found in frame["found"]}) == 2
    assert frame["found"].str.contains("nothing better").any()


def test_size_and_age_are_those_of_the_files(run: Path, tmp_path: Path) -> None:
    for path in [run, *run.rglob("*")]:
        os.utime(path, (0, 1000.0))
    newest = run / "tables" / "compared"
    os.utime(newest, (0, 3000.0))
    row = _row(tmp_path)
    assert row["bytes"] == sum(path.stat().st_size for path in run.rglob("*") if path.is_file())
    assert row["changed"] == datetime.fromtimestamp(3000.0, UTC)


def test_links_hidden_folders_and_what_lies_deeper_are_left_out(runs: Path, tmp_path: Path) -> None:
    for name in ("a/b/c", "a/b/d/e", ".hidden", "a/.trash/run", "run"):
        shutil.copytree(runs / "plain", tmp_path / name)
    shutil.copytree(runs / "plain", tmp_path / "run" / "inside")
    (tmp_path / "link").symlink_to(runs)
    (tmp_path / "loop").symlink_to(tmp_path)
    (tmp_path / "notes.txt").touch()
    assert pfdist.list_runs(tmp_path)["run"].tolist() == ["a/b/c", "run"]
    assert _row(runs / "plain")["run"] == "."


def test_a_run_is_running_while_its_lock_is_held(run: Path, tmp_path: Path) -> None:
    with held(run):
        assert _row(tmp_path)["state"] == "running"
    assert _row(tmp_path)["state"] == "finished"


def test_an_unfinished_run_says_how_many_draws_it_has(run: Path, tmp_path: Path) -> None:
    def stop(progress: Any) -> None:
        raise KeyboardInterrupt

    job = pfdist.load_job(run / "job.toml", ["comparison.draws=500", "execution.pool=serial"])
    with pytest.raises(KeyboardInterrupt):
        pfdist.run(job, run, figures=False, progress=stop)
    row = _row(tmp_path)
    assert (row["state"], row["draws_wanted"]) == ("unfinished", 500)
    assert 60 <= row["draws"] < 500
    forget(run, "comparison")
    shutil.rmtree(run / "parts")
    row = _row(tmp_path)
    assert (row["state"], row["draws"], row["best"]) == ("unfinished", 0, None)


def _write(name: str, content: bytes) -> Any:
    return lambda run: (run / name).write_bytes(content)


def _unsummed(table: str) -> Any:
    """A table without content, and no summary: else a list would not read the table."""

    def spoil(run: Path) -> None:
        (run / "sets.json").unlink()
        next((run / table).iterdir()).write_bytes(b"")

    return spoil


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (_write("run.json", b"{}"), "run.json is damaged: its content has another hash"),
        (_write("job.toml", b"\xff"), "job.toml is damaged: text must be UTF-8"),
        (_unsummed("tables/comparison"), "is damaged: its name has another hash"),
        (lambda run: (run / "run.json").unlink(), "it has no run.json"),
        (
            lambda run: (run / "figures").symlink_to("/etc"),
            "must be a plain folder, got a link",
        ),
        (
            lambda run: os.mkfifo(run / "report.html"),
            "must be a plain file, got a pipe",
        ),
    ],
)
def test_a_damaged_run_is_a_row_that_says_what_is_wrong(
    spoil: Any, words: str, runs: Path, tmp_path: Path
) -> None:
    for name in ("bad", "good"):
        shutil.copytree(runs / "plain", tmp_path / name)
    (tmp_path / "bad" / ".lock").unlink(missing_ok=True)
    spoil(tmp_path / "bad")
    bad, good = pfdist.list_runs(tmp_path).to_dict("records")
    assert (bad["run"], bad["state"], bad["best"]) == ("bad", "unreadable", None)
    assert words in bad["fault"]
    assert str(tmp_path) not in bad["fault"]
    assert "\n" not in bad["fault"]
    assert (good["state"], good["fault"]) == ("finished", None)


def test_a_forged_run_does_not_end_a_list(
    runs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its files are as old as they say, and its job has texts for numbers."""
    for name in ("bad", "good"):
        shutil.copytree(runs / "plain", tmp_path / name)
    job = tmp_path / "bad" / "job.toml"
    rewrite(job, job.read_text().replace("\ndraws = 60", '\ndraws = "many"'))
    monkeypatch.setattr("pfdist.plugins.runs.listing.extent", lambda folder: (1, 9e11))
    frame = pfdist.list_runs(tmp_path)
    assert frame["state"].tolist() == ["unreadable", "finished"]
    assert {*frame["changed"].dt.year} == {9999}


def test_a_folder_without_runs_gives_an_empty_table_and_a_missing_folder_an_error(
    tmp_path: Path,
) -> None:
    frame = pfdist.list_runs(tmp_path)
    assert frame.empty
    assert "gain_of_means" in frame
    with pytest.raises(StoreError, match=r"cannot list .*lacking: No such file"):
        pfdist.list_runs(tmp_path / "lacking")
