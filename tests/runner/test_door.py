"""The loop serves every driver to its end, whatever happens to another one."""

import contextlib
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

import pfdist
from oracles.bytes_of import hashes
from pfdist import Job
from pfdist.cli.main import main
from pfdist.errors import StoreError, SweepError
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.work import Estimation, Work
from pfdist.pools.base import Outcome, Task, do
from pfdist.runner import door
from pfdist.runner.door import Batch, Driver, Loop, Session, complete
from pfdist.runner.row_formats import PER_DRAW
from pfdist.store import Store

WORK = Work(((0,),), (12,), (1,), 1, (0, 10), Estimation(particles=10), ids=("a",))
ALIKE = {"comparison.draws": [250, 300]}  # two points with one search


@pytest.fixture
def fails(monkeypatch: pytest.MonkeyPatch) -> Callable[[int], None]:
    """Let the task of this number fail."""
    results, done = Evaluator.results, list[object]()

    def let(number: int) -> None:
        def fail(evaluator: Evaluator, works: Any) -> Any:
            done.append(works)
            if len(done) == number:
                raise MemoryError("one bad task")
            return results(evaluator, works)

        monkeypatch.setattr(Evaluator, "results", fail)

    return let


@pytest.mark.parametrize("number", [1, 3, 7])
def test_points_that_wait_for_a_point_that_fails_compute_what_it_has_not(
    number: int,
    finished: Callable[..., Path],
    fails: Callable[[int], None],
    small_job: Job,
    tmp_path: Path,
) -> None:
    alone = finished("comparison.draws=300")
    fails(number)
    options: Any = {"results": tmp_path / "sweep", "report": False}
    with pytest.raises(SweepError) as caught:
        pfdist.sweep(small_job, ALIKE, changes=["execution.failures=0"], **options)
    (name,) = caught.value.failed
    assert "one bad task" in caught.value.failed[name]
    assert hashes(tmp_path / "sweep" / "comparison.draws=300") == hashes(alone)
    assert len(pfdist.sweep(small_job, ALIKE, **options).runs) == 2


def test_a_point_that_cannot_commit_what_others_need_fails_and_they_compute_it(
    finished: Callable[..., Path],
    small_job: Job,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    alone, commit, lend = finished("comparison.draws=300"), Session.commit, Loop._has_committed
    is_lending, failed = list[bool](), list[str]()

    def lending(loop: Loop, store: Store) -> bool:
        is_lending.append(True)
        try:
            return lend(loop, store)
        finally:
            is_lending.clear()

    def failing(session: Session) -> None:
        if is_lending and not failed:
            failed.append(session.store.path.name)
            raise StoreError("the disk is full")
        commit(session)

    monkeypatch.setattr(Loop, "_has_committed", lending)
    monkeypatch.setattr(Session, "commit", failing)
    options: Any = {"results": tmp_path / "sweep", "report": False}
    with pytest.raises(SweepError) as caught:
        pfdist.sweep(small_job, ALIKE, **options)
    assert failed == [*caught.value.failed] == ["comparison.draws=250"]
    assert "the disk is full" in caught.value.failed[failed[0]]
    assert hashes(tmp_path / "sweep" / "comparison.draws=300") == hashes(alone)
    assert len(pfdist.sweep(small_job, ALIKE, **options).runs) == 2


class InOrder:
    """A pool that ends its tasks in the order of the names of their evaluations."""

    workers = 1

    def __enter__(self) -> "InOrder":
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def run(self, tasks: Iterable[Task | None]) -> Iterator[Outcome]:
        waiting, todo = list[Task](), iter(tasks)
        while True:
            while (task := next(todo, None)) is not None:
                waiting.append(task)
            if not waiting:
                return
            first = min(waiting, key=lambda task: [work.ids for work in task.work])
            waiting.remove(first)
            yield Outcome(first, *do(first.function, first.work))


def test_who_waits_for_a_run_that_cannot_commit_what_a_third_needs_goes_on(
    session: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(door, "COMMIT_SECONDS", 1000.0)
    commit, learnt = Session.commit, list[tuple[str, str]]()

    def failing(session: Session) -> None:
        if session.store.path.name == "lender" and session.rows:
            raise StoreError("the disk is full")
        commit(session)

    def driver(name: str, *ids: str) -> Driver:
        own = Session(session.built, Store(tmp_path / name, "key"))
        for id_ in ids:
            yield Batch(
                own, "phase", [replace(WORK, ids=(id_,))], PER_DRAW,
                lambda work, _: learnt.append((name, *work.ids)), more_follows=True,
            )  # fmt: skip

    def lender() -> Driver:
        with pytest.raises(StoreError, match="the disk is full"):
            yield from driver("lender", "a", "z")

    monkeypatch.setattr(Session, "commit", failing)
    loop = Loop(InOrder(), at_once=3)
    loop.serve([lender(), driver("waits", "b", "z"), driver("third", "c", "a")])
    assert learnt == [
        *(("lender", "a"), ("waits", "b"), ("third", "c")),
        *(("third", "a"), ("waits", "z")),
    ]


def test_a_run_commits_every_second_and_after_minutes_every_five(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    now, commits = 0.0, list[float]()
    monkeypatch.setattr(door, "time", SimpleNamespace(monotonic=lambda: now))
    monkeypatch.setattr(session.store, "commit", lambda *_: commits.append(now))
    session._began = session._last_commit = now
    rows = pa.table({"draw": [0]})
    for tenth in range(30_000):
        now = tenth / 10
        session.keep("phase", "draws", rows)
        session.commit_if_late()
    gaps = np.diff(commits)
    assert gaps[:50] == pytest.approx(1.0)
    assert gaps[-50:] == pytest.approx(5.0)
    assert len(commits) < 1000


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


def test_a_driver_is_closed_before_the_loop_ends_however_it_ends(
    session: Session,
) -> None:
    events = list[str]()

    @contextlib.contextmanager
    def interrupted() -> Iterator[Any]:
        raise KeyboardInterrupt
        yield

    def driver() -> Driver:
        try:
            yield Batch(session, "none", [WORK], None)
        finally:
            events.append("closed")

    with pytest.raises(KeyboardInterrupt):
        complete(driver(), interrupted())
    assert events == ["closed"]
