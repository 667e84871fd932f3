"""Work is cut into tasks that fit: nothing is lost, and none is too long or too short.

The reporter alone adds up how far a run is.
"""

from dataclasses import replace

import numpy as np
import pytest

from pfdist.filters.work import BLOCK, Estimation, FilterWork
from pfdist.pools.base import patience
from pfdist.runner.pace import (
    LEAST_SECONDS,
    LONGEST_SECONDS,
    MOST_ROWS,
    MOST_SECONDS,
    SERVING_SECONDS,
    Pace,
    bundles,
)
from pfdist.runner.progress import Progress, Reporter


def work(sets: int, first: int, last: int, stream: int = 0) -> FilterWork:
    """A work of one instant and one particle: a particle-step for each set and draw."""
    times = ((0,),) * sets
    estimation = Estimation(particles=1)
    return FilterWork(times, (0,) * sets, tuple(range(sets)), stream, (first, last), estimation)


@pytest.mark.parametrize("size", [1, 2, 7, 50, 1000])
def test_every_draw_is_handed_out_once_in_its_order(size: int) -> None:
    works = [work(1, 0, 40, 1), work(3, 5, 30, 2), work(60, 0, 2, 3), work(1, 7, 8, 4)]
    handed = list(bundles(works, lambda remaining: size))
    for bundle in handed:
        assert bundle.steps == sum(piece.steps for piece in bundle.works)
    for whole in works:
        pieces = [piece for bundle in handed for piece in bundle.works]
        pieces = [piece for piece in pieces if piece.draws_stream == whole.draws_stream]
        assert [draw for piece in pieces for draw in range(*piece.draws)] == [*range(*whole.draws)]
        assert {piece.measurement_times for piece in pieces} == {whole.measurement_times}


def test_a_bundle_is_as_large_as_it_may_be() -> None:
    works = [work(3, 0, 100), work(1, 0, 100)]
    sizes = [bundle.steps for bundle in bundles(works, lambda remaining: 10)]
    assert max(sizes) <= 10
    assert min(sizes[:-1]) > 10 - 3  # another draw of three sets did not fit


