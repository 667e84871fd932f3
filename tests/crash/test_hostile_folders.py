"""A run's folder may come from anywhere: nothing in it leads out of it, and nothing in it hangs."""

import errno
import json
import os
import shutil
import stat
import subprocess
import sys
from functools import partial
from pathlib import Path

import pyarrow as pa
import pytest

import pfdist
from oracles.bytes_of import hashes
from oracles.file_layer import FileLayer
from pfdist import Job, load_job
from pfdist.cli.main import main
from pfdist.errors import StoreError
from pfdist.store import Store, files, run_key, schema
from pfdist.store.verify import verify_run

SMALL = ["search.genetic.generations=2", "search.random.evaluations=3", "comparison.draws=120"]
COMMANDS = ["status {run}", "plot {run}", "verify {run}", "report {run}", "why {run}/job.toml"]
RUN = "run {job} --results {run} --pool serial"


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Job:
    path = tmp_path_factory.mktemp("job") / "small.toml"
    path.write_text((Path(__file__).parents[1] / "small.toml").read_text())
    return load_job(path, SMALL)


@pytest.fixture(scope="module")
def finished(job: Job, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return pfdist.run(job, tmp_path_factory.mktemp("runs") / "finished", figures=False).path


@pytest.fixture
def run(finished: Path, tmp_path: Path) -> Path:
    return shutil.copytree(finished, tmp_path / "run")


@pytest.fixture
def outside(tmp_path: Path) -> Path:
    """A folder that no command may change."""
    folder = tmp_path / "outside"
    folder.mkdir()
    (folder / "thesis.svg").write_text("do not touch")
    return folder


def _link(entry: Path, target: Path) -> None:
    if entry.is_dir() and not entry.is_symlink():
        shutil.rmtree(entry)
    entry.unlink(missing_ok=True)
    entry.parent.mkdir(exist_ok=True)
    entry.symlink_to(target)


def _state(folder: Path) -> dict[str, bytes]:
    return {str(path): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def _tables(run: Path) -> dict[str, str]:
    return {path: sha256 for path, sha256 in hashes(run).items() if not path.startswith("figures")}


def _said(command: str, run: Path, job: Job, capsys: pytest.CaptureFixture[str]) -> str:
    """Refuse with one line on standard error, which is given."""
    changes = " ".join(["--set", *SMALL]) if command == RUN else ""
    words = f"{command.format(run=run, job=job.path)} {changes}".split()
    assert main(words) == 1, words
    error = capsys.readouterr().err
    lines = [line for line in error.splitlines() if line.startswith("pfdist: ")]
    assert len(lines) == 1, error
    return lines[0]


@pytest.mark.parametrize(
    ("command", "kind"), [(COMMANDS[2], "link"), (RUN, "link"), (RUN, "pipe"), (RUN, "folder")]
)
def test_a_lock_that_is_no_plain_file_is_refused(
    kind: str, command: str, run: Path, job: Job, outside: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (run / ".lock").unlink()
    if kind == "link":
        _link(run / ".lock", outside / "thesis.svg")
    elif kind == "pipe":
        os.mkfifo(run / ".lock")
    else:
        (run / ".lock").mkdir()
    before = _state(outside)
    assert ".lock" in _said(command, run, job, capsys)
    assert _state(outside) == before


@pytest.mark.parametrize(
    "command", [RUN, *(pytest.param(each, marks=pytest.mark.crash) for each in COMMANDS[:3])]
)
@pytest.mark.parametrize(
    "entry", ["figures", "tables", "tables/comparison", "parts", "files.json", "run.json"]
)
def test_nothing_is_opened_through_a_link(
    entry: str, command: str, run: Path, job: Job, outside: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _link(run / entry, outside)
    before = _state(outside)
    if command.startswith("verify"):
        assert main(["verify", str(run)]) == 1
        said = capsys.readouterr().out
    else:
        said = _said(command, run, job, capsys)
    kind = "file" if entry.endswith(".json") else "folder"
    assert f"{run / entry} must be a plain {kind}, got a link: remove it, and run the same" in said
    assert _state(outside) == before


@pytest.mark.parametrize(
    ("kind", "place"),
    [("folder", "tables/draws"), ("link", "tables/draws"), ("pipe", "parts/comparison")],
)
def test_what_is_no_file_in_a_files_place_is_never_opened(
    kind: str, place: str, run: Path, finished: Path, job: Job, outside: Path
) -> None:
    """The name of a published file must be that of a plain file, as a part's name is ignored."""
    if place == "tables/draws":
        entry = min((run / place).iterdir())
        entry.unlink()
    else:
        entry = run / place / f"comparison-{'0' * 16}.parquet"
        entry.parent.mkdir(parents=True, exist_ok=True)
    if kind == "link":
        entry.symlink_to(min((finished / "tables/draws").iterdir()))
    else:
        entry.mkdir() if kind == "folder" else os.mkfifo(entry)
    if place == "tables/draws":
        with pytest.raises(StoreError, match=f"{entry.name} is damaged: .*; remove it"):
            pfdist.open_run(run).table("draws")
        assert any(str(entry) in line for line in verify_run(run))
    else:
        assert pfdist.open_run(run).draws_compared == 120
    entry.rmdir() if kind == "folder" else entry.unlink()
    assert _tables(pfdist.run(job, run, figures=False).path) == _tables(finished)


@pytest.mark.parametrize("name", ["/../../x", "", "A", "a\nb"])
def test_a_name_from_a_table_is_held_to_the_rule_for_names(
    name: str, run: Path, job: Job, capsys: pytest.CaptureFixture[str]
) -> None:
    store, before = Store(run, run_key(run)), {path.name for path in run.parent.iterdir()}
    compared = store.read("compared")
    compared.loc[1, "name"] = name
    rows = pa.Table.from_pandas(compared, schema=schema("compared"), preserve_index=False)
    store.publish("compared", "search", [rows])
    assert "name" in _said("plot {run}", run, job, capsys)
    assert {path.name for path in run.parent.iterdir()} == before


def test_the_folders_above_a_new_run_are_flushed_to_disk(
    job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flushed, flush = list[Path](), files._flush

    def noted(path: Path, mode: int) -> None:
        flushed.append(path)
        flush(path, mode)

    monkeypatch.setattr(files, "_flush", noted)
    pfdist.run(job, tmp_path / "results" / "new", figures=False)
    assert {tmp_path, tmp_path / "results", tmp_path / "results" / "new"} <= set(flushed)


def test_a_folder_of_results_may_be_a_link_itself(
    run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "elsewhere").symlink_to(run)
    assert main(["status", str(tmp_path / "elsewhere"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["state"] == "finished"
    with pytest.raises(StoreError):
        pfdist.open_run(tmp_path / "nowhere")


def test_the_command_writes_a_run_that_its_owner_can_use_whatever_the_umask_is(
    job: Job, tmp_path: Path
) -> None:
    run = tmp_path / "results" / "run"
    words = f"run {job.path} --results {run} --pool serial --no-report --set filter.engine=numpy"
    subprocess.run(
        [sys.executable, "-m", "pfdist", *words.split(), *SMALL], umask=0o777, check=True
    )
    made = list((tmp_path / "results").rglob("*"))
    assert len(made) > 10
    for path in (run.parent, *made):
        assert stat.S_IMODE(path.stat().st_mode) == (0o700 if path.is_dir() else 0o600), path


def test_python_makes_no_folder_that_its_owner_cannot_use(job: Job, tmp_path: Path) -> None:
    mask = os.umask(0o777)
    try:
        with pytest.raises(StoreError, match=r"cannot make .*run: the umask of this process"):
            pfdist.run(job.with_changes(["filter.engine=numpy"]), tmp_path / "results" / "run")
    finally:
        os.umask(mask)
    assert not (tmp_path / "results").exists()


def test_a_finished_run_that_cannot_be_written_shows_what_it_has_found(
    run: Path, job: Job, monkeypatch: pytest.MonkeyPatch
) -> None:
    access, opened, said = os.access, os.open, list[str]()

    def refusing(path: Path, flags: int, *mode: int) -> int:
        if flags & (os.O_RDWR | os.O_WRONLY) and Path(path).is_relative_to(run):
            raise OSError(errno.EROFS, os.strerror(errno.EROFS))
        return opened(path, flags, *mode)

    monkeypatch.setattr(os, "open", refusing)
    monkeypatch.setattr(os, "access", lambda path, mode: path != run and access(path, mode))
    layer = FileLayer(monkeypatch, run)
    assert layer.run(lambda: pfdist.run(job, run, say=said.append), "EROFS", 0) == 0
    assert said == [f"{run} cannot be written: its figures and its report stay as they are"]
    for changes, words in (("comparison.draws=130", "cannot lock .*Read-only"), ("seed=2", "seed")):
        with pytest.raises(StoreError, match=words):
            layer.run(partial(pfdist.run, job.with_changes([changes]), run), "EROFS", 0)
        assert layer.count == 0
