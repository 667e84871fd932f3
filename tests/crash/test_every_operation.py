"""Ended before and after every single file operation of a run, and run again: the same bytes."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import pfdist
from oracles.bytes_of import hashes
from pfdist import Job
from pfdist.runner import collect, comparison_phase
from pfdist.runner.pace import Pace
from pfdist.store import files, parquet

CHANGES = [
    "search.genetic.generations=2",
    "search.genetic.population=4",
    "search.random.evaluations=3",
    "evaluation.draws=40",
]


class Ended(BaseException):
    """Stands for a kill: nothing handles it, and no file is touched any more."""


class Operations:
    """Counts the writes and removals of a run, and ends it at one of them."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.count, self.last = 0, -1
        for name in ("_write", "remove"):
            monkeypatch.setattr(files, name, self._counted(getattr(files, name)))
        monkeypatch.setattr(files, "_flush", lambda path, mode: None)  # slow, and seen elsewhere

    def _counted(self, operation: Callable[..., None]) -> Callable[..., None]:
        def counted(*arguments: Any, **options: Any) -> None:
            self._tick()
            operation(*arguments, **options)
            self._tick()

        return counted

    def _tick(self) -> None:
        if self.count == self.last:
            raise Ended  # and again at every later one, as in a process that is gone
        self.count += 1

    def run(self, job: Job, path: Path, last: int = -1) -> int:
        self.count, self.last = 0, last
        pfdist.run(job, path)
        return self.count


@pytest.fixture
def operations(monkeypatch: pytest.MonkeyPatch) -> Operations:
    monkeypatch.setattr(collect, "COMMIT_SECONDS", 0.0)
    monkeypatch.setattr(Pace, "size", lambda pace, remaining: 90)
    monkeypatch.setattr(comparison_phase, "TRAJECTORIES", 30)
    monkeypatch.setitem(parquet.ROWS_IN_A_FILE, "comparison", 50)
    monkeypatch.setitem(parquet.ROWS_IN_A_FILE, "draws", 100)
    # Figures are drawn at the end, from the tables: their names are enough here.
    monkeypatch.setattr("pfdist.runner.run.draw_figures", lambda run: [])
    monkeypatch.setattr("pfdist.runner.run.figure_files", lambda run: [])
    return Operations(monkeypatch)


@pytest.mark.parametrize("step", [7, pytest.param(1, marks=pytest.mark.crash)])
@pytest.mark.parametrize("grown", [False, True], ids=["fresh", "growing"])
def test_a_run_ended_at_any_file_operation_ends_with_the_same_bytes(
    grown: bool, step: int, small_job: Job, tmp_path: Path, operations: Operations
) -> None:
    job = small_job.with_changes([*CHANGES, "comparison.draws=120"])
    larger = job.with_changes(["comparison.draws=170"]) if grown else job

    def start(path: Path) -> Path:
        if grown:
            operations.run(job, path)
        return path

    count = operations.run(larger, start(tmp_path / "whole"))
    whole = hashes(tmp_path / "whole")
    assert count > (20 if grown else 100)
    for last in range(0, count, step):
        path = start(tmp_path / f"{last}")
        with pytest.raises(Ended):
            operations.run(larger, path, last)
        operations.run(larger, path)
        assert hashes(path) == whole, f"ended at operation {last} of {count}"
        assert not list(path.glob("parts/**/*.parquet")), f"ended at operation {last} of {count}"
