"""Evenly spaced sets: those of the definition in docs/words.md, by a lattice of real targets."""

from itertools import pairwise

import pytest

from oracles.even import even_instants, spaced_around
from pfdist.problem.clock import Clock
from pfdist.problem.even_sets import EvenSets
from pfdist.problem.feasible import Feasible
from pfdist.problem.points import Points

EVERY = 1_000_000


def _found(feasible: Feasible, most: int = EVERY) -> set[tuple[int, ...]]:
    even = EvenSets(feasible)
    return {*even.sets_of(even.lines(most))}


@pytest.mark.parametrize(("horizon", "number"), [(11, 4), (14, 5), (9, 10), (12, 2), (20, 3)])
def test_they_are_all_roundings_of_real_first_targets_and_steps(horizon: int, number: int) -> None:
    found = _found(Feasible(horizon=horizon, measurement_budget=number))
    assert found >= {*even_instants(range(horizon + 1), number)}
    for times in found:
        steps = [later - earlier for earlier, later in pairwise(times)]
        assert len(times) == number
        assert max(steps) - min(steps) <= 1  # a digital line; Freeman, 1974: necessary


def test_the_papers_problem_has_as_many_as_two_programs_found() -> None:
    """REFERENCE: 39,627 sets, where there are 861 pairs of a first and a last instant."""
    assert len(_found(Feasible(horizon=60, measurement_budget=21))) == 39_627


def test_every_single_time_and_every_pair_is_evenly_spaced() -> None:
    assert len(_found(Feasible(horizon=12, measurement_budget=1))) == 13
    assert len(_found(Feasible(horizon=12, measurement_budget=2))) == 13 * 12 / 2


def test_on_an_uneven_clock_targets_are_even_in_time() -> None:
    times = (0.0, 1.0, 2.0, 3.0, 4.0, 8.0, 12.0, 16.0)
    found = _found(Feasible(horizon=7, measurement_budget=3, points=Points(Clock(times))))
    assert (0, 5, 7) in found  # 0, 8 and 16
    assert found >= {*even_instants(times, 3)}


def test_targets_in_gaps_are_left_out_or_gaps_are_cut_out() -> None:
    feasible = Feasible(horizon=15, measurement_budget=4, forbidden=(4, 5, 6, 7), required=(9,))
    found = _found(feasible)
    assert found >= {*spaced_around(range(16), 4, {*feasible.allowed}, (9,))}
    assert (0, 2, 9, 10) in found  # 0, 2, ..., 10: two targets lie in the gap
    assert all(feasible.accepts(times) for times in found)


def test_one_sensor_measures_or_all_do_in_turn_and_a_sensor_may_repeat() -> None:
    points = Points(Clock.counting(8), ("a_a", "a_b", "b"), repeats=(0, 0, 2))
    feasible = Feasible(horizon=8, measurement_budget=4, minimum_spacing=0, points=points)
    found, lines = _found(feasible), even_instants(range(9), 4)
    ways = {tuple(points.way(t) for t in times) for times in found}
    assert ways == {(0,) * 4, (2,) * 4, (0, 2) * 2, (2, 0) * 2, (0, 1) * 2}
    twice = {
        tuple(3 * t + way for t in each for way in (0, 1)) for each in even_instants(range(9), 2)
    }
    assert found >= twice | {tuple(3 * t for t in each) for each in lines}


def test_with_prices_every_number_that_can_be_paid_counts() -> None:
    price = (2,) * 5 + (1,) * 6
    feasible = Feasible(horizon=10, price=price, total_price=6)
    own = {
        times
        for number in range(1, 7)
        for times in even_instants(range(11), number)
        if sum(price[t] for t in times) <= 6
    }
    assert _found(feasible) >= own


def test_few_lines_lie_near_all_sets() -> None:
    """Lines near the nearest of few lines are nearer: an optimiser goes from coarse to fine."""
    even = EvenSets(Feasible(horizon=200, measurement_budget=40))
    lines, goal = even.lines(400), (7.3, 7.3 + 39 * 4.11)
    assert 300 <= len(even.sets_of(lines)) <= 500

    def distance(line) -> float:
        return abs(line.first - goal[0]) + abs(line.first + 39 * line.step - goal[1])

    for _ in range(3):
        nearest = min(lines, key=distance)
        assert distance(nearest) <= nearest.distance
        lines = even.near(nearest)