def test_an_engine_that_filters_many_draws_as_quickly_as_one_gets_so_many(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("pfdist.runner.pace.MOST_ROWS", 600)
    pieces = bundles([work(3, 0, 500), work(400, 0, 5)], lambda remaining: 10, least_draws=200)
    drawn = [each.draws for bundle in pieces for each in bundle.works]
    assert drawn == [(0, 200), (200, 400), (400, 500), *((draw, draw + 1) for draw in range(5))]


def test_what_remains_is_told_and_falls_to_nothing() -> None:
    told: list[int] = []

    def size(remaining: int) -> int:
        told.append(remaining)
        return max(1, remaining // 2)

    assert list(bundles([work(1, 0, 100)], size))
    assert told == [100, 50, 25, 13, 7, 4, 2, 1]


@pytest.mark.parametrize("sets", [1, 7])
def test_however_fast_a_model_is_a_task_holds_so_many_errors_and_no_more(sets: int) -> None:
    works = [work(sets, 0, 123_456, 1), work(sets, 0, 123_456, 2)]
    held = [
        sum(sets * (piece.draws[1] - piece.draws[0]) for piece in bundle.works)
        for bundle in bundles(works, lambda remaining: 10**12)
    ]
    assert sum(held) == 2 * sets * 123_456
    assert MOST_ROWS - sets < min(held[:-1]) <= max(held) <= MOST_ROWS


@pytest.mark.parametrize("together", [1, 7])
def test_blocks_of_sums_are_cut_if_they_take_long_and_an_array_has_one_draw(together: int) -> None:
    """An array of a declared function has always the same size, so it costs that of all draws."""
    blocks = [replace(work(1, first, first + BLOCK), since=(0,)) for first in (0, BLOCK)]
    works = [*(replace(each, together=together) for each in blocks), work(1, 0, 60)]

    def sizes(seconds: float) -> list[int]:
        pieces = bundles(works, lambda remaining: 1, lambda steps: seconds)
        return [last - first for each in pieces for first, last in [each.works[0].draws]]

    quick, slow = sizes(0.9 * LONGEST_SECONDS), sizes(1.1 * LONGEST_SECONDS)
    assert quick == [BLOCK, BLOCK, *[1] * 60]
    assert slow == (quick if together > 1 else [1] * (2 * BLOCK + 60))


@pytest.mark.parametrize("workers", [1, 2, 64])
def test_workers_end_together(workers: int) -> None:
    """The next task goes to whoever is free: simulate it, and count the idle time at the end."""
    pace = Pace(1e-4, workers, learnt=True)
    free_at = np.zeros(workers)
    for bundle in bundles([work(1, 0, 1_000_000)], pace.size):
        seconds = 1e-4 * bundle.steps
        assert LEAST_SECONDS / 2 < seconds <= 1.01 * MOST_SECONDS or free_at.sum() > 99
        free_at[free_at.argmin()] += seconds
    assert np.ptp(free_at) <= 2 * max(LEAST_SECONDS, SERVING_SECONDS * workers)
    assert free_at.sum() == pytest.approx(100)


def test_a_task_is_long_enough_that_the_driver_can_serve_all_workers_meanwhile() -> None:
    workers = 1000
    pace = Pace(1e-4, workers, learnt=True)
    assert MOST_SECONDS < pace.size(10**12) * 1e-4 <= LONGEST_SECONDS
    much = Pace(1e-4, 100 * workers, learnt=True)
    assert much.size(10**12) * 1e-4 == pytest.approx(LONGEST_SECONDS)


def test_more_workers_than_the_driver_can_serve_cost_no_time() -> None:
    """A driver that needs SERVING_SECONDS for a task, and workers that wait for it."""
    taken = {}
    for workers in (10, 100, 1_000, 10_000):
        pace = Pace(1e-4, workers, learnt=True)
        free_at, served = np.zeros(workers), 0.0
        for bundle in bundles([work(1, 0, 25_000)], pace.size):  # 2.5 s of one core
            served += SERVING_SECONDS
            begins = max(served, free_at.min())
            free_at[free_at.argmin()] = begins + 1e-4 * bundle.steps
        taken[workers] = free_at.max()
    assert taken[10] == pytest.approx(0.25, rel=0.2)
    assert taken[100] <= 0.5 * taken[10]
    assert max(taken[1_000], taken[10_000]) <= 1.1 * taken[100]


def test_the_pace_is_learnt() -> None:
    pace = Pace(1.0, 2)
    for _ in range(40):
        pace.update(100, 0.2)
    assert pace.seconds == pytest.approx(0.002)
    assert pace.size(10**9) == pytest.approx(MOST_SECONDS / 0.002)
    assert Pace(5.0, 2).size(100) == 1


def test_nothing_is_risked_on_a_first_guess() -> None:
    """A model a million times slower than the guess: the first tasks have one draw each.

    After the first, no task takes longer than it may, and what a signal can cost is bounded.
    """
    pace, truth = Pace(2e-9, 2), 2e-3
    whole = replace(work(1, 0, 100_000), estimation=Estimation(particles=10))  # .02 s a draw
    seconds = list[float]()
    for bundle in bundles([whole], pace.size):
        (piece,) = bundle.works
        assert seconds or (piece.draws == (0, 1) and patience(pace.expected(bundle.steps)) >= 3600)
        seconds.append(truth * bundle.steps)
        pace.update(bundle.steps, seconds[-1])
    assert max(seconds) <= MOST_SECONDS


# --- progress ---


@pytest.fixture
def reported() -> list[Progress]:
    return []


@pytest.fixture
def reporter(reported: list[Progress]) -> Reporter:
    return Reporter(reported.append, total=100.0)


def test_a_phase_goes_on_from_where_the_last_phase_ended_and_shows_nothing_of_it(
    reporter: Reporter, reported: list[Progress]
) -> None:
    reporter.begin("genetic", generation=1, generations=5)
    reporter.reach(20.0, evaluations=7, best=3.0, mean=4.0)
    reporter.note(done=25.0)
    reporter.begin("comparison")
    assert reported[-1] == Progress("comparison", done=25.0, total=100.0)


def test_what_is_noted_is_shown_with_the_next_report_only(
    reporter: Reporter, reported: list[Progress]
) -> None:
    reporter.begin("random")
    reporter.note(best=2.0)
    assert [state.best for state in reported] == [None]
    reporter.reach(1.0)
    assert [state.best for state in reported] == [None, 2.0]


def test_work_that_was_not_foreseen_adds_to_the_total_and_at_the_end_nothing_remains(
    reporter: Reporter, reported: list[Progress]
) -> None:
    reporter.begin("survivors")
    reporter.foresee(50.0)
    reporter.reach(120.0)
    assert (reported[-1].done, reported[-1].total) == (120.0, 150.0)
    reporter.finish()  # an early end: fewer draws were enough
    assert reported[-1].done == reported[-1].total == 120.0
