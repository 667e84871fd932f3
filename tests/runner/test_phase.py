"""Evaluations: what is checked, how often, and under which id their results come back."""

import random
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pfdist
from oracles.bytes_of import hashes
from pfdist import Job
from pfdist.errors import MeasurementTimesError
from pfdist.filters.criterion import MEAN
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.work import FilterWork
from pfdist.pools.base import Outcome, SerialPool
from pfdist.runner.build import Built
from pfdist.runner.comparison_phase import run_comparison
from pfdist.runner.door import RunSession
from pfdist.runner.pace import Pace
from pfdist.runner.phase import Phase, run_phase
from pfdist.runner.progress import Progress
from pfdist.search import Candidate, Exchange, Optimiser, RandomTrials
from pfdist.store import Store

Completed = Callable[..., Any]


def _phase(built: Built, optimiser: Optimiser) -> Phase:
    return Phase("mine", optimiser, "search", built.searches[0].settings, built, MEAN)


@pytest.mark.parametrize("phase", ["search", "comparison"])
def test_other_times_than_there_are_end_in_an_error_before_anything_is_computed(
    phase: str,
    built: Built,
    session: RunSession,
    asks: Any,
    completed: Completed,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(SerialPool, "run", lambda self, tasks: pytest.fail("a task was handed out"))
    if phase == "search":
        driver = run_phase(_phase(built, asks(Candidate((0, 13)))), session)
    else:
        driver = run_comparison(session, {"regular": (0, 4, 8, 12), "mine": (0, 13)})
    with pytest.raises(MeasurementTimesError, match=r"in 0..12, got 13 \((search )?mine\)$"):
        completed(driver)


def test_a_problem_checks_a_work_that_comes_from_outside(built: Built) -> None:
    evaluator: Evaluator = built.evaluator
    work = FilterWork(((0, 13),), (12,), (1,), 1, (0, 2), built.comparing)
    with pytest.raises(MeasurementTimesError, match=r"must lie in 0\.\.12, got 13"):
        evaluator(work)


def test_results_come_back_under_the_ids_of_their_evaluations(built: Built) -> None:
    times = ((0, 4, 8, 12), (1, 2, 3), (0, 4, 9, 12))
    work = FilterWork(times, (12,) * 3, (7,) * 3, 7, (0, 5), built.comparing, ids=("a", "b", "c"))
    together = work.by_id(built.evaluator.filtered(work))
    for id_, one_set in zip(work.ids, times, strict=True):
        alone = replace(
            work, measurement_times=(one_set,), ends=(12,), filter_streams=(7,), ids=(id_,)
        )
        assert (together[id_] == alone.by_id(built.evaluator.filtered(alone))[id_]).all()
    with pytest.raises(ValueError, match="zip"):
        replace(work, ids=("a",)).by_id(built.evaluator.filtered(work))


def test_whatever_order_outcomes_come_in_each_evaluation_has_its_own_results(
    small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = small_job.with_changes(["evaluation.noise=common", "comparison.draws=40"])
    in_order = pfdist.run(job, tmp_path / "in order", figures=False)
    chance, do = random.Random(1), SerialPool.run

    def in_disorder(self: SerialPool, tasks: Any) -> Iterator[Outcome]:
        tasks = iter(tasks)
        while some := list(islice(do(self, tasks), 8)):
            chance.shuffle(some)
            yield from some

    monkeypatch.setattr(SerialPool, "run", in_disorder)
    monkeypatch.setattr(Pace, "size", lambda pace, remaining: chance.randrange(1, 3000))
    assert hashes(pfdist.run(job, tmp_path / "run", figures=False).path) == hashes(in_order.path)


def test_a_set_that_is_asked_for_twice_is_computed_once(
    built: Built, session: RunSession, handed: list[FilterWork], completed: Completed
) -> None:
    phase = _phase(built, RandomTrials(built.job.problem.feasible, 10))
    completed(run_phase(phase, session))
    parts = [(id_, work.draws) for work in handed for id_ in work.ids]
    assert len(parts) == len(set(parts))
    assert len({id_ for id_, _ in parts}) == 10
    session.commit()
    works = len(handed)
    completed(run_phase(phase, RunSession(built, session.store)))  # all are in the store
    assert len(handed) == works


def test_the_bar_goes_on_while_a_search_takes_more_generations_than_expected(
    built: Built, tmp_path: Path, completed: Completed, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The forecast grows with each of them, and the whole of it is done when the run is."""
    monkeypatch.setattr(Exchange, "generations", 2)
    shown = list[Progress]()
    session = RunSession(built, Store(tmp_path / "run"), shown.append)
    phase = _phase(built, Exchange(built.job.problem.feasible, 256, (0, 1, 2, 3)))
    session.reporter.foresee(3 * phase.steps(usual=True))
    completed(run_phase(phase, session))
    assert shown[-1].generation > 4
    shares = {each.generation: each.done / each.total for each in shown}
    assert [*shares.values()] == sorted({*shares.values()})
    left = 2 * phase.steps(usual=True) / shown[-1].total  # of the other phases
    assert shares[shown[-1].generation] == pytest.approx(1 - left)


def test_a_prefix_up_to_the_end_and_the_whole_set_have_one_result(
    built: Built, session: RunSession, asks: Any, completed: Completed
) -> None:
    search = asks(Candidate((0, 12), 12), Candidate((0, 12)), Candidate((0, 12), 12, 10))
    for _ in range(2):  # the second time from the store
        completed(run_phase(_phase(built, search), session))
        session.commit()
        assert [told.end for told in search.told] == [12, None, 12]
        prefix, whole, short = search.told
        np.testing.assert_array_equal(prefix.mse, whole.mse)
        np.testing.assert_array_equal(short.mse, whole.mse[:10])


def test_a_search_may_end_where_the_last_instant_is_required(
    small_job: Job, tmp_path: Path
) -> None:
    """Then the search meets the same set as a prefix and as a whole set."""
    changes = ["problem.required=[0, 12]", "search.survivors.evaluation.draws=40"]
    run = pfdist.plan(
        small_job, tmp_path / "run", "survivors", changes=changes, bound_draws=0, figures=False
    )
    assert {0, 12} < set(run.sets["survivors"])
