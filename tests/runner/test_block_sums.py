"""Errors of instants that searches ask for: means over blocks of draws, and how they are kept."""

from collections.abc import Callable
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pfdist import Job
from pfdist.common.measurement_times import ManySets
from pfdist.filters.criteria.worst_instant import WorstInstant
from pfdist.filters.criterion import MEAN
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.exact import exact_by_instant
from pfdist.filters.variants import results
from pfdist.filters.work import Estimation, FilterWork, Result, sum_of_draws, with_truth
from pfdist.pools.base import SerialPool
from pfdist.runner.block_sums import BLOCK, BlockSums, Counted
from pfdist.runner.build import Built, build
from pfdist.runner.door import RunSession
from pfdist.runner.pace import Pace
from pfdist.runner.phase import Phase, run_phase
from pfdist.runner.ranks import RankWork
from pfdist.search import Candidate
from pfdist.store import Store

Completed = Callable[..., Any]
Means = Callable[[RunSession, int], np.ndarray]
HORIZON, BLOCKS = 12, 3
SETS = ((0, 3, 7), (0, 3, 4, 5), (), (0, 3, 7, 11))
COUNTED = Counted(SETS, np.array([7, 5, 0, 0]), np.array([9, 12, 12, 12]))
IS_FIRST, IS_LAST = COUNTED.set_of == 0, COUNTED.set_of == 3
ESTIMATION = Estimation(40, "systematic", "filter_variance")


@pytest.fixture
def built(small_job: Job) -> Built:
    return build(small_job.with_changes(["evaluation.noise=common"]))


@pytest.fixture
def means(completed: Completed) -> Means:
    """``means(session, blocks)``: the means of a new start of the program."""

    def found(session: RunSession, blocks: int) -> np.ndarray:
        session = RunSession(session.built, session.store)
        sums = BlockSums(session.built, COUNTED, (5, 5), ESTIMATION)
        found: np.ndarray = completed(sums.means(blocks, session))
        session.commit()
        return found

    return found


TWO = {"parameters": [{"process_sd": 1.0}, {"process_sd": 3.0}], "scales": [1.0, 3.0]}


@pytest.mark.parametrize(
    ("sections", "counts"),
    [
        ({"problem": {"instant_weights": [0.0, 3.0] + 11 * [1.0]}}, slice(1, None)),
        ({"problem": {"lag": 2}}, slice(None)),
        ({"scenarios": TWO}, slice(None)),
    ],
)
def test_a_criterion_of_instants_gets_their_errors_in_groups_that_are_not_weighted(
    small_job: Job,
    tmp_path: Path,
    asks: Any,
    completed: Completed,
    sections: dict[str, Any],
    counts: slice,
) -> None:
    built = build(small_job.with_changes(settings=sections))
    asked, settings = asks(*map(Candidate, SETS)), replace(built.searches[0].racing, draws=240)
    phase = Phase("mine", asked, "search", settings, built, WorstInstant())
    completed(run_phase(phase, RunSession(built, Store(tmp_path / "run"))))
    stream = phase.stream()
    work = built.evaluator.work(SETS, stream, stream, (0, 240), settings.estimation, over_time=1)
    expected = built.evaluator.filtered(work).errors.mean(axis=0)[:, counts]
    for evaluation, errors in zip(asked.told, expected, strict=True):
        assert len(evaluation.groups) == 10
        np.testing.assert_allclose(evaluation.groups.mean(axis=0), errors, rtol=1e-12)
        assert evaluation.expected_mse == pytest.approx(errors.max(), rel=1e-12)


def _expected(built: Built, draws: tuple[int, int], stream: int = 5) -> np.ndarray:
    """Mean errors over some draws, filtered at once, where they count."""
    ends = tuple(COUNTED.ends.tolist())
    work = FilterWork(SETS, ends, (stream,) * len(SETS), stream, draws, ESTIMATION)
    means = built.evaluator.sum_errors(work) / (draws[1] - draws[0])
    return COUNTED.of_instants(means)


def _draws(handed: list[FilterWork]) -> list[int]:
    return sorted(draw for work in handed for draw in range(*work.draws))


