"""Damage is found: one line names the file and the remedy, and the remedy gives the same bytes."""

import errno
import os
import random
import re
import shutil
from collections.abc import Callable, Iterator
from functools import partial
from itertools import cycle
from pathlib import Path

import pytest

import pfdist
from oracles.bytes_of import hashes
from oracles.counted import A_DRAW, committed_draws, count_draws
from oracles.file_layer import Ended, FileLayer
from pfdist import Job, load_job
from pfdist.cli.main import main
from pfdist.errors import StoreError
from pfdist.runner import comparison_phase, door
from pfdist.runner.pace import Pace
from pfdist.store import files, parquet
from pfdist.store.verify import verify_run

CHANGES = [
    "search.genetic.generations=2",
    "search.genetic.population=4",
    "search.random.evaluations=3",
    "evaluation.draws=40",
    "comparison.draws=120",
]
STATES = ["finished", "comparing", "searching"]
REMEDY = "; remove it, and run the same command again"


@pytest.fixture(scope="module", autouse=True)
def _small_files() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(door, "COMMIT_SECONDS", 0.0)
        patch.setattr(Pace, "size", lambda pace, remaining: 90 * A_DRAW)
        patch.setattr(comparison_phase, "TRAJECTORIES", 20)
        patch.setattr(comparison_phase, "LOSS_DRAWS", 10)
        patch.setitem(parquet.ROWS_IN_A_FILE, "comparison", 50)
        patch.setitem(parquet.ROWS_IN_A_FILE, "draws", 100)
        yield


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Job:
    path = tmp_path_factory.mktemp("job") / "small.toml"
    path.write_text((Path(__file__).parents[1] / "small.toml").read_text())
    return load_job(path, CHANGES)


