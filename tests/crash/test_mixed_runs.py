"""Files of another run are never taken for this run's own, whatever made them get there."""

import shutil
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest

import pfdist
from oracles.bytes_of import hashes
from oracles.counted import A_DRAW
from oracles.manifest_lines import change, said_of
from pfdist import Job, load_job
from pfdist.analysis.stored_run import statistics_of
from pfdist.cli.main import main
from pfdist.errors import StoreError
from pfdist.runner import door
from pfdist.runner.pace import Pace
from pfdist.runner.progress import Progress
from pfdist.store import Store, run_key
from pfdist.store.repair import repair_run, verify_run
from pfdist.store.tables import rows_and_run

PROMISE = "damage is found"
SEEDS = (1, 2)
Record = Callable[[str, object], None]


@pytest.fixture(scope="module", autouse=True)
def _many_commits() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(door, "COMMIT_SECONDS", 0.0)
        patch.setattr(Pace, "size", lambda pace, remaining: 90 * A_DRAW)
        yield


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Job:
    path = tmp_path_factory.mktemp("job") / "small.toml"
    path.write_text((Path(__file__).parents[1] / "small.toml").read_text())
    return load_job(path)


class EndedError(Exception):
    """The run's process has come to its end."""


@pytest.fixture(scope="module")
def runs(job: Job, tmp_path_factory: pytest.TempPathFactory) -> dict[tuple[int, str], Path]:
    """For each seed a finished run, and two that ended in a search and in the comparison."""
    folder, found = tmp_path_factory.mktemp("runs"), dict[tuple[int, str], Path]()
    for seed in SEEDS:
        seeded = job.with_changes([f"seed={seed}"])
        for state, last_phase in (("searching", "genetic"), ("comparing", "comparison")):
            found[seed, state] = folder / f"{seed}-{state}"
            with pytest.raises(EndedError):
                pfdist.run(
                    seeded, found[seed, state], progress=partial(_end_in, last_phase), figures=False
                )
            assert pfdist.open_run(found[seed, state]).state == state
        found[seed, "finished"] = pfdist.run(
            seeded, folder / f"{seed}-finished", figures=False
        ).path
    return found


def _end_in(phase: str, progress: Progress) -> None:
    if progress.phase == phase and progress.evaluations >= 14:
        raise EndedError


@pytest.mark.parametrize(
    ("state", "copied"),
    [
        ("comparing", "parts/comparison"),
        ("searching", "parts/draws"),
        ("searching", "parts/evaluations"),
        ("finished", "tables/comparison"),
        ("finished", "tables/draws"),
        ("finished", "tables/compared"),
    ],
)
def test_rows_of_another_run_are_named_put_aside_and_computed(
    state: str,
    copied: str,
    job: Job,
    runs: dict[tuple[int, str], Path],
    tmp_path: Path,
    record_property: Record,
) -> None:
    run = shutil.copytree(runs[1, state], tmp_path / "run")
    shutil.copytree(runs[2, state] / copied, run / copied, dirs_exist_ok=True)
    change(run, f"{copied}/", said_of(runs[2, state], f"{copied}/"))
    foreign = {
        path.relative_to(run)
        for path in run.glob(f"{copied}/*.parquet")
        if (runs[2, state] / path.relative_to(run)).exists()
        and path.read_bytes() == (runs[2, state] / path.relative_to(run)).read_bytes()
    }
    assert foreign
    named = {damage.path: damage.what for damage in verify_run(run)}
    assert named == dict.fromkeys(foreign, "belongs to another run")
    said: list[str] = []
    pfdist.run(job, run, say=said.append, figures=False)
    moved = [line for line in said if "belongs to another run: it is now" in line]
    assert len(moved) == len(foreign)
    assert hashes(run) == hashes(runs[1, "finished"])
    assert not list(verify_run(run))
    record_property("faults", f"{PROMISE}: {len(foreign)}")