def assert_alike(found: np.ndarray, errors: np.ndarray, rtol: float = 1e-12) -> None:
    np.testing.assert_allclose(found, errors, rtol=rtol)


def test_means_are_those_of_all_draws_and_blocks_that_are_stored_are_not_filtered_again(
    built: Built, session: RunSession, means: Means, handed: list[FilterWork]
) -> None:
    first = means(session, 2)
    assert _draws(handed) == [*range(2 * BLOCK)]
    assert_alike(means(session, 2), first, rtol=0)
    assert _draws(handed) == [*range(2 * BLOCK)]
    more = means(session, BLOCKS)
    assert _draws(handed) == [*range(3 * BLOCK)]
    assert_alike(more, _expected(built, (0, BLOCKS * BLOCK)))


@pytest.mark.parametrize(
    "changes",
    [
        ["problem.instant_weights=[1, 0.3, 1, 2, 3, 0.7, 5, 6, 7, 8, 9, 0.1, 2]"],
        [
            "filter.engine=numpy",
            "problem.instant_weights=[1, 0.3, 1, 2, 3, 0.7, 5, 6, 7, 8, 9, 0.1, 2]",
        ],
        ["scenarios.parameters={process_sd={uniform=[2, 4]}}", "scenarios.count=3"],
    ],
)
@pytest.mark.parametrize("kind", [FilterWork, RankWork])
def test_a_block_has_the_bits_of_the_sum_of_its_draws(
    small_job: Job, changes: list[str], kind: type[FilterWork]
) -> None:
    """So a table does not show whether a model was slow and its blocks were cut."""
    evaluator = build(small_job.with_changes(changes)).evaluator
    since, ends = tuple(COUNTED.first.tolist()), tuple(COUNTED.ends.tolist())
    given = SETS, 5, 5, (BLOCK, 2 * BLOCK), with_truth(40)
    whole = kind(**vars(evaluator.work(*given, since=since, ends=ends, ids=("id",))))
    singles = [whole.piece((draw, draw + 1)) for draw in range(*whole.draws)]
    sums, *of_draws = (result.sums for result in results(evaluator, [whole, *singles]))
    np.testing.assert_array_equal(sums, sum_of_draws(of_draws))
    assert len(sums) == (4 if kind is RankWork else COUNTED.set_of.size)
    assert np.ptp(of_draws, axis=0).min() > 0


@pytest.mark.parametrize("draws", [1, 10, BLOCK + 5])
def test_a_slow_model_loses_no_draw_that_was_filtered(
    session: RunSession,
    means: Means,
    handed: list[FilterWork],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    draws: int,
) -> None:
    """The process is killed after some draws; the tables are those of a quick model."""
    quick = RunSession(session.built, Store(tmp_path / "quick"))
    expected, do = means(quick, 2), SerialPool.run
    monkeypatch.setattr(Pace, "expected", lambda self, steps: 3600.0)
    monkeypatch.setattr(Pace, "size", lambda self, remaining: 1)
    handed.clear()

    def killed(self: SerialPool, tasks: Any) -> Any:
        yield from islice(do(self, tasks), draws)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(SerialPool, "run", killed)
        patch.setattr("pfdist.runner.door.COMMIT_SECONDS", 0.0)
        with pytest.raises(KeyboardInterrupt):
            means(session, 2)
    assert _draws(handed) == [*range(draws)]
    assert_alike(means(session, 2), expected, rtol=0)
    assert _draws(handed) == [*range(2 * BLOCK)]
    for store in (quick.store, session.store):
        for phase in store.phases_of("error_sums", ""):
            store.settle("error_sums", phase)
    (whole,), (cut,) = (
        [*each.store.path.glob("tables/error_sums/*.parquet")] for each in (quick, session)
    )
    assert whole.name == cut.name  # which contains the hash of the content
    assert session.store.read("error_sums")["block"].tolist() == [0, 1]


