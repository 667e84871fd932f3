"""A run that was kept stays readable; runs of other schema versions are not accepted."""

import json
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

import pfdist
from oracles.listed import rewrite
from pfdist import load_job
from pfdist.cli.main import main
from pfdist.errors import StoreError
from pfdist.filters import evaluator
from pfdist.runner import identity
from pfdist.store import SCHEMA_VERSION
from pfdist.store.verify import verify_run

pytestmark = [pytest.mark.fault, pytest.mark.usefixtures("no_figures")]
Record = Callable[[str, object], None]
PROMISE = "old results stay readable"
KEPT = Path(__file__).parents[1] / "assets" / "kept"


@pytest.fixture(autouse=True)
def _the_kernel_of_this_run(monkeypatch: pytest.MonkeyPatch) -> None:
    """It has the numbers of today's for its job."""
    kernel = json.loads((KEPT / "run.json").read_text())["kernel"]
    for module in (evaluator, identity):
        monkeypatch.setattr(module, "KERNEL_VERSION", kernel)


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    """A run of the present schema version, as it was written."""
    return shutil.copytree(KEPT, tmp_path / "kept")


def _content(run: Path) -> dict[Path, bytes]:
    return {
        path.relative_to(run): path.read_bytes()
        for path in run.rglob("*")
        if path.is_file() and path.name != ".lock"
    }


def test_the_run_of_the_present_schema_is_verified_and_computed_again_to_the_last_bit(
    kept: Path, tmp_path: Path, record_property: Record
) -> None:
    assert main(["verify", str(kept)]) == 0
    again = pfdist.run(
        load_job(kept / "job.toml"), tmp_path / "again", pool="serial", figures=False
    ).path
    tables = sorted(folder.name for folder in (kept / "tables").iterdir())
    assert len(tables) >= 6
    now = {folder.name for folder in (again / "tables").iterdir()}
    assert {*tables} == now
    for table in now - {"timings"}:
        old, new = (pd.read_parquet(run / "tables" / table) for run in (kept, again))
        pd.testing.assert_frame_equal(old, new, check_exact=True, obj=table)
    record_property("faults", f"{PROMISE}: 1")


def test_a_kept_run_without_a_table_is_mended(kept: Path) -> None:
    (lost,) = (kept / "tables" / "comparison").iterdir()
    lost.unlink()
    run = pfdist.run(load_job(kept / "job.toml"), kept, pool="serial", figures=False)
    assert run.state == "finished"
    assert list(verify_run(kept)) == []


@pytest.mark.plugins("runs")
@pytest.mark.parametrize("kernel", [1, 99])
@pytest.mark.parametrize("command", ["status", "table", "plot", "report", "verify"])
def test_a_run_of_another_kernel_is_read(
    command: str, kernel: int, kept: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = json.loads((kept / "run.json").read_text())
    rewrite(kept / "run.json", json.dumps({**run, "kernel": kernel}))
    assert main([command, str(kept)]) == 0
    assert capsys.readouterr().err == ""
    assert main(["run", str(kept / "job.toml")]) == 1
    assert f"kernel: {kernel} -> " in capsys.readouterr().err


@pytest.mark.plugins("rule", "runs", "why")
@pytest.mark.parametrize(
    "command",
    ["status {run}", "plot {run}", "verify {run}", "report {run}", "table {run}",
     "why {run}/job.toml", "bound {run}", "evaluate {run} --times 0,3", "rule {run}",
     "run {run}/job.toml", "run {run}", "run {job} --results {run}",
     "run {job} --results {run}-new --reuse {run}"],
)  # fmt: skip
@pytest.mark.parametrize("version", [SCHEMA_VERSION - 1, SCHEMA_VERSION + 1])
def test_a_run_of_another_schema_is_refused_in_a_line_that_names_the_version_for_it(
    version: int,
    command: str,
    kept: Path,
    capsys: pytest.CaptureFixture[str],
    record_property: Record,
) -> None:
    """Also if its job has keys that are unknown today."""
    text = (kept / "job.toml").read_text()
    (kept / "job.toml").write_text(text.replace("particles = 40", 'dtype = "float32"'))
    run = json.loads((kept / "run.json").read_text())
    if version < SCHEMA_VERSION:  # as of a run that knew its model by the file alone
        del run["model"], run["filter_model"]
        (kept / "files.json").unlink()  # which former versions did not have
    about = {**run, "schema_version": version, "pfdist": f"0.{version}"}
    (kept / "run.json").write_text(json.dumps(about))
    before, job = _content(kept), KEPT.parents[1] / "small.toml"
    assert main(shlex.split(command.format(run=kept, job=job))) == 1
    assert capsys.readouterr().err == (
        f"pfdist: {kept} is of schema version {version}, which pfdist 0.{version} reads and "
        f"writes; this pfdist reads version {SCHEMA_VERSION}\n"
    )
    assert _content(kept) == before
    assert not Path(f"{kept}-new").exists()
    record_property("faults", f"{PROMISE}: 1")


def test_without_the_version_that_wrote_it_a_run_is_of_an_earlier_one(kept: Path) -> None:
    (kept / "run.json").write_text('{"schema_version": 1}')
    with pytest.raises(StoreError, match=r"version 1, which an earlier version of pfdist reads"):
        pfdist.open_run(kept)


@pytest.mark.plugins("runs")
def test_a_list_says_which_version_reads_a_run(kept: Path) -> None:
    run = json.loads((kept / "run.json").read_text())
    (kept / "run.json").write_text(json.dumps({**run, "schema_version": 2, "pfdist": "0.2"}))
    (row,) = pfdist.list_runs(kept.parent).to_dict("records")
    assert row["fault"] == "is of schema version 2, which pfdist 0.2 reads and writes"
