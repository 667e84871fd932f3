"""Whatever is damaged is named, put out of the way, and made again: the same bytes."""

import errno
import io
import os
import random
import re
import shutil
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import pfdist
from oracles.bytes_of import hashes
from oracles.counted import A_DRAW, committed_draws, count_draws
from oracles.file_layer import Ended, FileLayer
from oracles.manifest_lines import change, said_of
from pfdist import Job, load_job
from pfdist.cli.main import main
from pfdist.errors import StoreError
from pfdist.runner import comparison_phase, door
from pfdist.runner.pace import Pace
from pfdist.store import files, parquet
from pfdist.store.repair import repair_run, verify_run

PROMISE = "damage is found"
CHANGES = [
    "search.genetic.generations=2",
    "search.genetic.population=4",
    "search.random.evaluations=3",
    "evaluation.draws=40",
    "comparison.draws=120",
]
STATES = ["finished", "comparing", "searching"]

Record = Callable[[str, object], None]


@pytest.fixture(scope="module", autouse=True)
def _small_files() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(door, "COMMIT_SECONDS", 0.0)
        patch.setattr(Pace, "size", lambda pace, remaining: 90 * A_DRAW)
        patch.setattr(comparison_phase, "TRAJECTORIES", 20)
        patch.setattr(comparison_phase, "REPEATED", 10)
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
    """A run that is finished, and two that were killed: in a search and in the comparison."""
    folder = tmp_path_factory.mktemp("runs")
    with pytest.MonkeyPatch.context() as patch:
        layer = FileLayer(patch, folder)
        count = layer.run(partial(pfdist.run, job, folder / "finished", figures=False))
        for state, at in (("searching", count // 4), ("comparing", count * 3 // 4)):
            with pytest.raises(Ended):
                layer.run(partial(pfdist.run, job, folder / state, figures=False), "ended", at)
            assert pfdist.open_run(folder / state).state == state
            assert list((folder / state / "parts").rglob("*.parquet"))
    return {state: folder / state for state in STATES}


def _files(run: Path) -> list[Path]:
    """All that was committed, relative to the run's folder."""
    files = [run / "job.toml", run / "run.json", *run.glob("tables/*/*"), *run.glob("parts/*/*")]
    return sorted(file.relative_to(run) for file in files if not file.name.startswith("."))


def _flip(file: Path, bit: int) -> bytes:
    content = bytearray(file.read_bytes())
    content[bit // 8] ^= 1 << bit % 8
    file.write_bytes(content)
    return bytes(content)


def _tree(run: Path) -> dict[str, bytes | None]:
    """All files and folders but the lock."""
    return {
        str(path.relative_to(run)): path.read_bytes() if path.is_file() else None
        for path in run.rglob("*")
        if path.name != ".lock"
    }


def _named(run: Path) -> list[Path]:
    return [damage.path for damage in verify_run(run)]


def _alone(run: Path, file: Path, folder: Path) -> Path:
    """One file of a run, and what its manifest says of it: what is looked at 40,000 times."""
    (folder / file).parent.mkdir(parents=True)
    shutil.copy(run / file, folder / file)
    key = said_of(run, "run")
    (folder / "manifest").write_text("".join(f"{line}\n" for line in key + said_of(run, file)))
    return folder


def _committed_without(file: Path) -> int:
    """How many draws a run holds if this file of it is not counted."""
    run = next(folder for folder in file.parents if (folder / "manifest").exists())
    aside = file.rename(run / "aside")
    committed = committed_draws(run)
    aside.rename(file)
    return committed


def _run_again(job: Job, run: Path) -> list[str]:
    """Go on with a run; give what it said of its files."""
    said: list[str] = []
    pfdist.run(job, run, say=said.append, figures=False)
    expected = ("is ready: ", "ended without a word: ")
    return [line for line in said if not any(map(line.count, expected))]


@pytest.mark.parametrize("step", [50, pytest.param(1, marks=pytest.mark.crash)])
def test_a_file_cut_short_at_any_byte_is_named_and_made_again(
    step: int,
    job: Job,
    runs: dict[str, Path],
    tmp_path: Path,
    record_property: Record,
) -> None:
    run, faults = shutil.copytree(runs["finished"], tmp_path / "run"), 0
    assert _named(run) == []
    tables = sorted((run / "tables").iterdir())
    assert len(tables) == 9
    for table in tables:
        last = max(table.iterdir())
        file, whole = last.relative_to(run), last.read_bytes()
        alone = _alone(run, file, tmp_path / table.name)
        for size in range(0, len(whole), step):
            (alone / file).write_bytes(whole[:size])
            assert _named(alone) == [file], size
            faults += 1
        last.write_bytes((alone / file).read_bytes())
        assert _named(run) == [file]
        _run_again(job, run)
        assert table.name == "timings" or last.read_bytes() == whole
    assert _named(run) == []
    assert hashes(run) == hashes(runs["finished"])
    record_property("faults", f"{PROMISE}: {faults}")


@pytest.mark.parametrize("flips", [1, pytest.param(10, marks=pytest.mark.crash)])
@pytest.mark.parametrize(
    "state", ["finished", "comparing", pytest.param("searching", marks=pytest.mark.slow)]
)
def test_a_bit_flipped_in_any_file_is_named_and_what_is_lost_and_only_that_is_made_again(
    state: str,
    flips: int,
    job: Job,
    runs: dict[str, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    record_property: Record,
) -> None:
    counted, chance = count_draws(monkeypatch), random.Random(1)
    whole, needed = hashes(runs["finished"]), committed_draws(runs["finished"])
    committed_files = _files(runs[state])
    assert len(committed_files) > 8
    for file in committed_files * flips:
        run = shutil.copytree(runs[state], tmp_path / "run")
        damaged = _flip(run / file, chance.randrange(8 * (run / file).stat().st_size))
        assert _named(run) == [file]
        committed = _committed_without(run / file)
        counted.clear()
        (line,) = _run_again(job, run)
        assert str(run / file) in line
        assert (run / "quarantine" / file).read_bytes() == damaged
        assert hashes(run) == whole
        assert sum(counted) == needed - committed, file
        assert _named(run) == []
        shutil.rmtree(run)
    record_property("faults", f"{PROMISE}: {len(committed_files) * flips}")


def test_a_file_that_is_deleted_is_named_and_made_again(
    job: Job,
    runs: dict[str, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    record_property: Record,
) -> None:
    counted, whole = count_draws(monkeypatch), hashes(runs["finished"])
    needed = committed_draws(runs["finished"])
    committed_files = [file for file in _files(runs["finished"]) if file.name != "run.json"]
    for file in committed_files:
        run = shutil.copytree(runs["finished"], tmp_path / "run")
        (run / file).unlink()
        assert _named(run) == [file]
        committed = committed_draws(run)
        counted.clear()
        (line,) = _run_again(job, run)
        assert f"{run / file} is missing" in line
        assert hashes(run) == whole
        assert sum(counted) == needed - committed
        assert _named(run) == []
        shutil.rmtree(run)
    record_property("faults", f"{PROMISE}: {len(committed_files)}")


def test_a_deleted_entry_makes_its_file_a_stranger_and_is_made_again(
    job: Job, runs: dict[str, Path], tmp_path: Path, record_property: Record
) -> None:
    whole, committed_files = hashes(runs["finished"]), _files(runs["finished"])
    for file in committed_files:
        run = shutil.copytree(runs["finished"], tmp_path / "run")
        change(run, file, [])
        assert [str(damage.path) for damage in verify_run(run)] == [str(file)]
        (line,) = _run_again(job, run)
        assert f"{run / file} is not a file of this run" in line
        assert (run / "quarantine" / file).exists()
        assert hashes(run) == whole
        assert _named(run) == []
        shutil.rmtree(run)
    record_property("faults", f"{PROMISE}: {len(committed_files)}")


def test_a_file_that_the_disk_cannot_read_is_named_and_made_again(
    job: Job,
    runs: dict[str, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    record_property: Record,
) -> None:
    run, digest = shutil.copytree(runs["finished"], tmp_path / "run"), files.digest
    file = Path("tables/draws/genetic-00001.parquet")
    gone = (run / file).stat().st_ino

    def failing(path: Path) -> str:
        if path.stat().st_ino == gone:
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        return digest(path)

    monkeypatch.setattr(files, "digest", failing)
    assert _named(run) == [file]
    (line,) = _run_again(job, run)
    assert f"{run / file} cannot be read: Input/output error" in line
    assert hashes(run) == hashes(runs["finished"])
    assert _named(run) == []
    record_property("faults", f"{PROMISE}: 1")


def _replace(run: Path, file: Path, rows: pa.Table) -> None:
    """Put other rows in the place of a file, and let the manifest vouch for them."""
    with (run / file).open("wb") as target:
        pq.write_table(rows, target)
    digest = files.digest(run / file)
    change(run, file, [f"now {file} {digest}"])


def test_rows_are_counted(runs: dict[str, Path], tmp_path: Path, record_property: Record) -> None:
    run = shutil.copytree(runs["finished"], tmp_path / "run")
    file = Path("tables/comparison/comparison-00001.parquet")
    rows = pq.read_table(io.BytesIO((run / file).read_bytes()))
    _replace(run, file, pa.concat_tables([rows.slice(0, 7), rows.slice(8)]))
    (damage,) = verify_run(run)
    assert damage.path == Path("tables/comparison")
    assert damage.what == "must have each draw once, got 119 rows of 119 draws up to 120"
    record_property("faults", f"{PROMISE}: 1")


@pytest.mark.parametrize("table", ["compared", "comparison"])
@pytest.mark.parametrize("vouched", [True, False])
def test_an_empty_table_is_damage_for_whoever_reads_it_and_made_again(
    table: str,
    vouched: bool,
    job: Job,
    runs: dict[str, Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    record_property: Record,
) -> None:
    run = shutil.copytree(runs["finished"], tmp_path / "runs" / "run")
    said = (run / "manifest").read_text()
    found = sorted(file.relative_to(run) for file in (run / "tables" / table).iterdir())
    for file in found:
        rows = pq.read_table(io.BytesIO((run / file).read_bytes()))
        _replace(run, file, rows.slice(0, 0))
    if not vouched:
        (run / "manifest").write_text(said)
    with pytest.raises(StoreError, match=rf"{found[0]} has no rows"):
        pfdist.open_run(run).summary()
    assert main(["status", str(run)]) == 1
    assert f"{found[0]} has no rows" in capsys.readouterr().err
    (row,) = pfdist.list_runs(run.parent).to_dict("records")
    assert row["state"] == "damaged"
    assert row["fault"] == f"{found[0]} has no rows"
    assert _named(run) == found
    assert len(_run_again(job, run)) == len(found)
    assert hashes(run) == hashes(runs["finished"])
    assert _named(run) == []
    record_property("faults", f"{PROMISE}: 1")


@pytest.mark.parametrize(
    "stranger",
    [
        "tables/draws/copy of genetic-00000.parquet",
        "tables/draws/genetic-00077.parquet",
        "tables/comparison/notes.txt",
        "tables/notes.txt",
        "parts/draws/genetic-mine.parquet",
    ],
)
def test_a_strangers_file_is_named_and_moved_and_nothing_is_computed(
    stranger: str,
    job: Job,
    runs: dict[str, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    record_property: Record,
) -> None:
    run, counted = shutil.copytree(runs["finished"], tmp_path / "run"), count_draws(monkeypatch)
    (run / stranger).write_bytes(b"what somebody else put here")
    assert _named(run) == [Path(stranger)]
    (line,) = _run_again(job, run)
    assert f"{run / stranger} is not a file of this run" in line
    assert (run / "quarantine" / stranger).read_bytes() == b"what somebody else put here"
    assert hashes(run) == hashes(runs["finished"])
    assert counted == []
    assert pfdist.open_run(run).state == "finished"
    assert _named(run) == []
    assert _run_again(job, run) == []
    record_property("faults", f"{PROMISE}: 1")


def test_what_is_damaged_twice_is_kept_twice(
    job: Job, runs: dict[str, Path], tmp_path: Path, record_property: Record
) -> None:
    run = shutil.copytree(runs["finished"], tmp_path / "run")
    file = Path("tables/draws/genetic-00000.parquet")
    kept = []
    for bit in (0, 8):
        kept.append(_flip(run / file, bit))
        _run_again(job, run)
    assert {path.read_bytes() for path in (run / "quarantine" / file).parent.iterdir()} == set(kept)
    assert hashes(run) == hashes(runs["finished"])
    record_property("faults", f"{PROMISE}: {len(kept)}")


def test_repair_moves_what_is_damaged_and_says_what_going_on_will_compute(
    job: Job,
    runs: dict[str, Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    record_property: Record,
) -> None:
    run = shutil.copytree(runs["finished"], tmp_path / "run")
    wrong = ["tables/draws/random-00000.parquet", "tables/comparison/comparison-00001.parquet"]
    lost = {
        str(id_)
        for id_ in pfdist.open_run(run)
        .table("evaluations")
        .query("phase == 'random'")
        .evaluation[:3]
    }
    assert len(lost) == 3
    damaged = {name: _flip(run / name, 77) for name in wrong}
    assert main(["verify", str(run)]) == 1
    captured = capsys.readouterr()
    assert [line.split()[0] for line in captured.out.splitlines()] == sorted(
        str(run / name) for name in wrong
    )
    assert re.fullmatch(
        r"pfdist: \S+: problems found: 2\. Run `pfdist repair \S+` to move .*\n", captured.err
    )
    assert main(["repair", str(run)]) == 0
    *moved, todo = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in moved] == sorted(wrong)
    assert f"run `pfdist run {run / 'job.toml'}`" in todo
    assert "3 evaluations, what the comparison lacks (70 draws are there)" in todo
    for name, content in damaged.items():
        assert (run / "quarantine" / name).read_bytes() == content
    assert pfdist.open_run(run).state == "comparing"
    _run_again(job, run)
    assert hashes(run) == hashes(runs["finished"])
    assert main(["verify", str(run)]) == 0
    assert main(["repair", str(run)]) == 0
    assert "nothing to repair" in capsys.readouterr().out
    record_property("faults", f"{PROMISE}: {len(wrong)}")


def test_a_damaged_job_grows_all_the_same_and_does_not_shrink(
    job: Job, runs: dict[str, Path], tmp_path: Path, record_property: Record
) -> None:
    larger, fewer = (job.with_changes([f"comparison.draws={draws}"]) for draws in (170, 100))
    at_once = pfdist.run(larger, tmp_path / "at once", figures=False)
    run = shutil.copytree(runs["finished"], tmp_path / "run")
    _flip(run / "job.toml", 3)
    before = _tree(run)
    with pytest.raises(StoreError, match=r"at least the 120 draws .* got 100"):
        _run_again(fewer, run)
    assert _tree(run) == before
    _run_again(larger, run)
    assert hashes(run) == hashes(at_once.path)
    record_property("faults", f"{PROMISE}: 1")


BREAK: dict[str, Callable[[Path], object]] = {
    "nothing": lambda run: None,
    "a table": lambda run: _flip(max(run.glob("*/timings/*.parquet")), 999),
    "job.toml": lambda run: _flip(run / "job.toml", 3),
    "run.json": lambda run: _flip(run / "run.json", 3),
    "no job.toml": lambda run: (run / "job.toml").unlink(),
    "no run.json": lambda run: (run / "run.json").unlink(),
    "no manifest": lambda run: (run / "manifest").unlink(),
    "a stranger": lambda run: (run / "parts/draws/mine.parquet").write_text("mine"),
}


@pytest.mark.parametrize("what", BREAK)
@pytest.mark.parametrize("state", STATES)
def test_another_job_moves_nothing(
    state: str, what: str, job: Job, runs: dict[str, Path], tmp_path: Path, record_property: Record
) -> None:
    run = shutil.copytree(runs[state], tmp_path / "run")
    BREAK[what](run)
    before = _tree(run)
    with pytest.raises(StoreError):
        _run_again(job.with_changes(["seed=2"]), run)
    assert _tree(run) == before
    record_property("faults", f"{PROMISE}: 1")


def test_without_its_manifest_a_run_says_so_and_moves_nothing(
    job: Job, runs: dict[str, Path], tmp_path: Path, record_property: Record
) -> None:
    run = shutil.copytree(runs["finished"], tmp_path / "run")
    (run / "manifest").unlink()
    before = _tree(run)
    for act in (partial(_run_again, job), _named, lambda run: list(repair_run(run))):
        with pytest.raises(StoreError, match="has lost its manifest"):
            act(run)
    assert _tree(run) == before
    record_property("faults", f"{PROMISE}: 1")


def test_a_run_that_lost_what_says_whose_it_is_is_known_by_its_manifest(
    job: Job, runs: dict[str, Path], tmp_path: Path, record_property: Record
) -> None:
    run = shutil.copytree(runs["finished"], tmp_path / "run")
    change(run, "run", [])
    assert _run_again(job, run) == []  # what the manifest lacks is put back
    for name in ("job.toml", "run.json"):
        (run / name).unlink()
    assert len(_run_again(job, run)) == 2
    assert hashes(run) == hashes(runs["finished"])
    assert pfdist.open_run(run).state == "finished"
    record_property("faults", f"{PROMISE}: 3")
