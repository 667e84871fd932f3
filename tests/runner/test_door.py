"""The loop serves every driver to its end, whatever happens to another one."""

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

import pfdist
from oracles.bytes_of import hashes
from pfdist import Job
from pfdist.cli.main import main
from pfdist.errors import SweepError
from pfdist.filters import variants
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.work import Estimation, FilterWork
from pfdist.runner import door
from pfdist.runner.door import Driver, RunSession, WorkBatch, complete

WORK = FilterWork(((0,),), (12,), (1,), 1, (0, 10), Estimation(particles=10), ids=("a",))
ALIKE = {"comparison.draws": [250, 300]}  # two points with one search


@pytest.fixture
def fails(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    """Let the task of this number fail."""
    results, done = variants.results, list[object]()

    def let(number: int) -> None:
        def fail(evaluator: Evaluator, works: Any) -> Any:
            done.append(works)
            if len(done) == number:
                raise MemoryError("one bad task")
            return results(evaluator, works)

        monkeypatch.setattr(variants, "results", fail)

    return let


@pytest.mark.plugins("sweep")
def test_points_beside_a_point_that_fails_compute_what_it_has_not(
    finished: Callable[..., Path], fails: Callable[[int], None], small_job: Job, tmp_path: Path
) -> None:
    alone = finished("comparison.draws=300")
    fails(7)
    options: Any = {"results": tmp_path / "sweep", "figures": False}
    with pytest.raises(SweepError) as caught:
        pfdist.sweep(small_job, ALIKE, changes=["execution.failures=0"], **options)
    (name,) = caught.value.failed
    assert "one bad task" in caught.value.failed[name]
    assert hashes(tmp_path / "sweep" / "comparison.draws=300") == hashes(alone)
    assert len(pfdist.sweep(small_job, ALIKE, **options).runs) == 2


@pytest.mark.parametrize("busy", [1.0, 4.0])
def test_a_run_commits_after_counted_work_and_later_after_five_times_as_much(
    busy: float, session: RunSession, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A busy machine, whose tasks take four times as long, makes no more commits."""
    tasks, commits = 0, list[int]()
    monkeypatch.setattr(session.store, "commit", lambda *_: commits.append(tasks))
    monkeypatch.setattr(door, "COMMIT_SECONDS", 1.0)
    session.pace(2)
    a_second = session._pace.in_seconds(door.COMMIT_SECONDS)
    rows = pa.table({"draw": [0]})
    while tasks < 30_000:
        tasks += 1
        session.keep_rows("phase", "draws", rows)
        session.update_pace(round(a_second / 10), busy * 0.1)
        session.commit_if_late()
    gaps = np.diff(commits)
    assert gaps[:50] == pytest.approx(10)
    assert gaps[-50:] == pytest.approx(50)
    assert len(commits) < 1000


def test_a_model_that_is_many_times_as_slow_commits_after_less_work(session: RunSession) -> None:
    usual = session.pace(2).in_seconds(1.0)
    session.update_pace(1000, 2.0)  # 2 ms a particle-step
    assert session.pace(2).in_seconds(1.0) < 1e-4 * usual


@pytest.mark.plugins("sweep")
def test_a_sweep_without_workers_ends_with_one_line(
    small_job: Job,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("ray.is_initialized", lambda: False)  # other tests share a cluster,
    monkeypatch.setattr("ray.shutdown", lambda: None)  # which must stay
    words = ["sweep", str(small_job.path), "--over", "seed=1:2", "--results", str(tmp_path / "s")]
    assert main([*words, "--pool", "ray", "--address", "127.0.0.1:1"]) == 1
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.startswith("pfdist: ")
    assert "127.0.0.1:1" in last


def test_a_driver_is_closed_before_the_loop_ends_however_it_ends(session: RunSession) -> None:
    events = list[str]()

    @contextlib.contextmanager
    def interrupted() -> Iterator[Any]:
        raise KeyboardInterrupt
        yield

    def driver() -> Driver:
        try:
            yield WorkBatch(session, "none", [WORK], None)
        finally:
            events.append("closed")

    with pytest.raises(KeyboardInterrupt):
        complete(driver(), interrupted())
    assert events == ["closed"]
