"""Fixtures of the runner's tests: a session, a search that asks as it is told, runs cut short."""

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pfdist
from pfdist import Job
from pfdist.errors import TaskError
from pfdist.filters.estimate import Evaluation
from pfdist.filters.work import FilterWork
from pfdist.pools.base import Outcome, SerialPool
from pfdist.problem.sections import Execution
from pfdist.runner.build import Built, build, make_pool
from pfdist.runner.door import Driver, RunSession, WorkBatch, complete
from pfdist.runner.progress import Progress
from pfdist.search import Candidate
from pfdist.store import Store


@pytest.fixture
def built(small_job: Job) -> Built:
    return build(small_job)


@pytest.fixture
def session(built: Built, tmp_path: Path) -> RunSession:
    return RunSession(built, Store(tmp_path / "run"))


@pytest.fixture(scope="session")
def completed() -> Callable[[Driver], Any]:
    """The value of a driver, computed in this process."""
    return lambda driver: complete(driver, make_pool(Execution(pool="serial")))


class Asks:
    """A search that asks once for some candidates, and remembers what it is told."""

    generations, evaluations = 1, 1.0

    def __init__(self, *candidates: Candidate) -> None:
        self.candidates, self.told = list(candidates), list[Evaluation]()

    def init(self) -> bool:
        return False

    def ask(self, state: bool, rng: np.random.Generator) -> list[Candidate]:
        return self.candidates

    def tell(self, state: bool, evaluations: Sequence[Evaluation]) -> bool:
        self.told = list(evaluations)
        return True

    def done(self, state: bool) -> bool:
        return state

    def finalists(self, state: bool) -> tuple[Evaluation, ...]:
        return ()


@pytest.fixture(scope="session")
def asks() -> type[Asks]:
    return Asks


@pytest.fixture
def handed(monkeypatch: pytest.MonkeyPatch) -> list[FilterWork]:
    """The works that the serial pool has computed, from now on."""
    works, do = list[FilterWork](), SerialPool.run

    def noting(self: SerialPool, tasks: Any) -> Iterator[Outcome]:
        for outcome in do(self, tasks):
            works.extend(outcome.task.work)
            yield outcome

    monkeypatch.setattr(SerialPool, "run", noting)
    return works


@pytest.fixture(scope="session")
def stopped() -> Callable[..., None]:
    """``stopped(job, path, phase, evaluations)``: a run is stopped when a phase has come so far."""

    def stop(job: Job, path: Path, phase: str, evaluations: int = 1, **options: Any) -> None:
        def show(progress: Progress) -> None:
            if progress.phase == phase and progress.evaluations >= evaluations:
                raise KeyboardInterrupt

        with pytest.raises(KeyboardInterrupt):
            pfdist.run(job, path, progress=show, figures=False, **options)

    return stop


@pytest.fixture
def cut_short(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """``cut_short(phase, job, path, ...)``: a plan fails when a phase has got its first result."""
    take = WorkBatch._take

    def plan(phase: str, *arguments: Any, **options: Any) -> None:
        def fail(self: WorkBatch, outcome: Any) -> bool:
            is_done = take(self, outcome)
            if self.phase == phase:
                raise TaskError("the lights went out", "")
            return is_done

        with monkeypatch.context() as patch:
            patch.setattr(WorkBatch, "_take", fail)
            with pytest.raises(TaskError, match="the lights went out"):
                pfdist.plan(*arguments, **options)

    return plan