@pytest.fixture(scope="module")
def runs(job: Job, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """A finished run, two that were killed in a search and in the comparison, and another run."""
    folder = tmp_path_factory.mktemp("runs")
    with pytest.MonkeyPatch.context() as patch:
        layer = FileLayer(patch, folder)
        count = layer.run(partial(pfdist.run, job, folder / "finished", figures=False))
        for state, at in (("searching", count // 4), ("comparing", count * 3 // 4)):
            with pytest.raises(Ended):
                layer.run(partial(pfdist.run, job, folder / state, figures=False), "ended", at)
            assert pfdist.open_run(folder / state).state == state
            assert list((folder / state / "parts").rglob("*.parquet"))
    pfdist.run(job.with_changes(["seed=2"]), folder / "other", figures=False)
    return {state: folder / state for state in (*STATES, "other")}


def _published(run: Path) -> list[Path]:
    """All that must be there, relative to the run's folder."""
    found = [run / name for name in ("files.json", "job.toml", "run.json")]
    return sorted(file.relative_to(run) for file in (*found, *run.glob("tables/*/*.parquet")))


def _flip(file: Path, bit: int) -> None:
    content = bytearray(file.read_bytes())
    content[bit // 8] ^= 1 << bit % 8
    file.write_bytes(content)


def _cut(file: Path, bit: int) -> None:
    file.write_bytes(file.read_bytes()[: bit // 8])


def _tree(run: Path) -> dict[str, bytes | None]:
    """All files and folders but the lock."""
    return {
        str(path.relative_to(run)): path.read_bytes() if path.is_file() else None
        for path in run.rglob("*")
        if path.name != ".lock"
    }


def _read_all(run: Path) -> list[object]:
    """All figures of a run, without its folder and without what follows from the timings."""
    opened = pfdist.open_run(run)
    figures = [opened.table(name).to_dict("list") for name in opened.tables if name != "timings"]
    answer = opened.as_json()
    return [
        repr(figures),
        {key: answer[key] for key in answer if key not in ("run", "particle_steps")},
    ]


def _committed_without(run: Path, file: Path) -> int:
    """How many draws a run holds without this file of it."""
    copy = shutil.copytree(run, run.with_name("without"))
    (copy / file).unlink()
    parquet.Store(copy, "").recover()
    committed = committed_draws(copy)
    shutil.rmtree(copy)
    return committed


@pytest.mark.parametrize(("step", "times"), [(3, 1), pytest.param(1, 10, marks=pytest.mark.crash)])
def test_damage_is_named_with_the_remedy_which_computes_what_is_lost_and_only_that(
    step: int,
    times: int,
    job: Job,
    runs: dict[str, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    counted, chance = count_draws(monkeypatch), random.Random(1)
    whole, needed = hashes(runs["finished"]), committed_draws(runs["finished"])
    figures = _read_all(runs["finished"])
    for file in _published(runs["finished"])[::step] * times:
        run = shutil.copytree(runs["finished"], tmp_path / "run")
        chance.choice([_flip, _cut])(run / file, chance.randrange(8 * (run / file).stat().st_size))
        (line,) = verify_run(run)
        assert str(run / file) in line
        assert line.endswith(REMEDY)
        with pytest.raises(StoreError) as raised:
            pfdist.run(job, run, figures=False)
        assert str(raised.value) == line
        if file.name != "run.json" and "timings" not in file.parts:
            with pytest.raises(StoreError, match=file.name):
                _read_all(run)
        committed = None if file.parent == Path() else _committed_without(run, file)
        (run / file).unlink()
        counted.clear()
        pfdist.run(job, run, figures=False)
        assert hashes(run) == whole, file
        assert _read_all(run) == figures
        assert sum(counted) == (0 if committed is None else needed - committed), file
        assert not list(verify_run(run))
        shutil.rmtree(run)


@pytest.mark.parametrize("state", ["comparing", pytest.param("searching", marks=pytest.mark.crash)])
def test_a_damaged_part_is_computed_again(
    state: str, job: Job, runs: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    counted, chance = count_draws(monkeypatch), random.Random(2)
    whole, needed = hashes(runs["finished"]), committed_draws(runs["finished"])
    parts = [part.relative_to(runs[state]) for part in runs[state].glob("parts/*/*.parquet")]
    assert len(parts) > 4
    for part in parts[::2]:
        run = shutil.copytree(runs[state], tmp_path / "run")
        committed = _committed_without(run, part)
        _flip(run / part, chance.randrange(8 * (run / part).stat().st_size))
        assert not list(verify_run(run))
        assert committed_draws(run) == committed
        counted.clear()
        pfdist.run(job, run, figures=False)
        assert hashes(run) == whole
        assert sum(counted) == needed - committed
        shutil.rmtree(run)


@pytest.mark.parametrize("step", [3, pytest.param(1, marks=pytest.mark.crash)])
def test_a_lost_file_is_named_and_computed_again(
    step: int, job: Job, runs: dict[str, Path], tmp_path: Path
) -> None:
    whole = hashes(runs["finished"])
    for file in _published(runs["finished"])[::step]:
        run = shutil.copytree(runs["finished"], tmp_path / "run")
        (run / file).unlink()
        if file.parent != Path():
            (line,) = verify_run(run)
            assert (
                line == f"{run / file} is missing: run the same command again to compute its rows"
            )
        else:
            with pytest.raises(StoreError, match=file.name):
                pfdist.open_run(run)
        pfdist.run(job, run, figures=False)
        assert hashes(run) == whole
        assert not list(verify_run(run))
        shutil.rmtree(run)


def test_a_file_that_the_disk_cannot_read_is_named(
    runs: dict[str, Path], job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, read = shutil.copytree(runs["finished"], tmp_path / "run"), files.read_if_hashed
    file = next(run.glob("tables/draws/genetic-00001-*"))

    def failing(path: Path, wanted: str) -> bytes | None:
        if path == file:
            raise OSError(errno.EIO, os.strerror(errno.EIO), str(path))
        return read(path, wanted)

    monkeypatch.setattr("pfdist.store.tables.read_if_hashed", failing)
    with pytest.raises(StoreError, match=rf"cannot read {file}: .*Input/output error"):
        pfdist.run(job, run, figures=False)
    assert any(str(file) in line for line in verify_run(run))


@pytest.mark.parametrize(
    ("place", "source"), [("tables", "other"), ("parts", "other"), ("parts", "finished")]
)
def test_a_file_of_another_run_or_table_is_not_taken_for_a_file_of_this_one(
    source: str, place: str, job: Job, runs: dict[str, Path], tmp_path: Path
) -> None:
    run = shutil.copytree(runs["finished"], tmp_path / "run")
    table = "comparison" if source == "other" else "trajectories"
    file = min((runs[source] / "tables" / table).iterdir())
    stranger = run / place / "comparison" / file.name.replace("00000", "00009")
    if place == "parts":
        stranger = stranger.with_name(file.name.replace("-00000", ""))
    stranger.parent.mkdir(parents=True, exist_ok=True)
    shutil.copy(file, stranger)
    if place == "tables":  # it is not listed, so nobody reads it
        assert _read_all(run) == _read_all(runs["finished"])
        assert [line.partition(" ")[0] for line in verify_run(run)] == [str(stranger)]
    else:
        kind = "run" if source == "other" else "table"
        for act in (_read_all, partial(pfdist.run, job, figures=False)):
            with pytest.raises(
                StoreError, match=f"{stranger} belongs to another {kind}: .*{REMEDY}"
            ):
                act(run)
        stranger.unlink()
    pfdist.run(job, run, figures=False)
    assert hashes(run) == hashes(runs["finished"])
    assert not list(verify_run(run))


@pytest.mark.parametrize("copied", [("job.toml", "run.json"), ("tables",)])
def test_two_runs_in_one_folder_are_not_mixed(
    copied: tuple[str, ...],
    job: Job,
    runs: dict[str, Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    run = shutil.copytree(runs["finished"], tmp_path / "run")
    for name in copied:
        if name == "tables":
            shutil.copytree(runs["other"] / name, run / name, dirs_exist_ok=True)
        else:
            shutil.copy(runs["other"] / name, run / name)
    if copied == ("tables",):  # files of both: those of the other run are not listed
        assert _read_all(run) == _read_all(runs["finished"])
    else:
        assert main(["status", str(run)]) == 1
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert re.search(
            rf"{run}/(files.json|job.toml) is damaged", error
        )  # one run.json: a second
        with pytest.raises(StoreError):
            pfdist.run(job, run, figures=False)
        if copied != ("files.json",):
            for name in copied:
                shutil.copy(runs["finished"] / name, run / name)
        (run / "files.json").unlink()  # the remedy
    pfdist.run(job, run, figures=False)
    assert hashes(run) == hashes(runs["finished"])
    assert not list(verify_run(run))


def test_a_lost_job_grows_all_the_same_and_does_not_shrink(
    job: Job, runs: dict[str, Path], tmp_path: Path
) -> None:
    larger, fewer = (job.with_changes([f"comparison.draws={draws}"]) for draws in (170, 100))
    at_once = pfdist.run(larger, tmp_path / "at once", figures=False)
    run = shutil.copytree(runs["finished"], tmp_path / "run")
    (run / "job.toml").unlink()
    with pytest.raises(StoreError, match=r"at least the 120 draws .* got 100"):
        pfdist.run(fewer, run, figures=False)
    pfdist.run(larger, run, figures=False)
    assert hashes(run) == hashes(at_once.path)


BREAK: dict[str, Callable[[Path], object]] = {
    "nothing": lambda run: None,
    "a table": lambda run: _flip(max(run.glob("*/timings/*.parquet")), 999),
    "job.toml": lambda run: _flip(run / "job.toml", 3),
    "run.json": lambda run: _flip(run / "run.json", 3),
    "files.json": lambda run: _flip(run / "files.json", 3),
    "no job.toml": lambda run: (run / "job.toml").unlink(),
    "no run.json": lambda run: (run / "run.json").unlink(),
    "no files.json": lambda run: (run / "files.json").unlink(),
    "a stranger": lambda run: (run / "parts/draws/mine.parquet").write_text("mine"),
}


@pytest.mark.parametrize(("what", "state"), [*zip(BREAK, cycle(STATES), strict=False)])
def test_another_job_changes_nothing(
    what: str, state: str, job: Job, runs: dict[str, Path], tmp_path: Path
) -> None:
    run = shutil.copytree(runs[state], tmp_path / "run")
    BREAK[what](run)
    before = _tree(run)
    with pytest.raises(StoreError):
        pfdist.run(job.with_changes(["seed=2"]), run, figures=False)
    assert _tree(run) == before


def test_a_page_that_was_edited_is_named_with_the_command_that_makes_it_again(
    job: Job, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = pfdist.run(job, tmp_path / "run", report=True).path
    assert not list(verify_run(run))
    for page, command in (("figures/searches.svg", "plot"), ("report.html", "report")):
        (run / page).write_text((run / page).read_text() + " ")
        assert main(["verify", str(run)]) == 1
        assert f"`pfdist {command} {run}` makes it again" in capsys.readouterr().out
        assert main([command, str(run)]) == 0
        assert main(["verify", str(run)]) == 0
        capsys.readouterr()


def test_verify_says_how_many_parts_an_unfinished_run_has(
    runs: dict[str, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    for state in ("comparing", "searching"):
        assert main(["verify", str(runs[state])]) == 0
        parts = len(list(runs[state].glob("parts/*/*.parquet")))
        assert f"; not finished ({state}, {parts} parts)" in capsys.readouterr().out