def test_a_reader_refuses_rows_of_another_run_and_repair_moves_them(
    runs: dict[tuple[int, str], Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    record_property: Record,
) -> None:
    run = shutil.copytree(runs[1, "finished"], tmp_path / "run")
    file = Path("tables/comparison/comparison-00000.parquet")
    shutil.copy(runs[2, "finished"] / file, run / file)
    change(run, file, said_of(runs[2, "finished"], file))
    with pytest.raises(StoreError, match=r"comparison-00000\.parquet belongs to another run"):
        statistics_of(pfdist.open_run(run))
    assert main(["status", str(run)]) == 1
    assert capsys.readouterr().err.count("\n") == 1
    assert any("belongs to another run" in line for line in repair_run(run))
    assert not (run / file).exists()
    record_property("faults", f"{PROMISE}: 1")


@pytest.mark.parametrize("key", ["the other's", "none"])
@pytest.mark.parametrize("state", ["finished", "comparing"])
def test_two_runs_in_one_folder_are_told_apart_by_job_and_model(
    key: str,
    state: str,
    job: Job,
    runs: dict[tuple[int, str], Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    record_property: Record,
) -> None:
    run, other = shutil.copytree(runs[1, state], tmp_path / "run"), runs[2, state]
    for folder in ["tables", *(["parts"] if state == "comparing" else [])]:
        shutil.copytree(other / folder, run / folder, dirs_exist_ok=True)
    change(run, "tables/", said_of(other, "tables/"))
    change(run, "run", said_of(other, "run") if key == "the other's" else [])
    for command in ("status", "verify", "plot"):
        assert main([command, str(run)]) == 1
        (line,) = capsys.readouterr().err.splitlines()
        assert "manifest" in line
        assert f"`pfdist repair {run}`" in line
    with pytest.raises(StoreError):
        pfdist.open_run(run)
    again = shutil.copytree(run, tmp_path / "again")  # going on heals it, too
    said = list(repair_run(run))
    assert f"it holds {run_key(runs[1, state])} now" in said[0]
    assert [line for line in said if "belongs to another run" in line]
    for folder in (run, again):
        pfdist.run(job, folder, figures=False)
        assert hashes(folder) == hashes(runs[1, "finished"])
        assert not list(verify_run(folder))
    record_property("faults", f"{PROMISE}: 2")


def _content(run: Path) -> dict[Path, bytes]:
    files = [path for path in run.rglob("*") if path.is_file() and path.name != ".lock"]
    return {path: path.read_bytes() for path in files}


@pytest.mark.parametrize("how", ["copied", "appended"])
@pytest.mark.parametrize("state", ["finished", "comparing"])
def test_a_folder_is_of_the_run_whose_manifest_came_last(
    how: str,
    state: str,
    job: Job,
    runs: dict[tuple[int, str], Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    record_property: Record,
) -> None:
    run, other = shutil.copytree(runs[1, state], tmp_path / "run"), runs[2, state]
    for folder in ["tables", *(["parts"] if state == "comparing" else [])]:
        shutil.copytree(other / folder, run / folder, dirs_exist_ok=True)
    with (run / "manifest").open("w" if how == "copied" else "a") as manifest:
        manifest.write((other / "manifest").read_text())
    for command in ("status", "plot"):
        assert main([command, str(run)]) == 1
        (line,) = capsys.readouterr().err.splitlines()
        assert "job.toml and run.json are not those of the run whose key manifest holds" in line
        assert f"`pfdist repair {run}`" in line
    both = [Path(name) for name in ("job.toml", "run.json")]  # run.json: begun in one second
    differ = {name for name in both if (run / name).read_bytes() != (other / name).read_bytes()}
    assert both[0] in differ <= {damage.path for damage in verify_run(run)}
    before = _content(run)
    with pytest.raises(StoreError, match="nothing was touched"):
        pfdist.run(job, run, figures=False)
    assert _content(run) == before
    again = shutil.copytree(run, tmp_path / "again")  # going on heals it, too
    assert len(list(repair_run(run))) > 2
    for folder in (run, again):
        pfdist.run(job.with_changes(["seed=2"]), folder, figures=False)
        assert hashes(folder) == hashes(runs[2, "finished"])
        assert not list(verify_run(folder))
    record_property("faults", f"{PROMISE}: 2")


def test_where_nothing_says_whose_files_they_are_repair_moves_them_all(
    job: Job, runs: dict[tuple[int, str], Path], tmp_path: Path, record_property: Record
) -> None:
    run = shutil.copytree(runs[1, "finished"], tmp_path / "run")
    shutil.copytree(runs[2, "finished"] / "tables", run / "tables", dirs_exist_ok=True)
    shutil.copy(runs[2, "finished"] / "manifest", run)
    change(run, "run", [])
    (run / "run.json").write_text("{}")
    files = [path.relative_to(run) for path in run.glob("tables/*/*.parquet")]
    with pytest.raises(StoreError, match="must hold the run's key, got none"):
        list(verify_run(run))
    said = list(repair_run(run))
    assert "do not say which is the run's own" in said[0]
    assert not list(run.glob("tables/*/*.parquet"))
    assert all((run / "quarantine" / file).exists() for file in files)
    pfdist.run(job, run, figures=False)  # either job goes on from there
    assert hashes(run) == hashes(runs[1, "finished"])
    assert not list(verify_run(run))
    record_property("faults", f"{PROMISE}: 1")


def test_every_file_of_a_table_names_its_run(runs: dict[tuple[int, str], Path]) -> None:
    keys = set[str | None]()
    for run in runs.values():
        files = [*run.glob("tables/*/*.parquet"), *run.glob("parts/*/*.parquet")]
        assert len(files) > 3
        assert {rows_and_run(file)[1] for file in files} == {run_key(run)}
        keys.add(run_key(run))
    assert len(keys) == len(SEEDS)
    assert None not in keys


def test_a_run_that_reuses_another_signs_what_it_takes(
    job: Job, runs: dict[tuple[int, str], Path], tmp_path: Path
) -> None:
    longer = job.with_changes(["search.random.evaluations=12"])
    new = pfdist.run(longer, tmp_path / "new", reuse=runs[1, "finished"], figures=False)
    assert not list(verify_run(new.path))
    assert hashes(new.path) == hashes(pfdist.run(longer, tmp_path / "alone", figures=False).path)
    assert len(Store(new.path).read("draws")) == len(pfdist.open_run(new.path).table("draws"))
