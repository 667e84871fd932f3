"""A report that cannot be written spoils no run; see also `test_every_operation.py`."""

from functools import partial
from pathlib import Path

import pytest

import pfdist
from oracles.file_layer import FileLayer
from pfdist import Job
from pfdist.questions.report import write_report
from pfdist.store.verify import verify_run

EXACT = ("model.name=random_walk", "filter.engine=kalman", "comparison.draws=30")
SEARCH = "search=[{method='genetic', generations=1}]"


@pytest.mark.parametrize("fault", ["ENOSPC", "EROFS"])
def test_a_run_whose_report_cannot_be_written_is_finished(
    small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fault: str
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
