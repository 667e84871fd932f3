"""Ended, or failed, while a report is written or `why` computes: results and reports stay whole."""

import shutil
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path

import pytest

import pfdist
from oracles.bytes_of import hashes
from oracles.file_layer import Ended, FileLayer
from pfdist import Job
from pfdist.errors import PfdistWarning, StoreError
from pfdist.questions.report import write_report
from pfdist.store.verify import verify_run

PROMISE = "a report that fails spoils neither the run nor the earlier report"
EXACT = ("model.name=random_walk", "filter.engine=kalman", "comparison.draws=30")
SEARCH = "search=[{method='genetic', generations=1}]"
FAULTS = {"ended": Ended, "ENOSPC": StoreError, "EIO": StoreError, "EROFS": StoreError}


@pytest.fixture
def reported(small_job: Job, tmp_path: Path) -> Path:
    """A finished run with a report."""
    job = small_job.with_changes([*EXACT, SEARCH])
    return pfdist.run(job, tmp_path / "begun", figures=False, report=True).path


@pytest.mark.crash
@pytest.mark.parametrize("fault", FAULTS)
def test_a_report_is_the_earlier_one_or_the_new_one_whatever_goes_wrong(
    reported: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    fault: str,
    record_property: Callable[[str, object], None],
) -> None:
    """EROFS stands for a folder that can only be read."""
    layer = FileLayer(monkeypatch, tmp_path)
    whole, earlier = hashes(reported), (reported / "report.html").read_bytes()

    def again(path: Path) -> None:
        write_report(pfdist.open_run(path), seconds=5)

    path = shutil.copytree(reported, tmp_path / "whole" / "begun")
    count = layer.run(partial(again, path))
    new = (path / "report.html").read_bytes()
    assert count > 0
    assert new != earlier
    for at in range(count):
        path = shutil.copytree(reported, tmp_path / f"{at}" / "begun")
        with suppress(FAULTS[fault]):  # a page that cannot be listed is no error
            layer.run(partial(again, path), fault, at)
        assert (path / "report.html").read_bytes() in (earlier, new)
        assert hashes(path) == whole
        assert not list(verify_run(path))
        again(path)
        assert (path / "report.html").read_bytes() == new
    record_property("faults", f"{PROMISE}: {count}")


@pytest.mark.crash
@pytest.mark.parametrize("fault", FAULTS)
def test_a_why_that_goes_wrong_at_any_file_operation_ends_with_the_same_bytes(
    reported: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    fault: str,
    record_property: Callable[[str, object], None],
) -> None:
    """`pfdist why` writes two tables, and the report anew."""
    layer = FileLayer(monkeypatch, tmp_path)

    def why(path: Path) -> None:
        pfdist.why(path / "job.toml", figures=False)

    untouched = shutil.copytree(reported, tmp_path / "whole" / "begun")
    count = layer.run(partial(why, untouched))
    whole, report = hashes(untouched), (untouched / "report.html").read_bytes()
    assert b"What each measurement is worth" in report
    faults = 0
    for at in range(count):
        path = shutil.copytree(reported, tmp_path / f"{at}" / "begun")
        try:
            layer.run(partial(why, path), fault, at)
        except (FAULTS[fault], PfdistWarning):  # which says that there is no report
            assert pfdist.open_run(path).state == "finished"
        why(path)
        assert hashes(path) == whole, f"{fault} at operation {at} of {count}"
        assert (path / "report.html").read_bytes() == report
        assert not list(verify_run(path))
        faults += 1
    assert faults > 5
    record_property("faults", f"{PROMISE}: {faults}")


@pytest.mark.parametrize("fault", ["ENOSPC", "EIO", "EROFS"])
def test_a_run_whose_report_cannot_be_written_is_finished(
    small_job: Job,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    fault: str,
    record_property: Callable[[str, object], None],
) -> None:
    job, told = small_job.with_changes([*EXACT, SEARCH]), list[str]()
    layer = FileLayer(monkeypatch, tmp_path)
    write = write_report

    def failing(run: pfdist.Run, target: float | None = None) -> None:
        layer.run(partial(write, run, target=target), fault, 0)

    monkeypatch.setattr("pfdist.questions.report.write_report", failing)
    run = pfdist.run(job, tmp_path / "run", figures=False, report=True, say=told.append)
    assert run.state == "finished"
    assert told[-1].startswith("there is no report: cannot write ")
    assert not list(verify_run(run.path))
    record_property("faults", f"{PROMISE}: 1")
