"""Old results stay readable: a run of each schema version, as it was written."""

import json
import re
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

import pfdist
from oracles.bytes_of import hashes
from pfdist import load_job
from pfdist.cli.main import main
from pfdist.errors import RunMismatchError
from pfdist.store import SCHEMA_VERSION

pytestmark = [pytest.mark.fault, pytest.mark.usefixtures("no_figures")]
Record = Callable[[str, object], None]
PROMISE = "old results stay readable"
ASSETS = Path(__file__).parents[1] / "assets"


@pytest.fixture
def old(tmp_path: Path) -> Path:
    """A run of schema version 1."""
    return shutil.copytree(ASSETS / "schema-1", tmp_path / "old")


@pytest.fixture
def signed(tmp_path: Path) -> Path:
    """A run of schema version 2, which keeps checksums; its files do not name their run."""
    return shutil.copytree(ASSETS / "schema-2", tmp_path / "signed")


@pytest.fixture(params=["schema-1", "schema-2"])
def any_old(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    return shutil.copytree(ASSETS / request.param, tmp_path / "any-old")


def _content(run: Path) -> dict[Path, bytes]:
    return {
        path.relative_to(run): path.read_bytes()
        for path in run.rglob("*")
        if path.is_file() and path.name != ".lock"
    }


def test_its_figures_are_what_they_were(old: Path, record_property: Record) -> None:
    run = pfdist.open_run(old)
    summary = run.summary()
    assert (summary["state"], summary["evaluations"], summary["draws_compared"]) == (
        "finished", 34, 250,
    )  # fmt: skip
    genetic = summary["results"]["genetic"]
    assert genetic["measurement_times"] == [1, 2, 4, 9]
    assert genetic["expected_mse"] == pytest.approx(37.30494315961267, rel=1e-12)
    assert genetic["mean_relative_gain"] == pytest.approx(-0.03524811607630332, rel=1e-12)
    assert genetic["positive_fraction"] == 0.608
    assert genetic["gain_of_means"] == pytest.approx(0.1273525257028959, rel=1e-12)
    gains = run.gains()
    assert gains["gain_genetic"].mean() == pytest.approx(-0.03524811607630332, rel=1e-12)
    assert gains["gain_genetic"].quantile(0.75) == pytest.approx(0.396, abs=0.001)
    assert (len(gains), len(run.draws()), len(run.trajectories())) == (250, 34 * 30, 100 * 13)
    record_property("faults", f"{PROMISE}: 1")


def test_the_figures_of_schema_version_2_are_what_they_were(
    signed: Path, record_property: Record
) -> None:
    run = pfdist.open_run(signed)
    summary = run.summary()
    assert (summary["state"], summary["evaluations"], summary["draws_compared"]) == (
        "finished", 262, 250,
    )  # fmt: skip
    found = summary["results"]["survivors"]
    assert found["measurement_times"] == [1, 3, 7, 11]
    assert found["expected_mse"] == pytest.approx(28.554, abs=5e-4)
    assert found["standard_error"] == pytest.approx(1.602, abs=5e-4)
    assert found["search_cost"] == pytest.approx(25.517, abs=5e-4)
    assert found["search_estimation"]["estimator"] == "filter_variance"
    assert summary["results"]["genetic"]["gain_of_means"] == pytest.approx(0.1274, abs=5e-5)
    assert summary["results"]["regular"]["gain_over_itself"] == pytest.approx(-0.0768, abs=5e-5)
    assert main(["verify", str(signed)]) == 0
    record_property("faults", f"{PROMISE}: 1")


def test_the_run_of_the_present_schema_is_verified_and_computed_again_to_the_last_bit(
    tmp_path: Path, record_property: Record
) -> None:
    kept = shutil.copytree(ASSETS / f"schema-{SCHEMA_VERSION}", tmp_path / "kept")
    assert main(["verify", str(kept)]) == 0
    again = pfdist.run(
        load_job(kept / "job.toml"), tmp_path / "again", pool="serial", figures=False
    ).path
    tables = sorted(folder.name for folder in (kept / "tables").iterdir())
    assert len(tables) >= 6
    assert {folder.name for folder in (again / "tables").iterdir()} >= {*tables}
    for table in set(tables) - {"timings"}:
        old, new = (pd.read_parquet(run / "tables" / table) for run in (kept, again))
        pd.testing.assert_frame_equal(old, new, check_exact=True, obj=table)
    record_property("faults", f"{PROMISE}: 1")


def test_its_status_and_figures_are_made(
    old: Path, capsys: pytest.CaptureFixture[str], record_property: Record
) -> None:
    assert main(["status", str(old), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["results"]["random"]["gain_draws"] == 250
    assert main(["plot", str(old)]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 12
    record_property("faults", f"{PROMISE}: 1")


@pytest.mark.parametrize("command", ["verify", "repair"])
def test_that_it_kept_no_checksums_is_said(
    command: str, old: Path, capsys: pytest.CaptureFixture[str], record_property: Record
) -> None:
    assert main([command, str(old)]) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "schema version 1, which kept no checksums: it can be read, but not verified" in error
    record_property("faults", f"{PROMISE}: 1")


def test_going_on_with_it_is_refused_with_the_difference_and_moves_nothing(
    any_old: Path, record_property: Record
) -> None:
    before = _content(any_old)
    job = load_job(any_old / "job.toml", ["execution.pool=serial"])
    for wanted in (job, job.with_changes(["comparison.draws=430"])):
        with pytest.raises(RunMismatchError, match=rf"schema_version: [12] -> {SCHEMA_VERSION}"):
            pfdist.run(wanted, any_old, figures=False)
    assert _content(any_old) == before
    record_property("faults", f"{PROMISE}: 1")


def test_another_run_is_started_from_it_and_it_stays_as_it_is(
    any_old: Path, tmp_path: Path, record_property: Record
) -> None:
    before = _content(any_old)
    job = load_job(ASSETS.with_name("small.toml"), ["comparison.draws=20"])
    forked = pfdist.run(job, any_old, fork=tmp_path / "new", figures=False)
    assert hashes(forked.path) == hashes(pfdist.run(job, tmp_path / "nothing", figures=False).path)
    assert _content(any_old) == before
    record_property("faults", f"{PROMISE}: 1")


@pytest.mark.parametrize("command", ["status {run}", "plot {run}", "run {job} --results {run}"])
def test_a_newer_run_is_refused_with_a_sentence(
    command: str, old: Path, capsys: pytest.CaptureFixture[str], record_property: Record
) -> None:
    run = json.loads((old / "run.json").read_text())
    (old / "run.json").write_text(json.dumps({**run, "schema_version": SCHEMA_VERSION + 1}))
    before, job = _content(old), ASSETS.with_name("small.toml")
    assert main(shlex.split(command.format(run=old, job=job))) == 1
    assert re.fullmatch(
        rf"pfdist: .* is of schema version {SCHEMA_VERSION + 1}; this pfdist reads up to "
        rf"{SCHEMA_VERSION}: use the newer pfdist that wrote it\n",
        capsys.readouterr().err,
    )
    assert _content(old) == before
    record_property("faults", f"{PROMISE}: 1")
