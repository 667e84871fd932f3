"""Fixtures of the runner's tests: a session, a search that asks as it is told, runs cut short."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pfdist
from pfdist import Job
from pfdist.errors import TaskError
from pfdist.filters.estimate import Evaluation
from pfdist.problem.sections import Execution
from pfdist.runner.build import Built, build, make_pool
from pfdist.runner.door import Driver, RunSession, WorkBatch, complete
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
