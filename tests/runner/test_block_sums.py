"""Errors of instants that searches ask for: means over blocks of draws, and how they are kept."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pfdist import Job
from pfdist.evaluation.estimate import Evaluation
from pfdist.evaluation.evaluator import Evaluator
from pfdist.evaluation.work import Estimation, Result, Work
from pfdist.pools.base import Outcome, SerialPool
from pfdist.runner.block_sums import BLOCK, BlockSums, Counted
from pfdist.runner.build import Built, build, make_pool
from pfdist.runner.door import Driver, Session, complete
from pfdist.runner.phase import Phase, run_phase
from pfdist.search import Candidate
from pfdist.store import Store

HORIZON, BLOCKS = 12, 3
SETS = ((0, 3, 7), (0, 3, 4, 5), (), (0, 3, 7, 11))
COUNTED = Counted(SETS, np.array([7, 5, 0, 0]), np.array([9, 12, 12, 12]))
COUNTS = COUNTED.at(HORIZON)
ESTIMATION = Estimation(40, "systematic", "filter_variance")


@pytest.fixture
def built(small_job: Job) -> Built:
    return build(small_job.with_changes(["evaluation.noise=common"]))


@pytest.fixture
def session(built: Built, tmp_path: Path) -> Session:
    return Session(built, Store(tmp_path / "run"))


def completed(driver: Driver, session: Session) -> Any:
    return complete(driver, make_pool(session.built.job.execution))


def means(session: Session, blocks: int) -> np.ndarray:
    """Means of a new start of the program."""
    session = Session(session.built, session.store)
    sums = BlockSums(session.built, COUNTED, (5, 5), ESTIMATION)
    found: np.ndarray = completed(sums.means(blocks, session), session)
    session.commit()
    return found


@pytest.fixture
def handed(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, int]]:
    """The draws of each work that is handed to the pool."""
    draws: list[tuple[int, int]] = []
    do = SerialPool.run

    def noting(self: SerialPool, tasks: Any) -> Iterator[Outcome]:
        for outcome in do(self, tasks):
            draws.extend(work.draws for work in outcome.task.work)
            yield outcome

    monkeypatch.setattr(SerialPool, "run", noting)
    return draws


def _expected(built: Built, draws: tuple[int, int], stream: int = 5) -> np.ndarray:
    """Mean errors over some draws, filtered at once; 0 where they do not count."""
    ends = tuple(COUNTED.ends.tolist())
    work = Work(SETS, ends, (stream,) * len(SETS), stream, draws, ESTIMATION)
    means = built.evaluator.sum_errors(work) / (draws[1] - draws[0])
    return np.where(COUNTS, means, 0.0)


def test_means_are_those_of_all_draws_where_errors_count(built: Built, session: Session) -> None:
    found = means(session, BLOCKS)
    np.testing.assert_allclose(found, _expected(built, (0, BLOCKS * BLOCK)), rtol=1e-12)


def test_blocks_that_are_stored_are_not_filtered_again(
    built: Built, session: Session, handed: list[tuple[int, int]]
) -> None:
    first = means(session, 2)
    assert handed == [(0, BLOCK), (BLOCK, 2 * BLOCK)]
    again = means(session, 2)
    np.testing.assert_array_equal(again, first)
    assert len(handed) == 2
    more = means(session, BLOCKS)
    assert handed[2:] == [(2 * BLOCK, 3 * BLOCK)]
    np.testing.assert_allclose(more, _expected(built, (0, BLOCKS * BLOCK)), rtol=1e-12)


def test_whatever_order_blocks_come_in_the_means_have_the_same_bytes(
    built: Built, session: Session, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    in_order = means(session, 7)
    do = SerialPool.run
    monkeypatch.setattr(SerialPool, "run", lambda self, tasks: reversed(list(do(self, tasks))))
    elsewhere = Session(built, Store(tmp_path / "another run"))
    backward = means(elsewhere, 7)
    np.testing.assert_array_equal(backward, in_order)


def test_a_block_with_a_degenerate_draw_is_left_out_for_that_set_alone(
    built: Built, session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = Evaluator.filtered

    def degenerate(self: Evaluator, work: Work) -> Result:
        """In the second block with the first set, and in every block with the last."""
        sums = np.full(COUNTS.shape, np.nan)
        sums[COUNTS] = real(self, work).sums
        sums[3] = np.nan
        if work.draws[0] == BLOCK:
            sums[0] = np.nan
        return Result(np.empty(0), sums=sums[COUNTS])

    monkeypatch.setattr(Evaluator, "filtered", degenerate)
    found = means(session, BLOCKS)
    monkeypatch.undo()
    blocks = [_expected(built, (block * BLOCK, (block + 1) * BLOCK)) for block in range(BLOCKS)]
    whole = np.mean(blocks, axis=0)
    np.testing.assert_allclose(found[0], np.mean([blocks[0][0], blocks[2][0]], axis=0), rtol=1e-12)
    np.testing.assert_allclose(found[1:3], whole[1:3], rtol=1e-12)
    assert np.isnan(found[3]).all()


# --- in a search ---


class AsksOnce:
    """A search that asks for the errors of some sets since an instant, and for a whole set."""

    generations, evaluations = 1, 1.0
    asked = (
        Candidate((0, 4, 8, 12)),
        *(
            Candidate(times, end, draws=2 * BLOCK, since=since)
            for times, since, end in zip(
                SETS, COUNTED.first.tolist(), COUNTED.ends.tolist(), strict=True
            )
        ),
    )

    def init(self) -> bool:
        return False

    def ask(self, state: bool, rng: np.random.Generator) -> list[Candidate]:
        return list(self.asked)

    def tell(self, state: bool, evaluations: Sequence[Evaluation]) -> bool:
        self.told = list(evaluations)
        return True

    def done(self, state: bool) -> bool:
        return state

    def finalists(self, state: bool) -> tuple[Evaluation, ...]:
        return ()


def test_a_search_is_told_errors_on_the_draws_of_its_evaluations(
    built: Built, session: Session
) -> None:
    """So the errors of a set add up to its cost, where they count from the first instant on."""
    settings = replace(built.searches[0].settings, draws=2 * BLOCK, estimation=ESTIMATION)
    search = AsksOnce()
    search.asked = (*search.asked, Candidate(SETS[3]))
    phase = Phase("mine", search, "search", settings, built)
    completed(run_phase(phase, session), session)
    _, *windows, whole = search.told
    assert [each.measurement_times for each in windows] == list(SETS)
    expected = _expected(built, (0, 2 * BLOCK), phase.stream())
    for window, errors in zip(windows, expected, strict=True):
        np.testing.assert_allclose(window.known_errors, errors, rtol=1e-12)
        assert window.cost == pytest.approx(errors.sum() / (HORIZON + 1), rel=1e-12)
    assert whole.errors is None
    assert windows[3].cost == pytest.approx(whole.cost, rel=1e-9)


def test_an_exact_engine_tells_errors_without_draws(
    small_job: Job, tmp_path: Path, handed: list[tuple[int, int]]
) -> None:
    exact = build(small_job.with_changes(["model.name=random_walk", "filter.engine=kalman"]))
    search = AsksOnce()
    phase = Phase("mine", search, "search", exact.searches[0].settings, exact)
    session = Session(exact, Store(tmp_path / "run"))
    completed(run_phase(phase, session), session)
    assert not handed
    errors = np.where(COUNTS, exact.evaluator.expected_errors(SETS), 0.0)
    found = [evaluation.known_errors for evaluation in search.told[1:]]
    np.testing.assert_allclose(found, errors, rtol=1e-12)
