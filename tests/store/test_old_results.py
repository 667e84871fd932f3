"""A run that was kept stays readable; runs of other schema versions are refused."""

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
from pfdist.errors import PfdistWarning
from pfdist.filters import evaluator
from pfdist.runner import identity
from pfdist.store import SCHEMA_VERSION
from pfdist.store.verify import verify_run

pytestmark = [pytest.mark.fault, pytest.mark.usefixtures("no_figures")]
Record = Callable[[str, object], None]
PROMISE = "old results stay readable"
ASSETS = Path(__file__).parents[1] / "assets"


@pytest.fixture(autouse=True)
def _the_kernel_of_these_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    """It has the numbers of today's for their jobs."""
    for module in (evaluator, identity):
        monkeypatch.setattr(module, "KERNEL_VERSION", 8)


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    """A run of the present schema version, as it was written."""
    return shutil.copytree(ASSETS / "schema-4", tmp_path / "kept")


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


def test_a_run_with_a_former_table_is_mended(kept: Path) -> None:
    (lost,) = (kept / "tables" / "comparison").iterdir()
    lost.unlink()
    run = pfdist.run(load_job(kept / "job.toml"), kept, pool="serial", figures=False)
    assert run.state == "finished"
    assert "repeated" not in run.tables
    assert list(verify_run(kept)) == []


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("command", ["status", "table", "plot", "report", "verify"])
def test_a_run_of_the_former_schema_is_read(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], record_property: Record
) -> None:
    """Its job names estimators, with the values that they had without a name."""
    old = shutil.copytree(ASSETS / "schema-3", tmp_path / "old")
    assert main([command, str(old)]) == 0
    assert capsys.readouterr().err == ""
    record_property("faults", f"{PROMISE}: 1")


def test_keys_that_are_gone_are_ignored_with_a_line(tmp_path: Path, small_run: pfdist.Run) -> None:
    job = small_run.path / "job.toml"
    rewrite(job, job.read_text().replace("[evaluation]", "[evaluation]\nestimator = 'two_filters'"))
    with pytest.warns(PfdistWarning, match=r"ignored: evaluation.estimator = 'two_filters'"):
        run = pfdist.open_run(small_run.path)
    assert run.best == small_run.best


@pytest.mark.parametrize(
    "command",
    ["status {run}", "plot {run}", "verify {run}", "report {run}",
     "why {run}/job.toml",
     "run {job} --results {run}", "run {job} --results {run}-new --reuse {run}"],
)  # fmt: skip
@pytest.mark.parametrize("version", [1, 2, SCHEMA_VERSION + 1])
def test_a_run_of_another_schema_is_refused_in_a_line_that_names_the_version_for_it(
    version: int,
    command: str,
    kept: Path,
    capsys: pytest.CaptureFixture[str],
    record_property: Record,
) -> None:
    run = json.loads((kept / "run.json").read_text())
    if version < SCHEMA_VERSION:  # as of a run that knew its model by the file alone
        del run["model"], run["filter_model"]
        (kept / "files.json").unlink()  # which former versions did not have
    (kept / "run.json").write_text(json.dumps({**run, "schema_version": version}))
    before, job = _content(kept), ASSETS.with_name("small.toml")
    assert main(shlex.split(command.format(run=kept, job=job))) == 1
    reads = f"this pfdist reads version {SCHEMA_VERSION}"
    assert capsys.readouterr().err == f"pfdist: {kept} is of schema version {version}" + (
        f", which pfdist 0.{version} reads and writes; {reads}\n"
        if version < SCHEMA_VERSION
        else f"; {reads}: use the newer pfdist that wrote it\n"
    )
    assert _content(kept) == before
    assert not Path(f"{kept}-new").exists()
    record_property("faults", f"{PROMISE}: 1")


def test_a_list_says_which_version_reads_a_run(kept: Path) -> None:
    run = json.loads((kept / "run.json").read_text())
    (kept / "run.json").write_text(json.dumps({**run, "schema_version": 2}))
    (row,) = pfdist.list_runs(kept.parent).to_dict("records")
    assert row["fault"] == "is of schema version 2, which pfdist 0.2 reads and writes"