def test_whatever_order_blocks_come_in_the_means_have_the_same_bytes(
    session: RunSession, means: Means, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    in_order, do = means(session, 7), SerialPool.run
    monkeypatch.setattr(SerialPool, "run", lambda self, tasks: reversed(list(do(self, tasks))))
    elsewhere = RunSession(session.built, Store(tmp_path / "another run"))
    assert_alike(means(elsewhere, 7), in_order, rtol=0)


def test_a_set_with_an_infinite_draw_has_no_mean_and_others_have(
    built: Built, session: RunSession, means: Means, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = Evaluator.filtered

    def infinite(self: Evaluator, work: FilterWork) -> Result:
        """In the second block with the first set, and in every block with the last."""
        sums = real(self, work).sums.copy()
        sums[IS_LAST] = np.nan
        if work.draws[0] == BLOCK:
            sums[IS_FIRST] = np.nan
        return Result(np.empty(0), sums=sums)

    monkeypatch.setattr(Evaluator, "filtered", infinite)
    found = means(session, BLOCKS)
    monkeypatch.undo()
    blocks = [_expected(built, (block * BLOCK, (block + 1) * BLOCK)) for block in range(BLOCKS)]
    is_infinite = IS_FIRST | IS_LAST
    assert_alike(found[~is_infinite], np.mean(blocks, axis=0)[~is_infinite])
    assert np.isnan(found[is_infinite]).all()


WHOLE = Candidate((0, 4, 8, 12))
WINDOWS = Candidate((), HORIZON, 2 * BLOCK, counted=COUNTED)


def test_a_search_is_told_errors_on_the_draws_of_its_evaluations(
    built: Built, session: RunSession, asks: Any, completed: Completed
) -> None:
    """So the errors of a set add up to its cost, where they count from the first instant on."""
    settings = replace(built.searches[0].settings, draws=2 * BLOCK, estimation=ESTIMATION)
    search = asks(WHOLE, WINDOWS, Candidate(SETS[3]))
    phase = Phase("mine", search, "search", settings, built, MEAN)
    completed(run_phase(phase, session))
    _, windows, whole = search.told
    assert_alike(windows.errors_of_instants, _expected(built, (0, 2 * BLOCK), phase.stream()))
    assert whole.errors is None
    last = windows.errors_of_instants[IS_LAST].sum() / (HORIZON + 1)
    assert last == pytest.approx(whole.expected_mse, rel=1e-9)


def test_an_exact_engine_tells_errors_without_draws(
    small_job: Job, tmp_path: Path, handed: list[FilterWork], asks: Any, completed: Completed
) -> None:
    exact = build(small_job.with_changes(["model.name=random_walk", "filter.engine=kalman"]))
    search = asks(WHOLE, WINDOWS)
    phase = Phase("mine", search, "search", exact.searches[0].settings, exact, MEAN)
    completed(run_phase(phase, RunSession(exact, Store(tmp_path / "run"))))
    assert not handed
    errors = COUNTED.of_instants(exact_by_instant(exact.evaluator, SETS, weighted=True))
    assert_alike(search.told[1].errors_of_instants, errors)


def test_filters_that_a_search_asks_for_twice_are_filtered_once(
    built: Built, session: RunSession, asks: Any, completed: Completed, handed: list[FilterWork]
) -> None:
    """Their sums, whose id is part of a run, are those of the different filters in their order."""
    settings = replace(built.searches[0].settings, draws=2 * BLOCK, estimation=ESTIMATION)
    twice = Counted(
        ManySets.packed((*SETS[2:], *SETS, SETS[2]), HORIZON + 1, 1),
        np.concatenate([COUNTED.first[2:], COUNTED.first, [1]]),
        np.concatenate([COUNTED.ends[2:], COUNTED.ends, [12]]),
    )
    search = asks(Candidate((), HORIZON, 2 * BLOCK, counted=twice), WHOLE)
    phase = Phase("mine", search, "search", settings, built, MEAN)
    completed(run_phase(phase, session))
    (once,) = {work.measurement_times for work in handed if work.summed}
    assert [*once] == [SETS[2], SETS[3], SETS[0], SETS[1], SETS[2]]
    expected = _expected(built, (0, 2 * BLOCK), phase.stream())
    third = COUNTED.set_of >= 2
    errors = [expected[third], expected, expected[COUNTED.set_of == 2][1:]]
    assert_alike(search.told[0].errors_of_instants, np.concatenate(errors))
    session.commit()
    (row,) = session.store.read("evaluations", phase="mine").to_dict("records")
    assert row["individual"] == 7  # the place of the set among all that were asked for
