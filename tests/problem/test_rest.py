"""The feasible sets of the measurements that are left, against a list of all feasible sets."""

from typing import Any

import pytest

from oracles.every_set import every_set
from pfdist.common.measurement_times import Times
from pfdist.problem.clock import Clock
from pfdist.problem.feasible import Feasible
from pfdist.problem.points import Points

PROBLEMS: list[dict[str, Any]] = [
    {"horizon": 9, "measurement_budget": 4},
    {"horizon": 10, "measurement_budget": 4, "minimum_spacing": 2, "forbidden": (3, 4)},
    {"horizon": 10, "measurement_budget": 4, "forbidden": (0, 7), "required": (5,)},
    {"horizon": 10, "measurement_budget": 3, "minimum_spacing": 3, "required": (2, 8)},
    {"horizon": 8, "price": (1, 2, 3, 1, 2, 3, 1, 2, 3), "total_price": 7},
    {"horizon": 8, "price": (1,) * 4 + (3,) * 5, "total_price": 8, "minimum_spacing": 2},
]


def completions(sets: list[Times], taken: Times, first: int) -> set[Times]:
    """The ends of the sets that have measured exactly these times before `first`."""
    return {
        tuple(time for time in times if time >= first)
        for times in sets
        if tuple(time for time in times if time < first) == taken
    }


@pytest.mark.parametrize("problem", PROBLEMS)
def test_the_rest_completes_what_was_taken(problem: dict[str, Any]) -> None:
    feasible, sets, checked = Feasible(**problem), every_set(**problem), 0
    beginnings = {(times[:k], times[k - 1] + 1) for times in sets for k in (1, 2)}
    for taken, first in sorted(beginnings):
        rest, wanted = feasible.rest(taken, first), completions(sets, taken, first)
        found = {tuple(first + time for time in times) for times in rest.every()} if rest else {()}
        if feasible.counted:
            assert found == wanted
        else:  # a set is complete if nothing after `first` can be added to it
            assert found >= wanted
            assert all(feasible.spent({*taken, *times}) <= feasible.total for times in found)
        checked += len(found)
    assert checked


@pytest.mark.parametrize("first", [2, 4])
def test_the_rest_contains_the_values_in_flight(first: int) -> None:
    """Against all sets with the same measurements before; values of a laboratory arrive later."""
    points = Points(Clock.counting(6), ("meter", "lab"), (0, 2))
    feasible = Feasible(6, 4, forbidden=(1, 3), required=(10,), minimum_spacing=0, points=points)
    sets, parts = [*feasible.every()], dict[tuple[Times, Times], set[Times]]()
    for times in sets:
        taken = tuple(time for time in times if points.instant(time) < first)
        left = tuple(time for time in times if time not in taken)
        in_flight = tuple(time for time in left if points.made_at(time) < first)
        parts.setdefault((taken, in_flight), set()).add(left)
    assert {len(in_flight) for _, in_flight in parts} == {0, 1, 2}
    for (taken, in_flight), wanted in parts.items():
        rest, skipped = feasible.rest(taken, first, in_flight), points.first(first)
        assert rest is not None
        assert {tuple(skipped + time for time in times) for times in rest.every()} == wanted


def test_at_the_start_everything_is_left() -> None:
    feasible = Feasible(9, 3, forbidden=(2,), required=(5,), minimum_spacing=2)
    assert feasible.rest((), 0) == feasible


@pytest.mark.parametrize(
    ("taken", "first", "budget", "allowed"),
    [
        ((1, 2, 3), 4, None, None),  # nothing is left of the budget
        ((1,), 10, None, None),  # nothing is left of the horizon
        ((1,), 9, 1, (0,)),  # two measurements are left, and one fits
        ((4, 5), 6, 1, (1, 2, 3)),  # too near each other, but taken all the same
    ],
)
def test_measurements_that_no_longer_fit_are_given_up(
    taken: Times, first: int, budget: int | None, allowed: Times | None
) -> None:
    rest = Feasible(9, 3, minimum_spacing=2).rest(taken, first)
    assert (rest and rest.measurement_budget, rest and rest.allowed) == (budget, allowed)


def test_a_required_time_that_was_missed_is_left_out() -> None:
    rest = Feasible(9, 3, required=(2, 8)).rest((0,), 4)
    assert rest is not None
    assert (rest.required, rest.total) == ((4,), 2)


def test_without_money_nothing_is_left() -> None:
    feasible = Feasible(3, price=(2, 2, 3, 3), total_price=5)
    assert feasible.rest((0, 2), 3) is None
    rest = feasible.rest((0,), 1)
    assert rest is not None
    assert set(rest.every()) == {(0,), (1,), (2,)}


def test_where_smaller_sets_are_feasible_nothing_more_needs_to_be_measured() -> None:
    feasible = Feasible(3, price=(2, 2, 3, 3), total_price=5, smaller=True)
    assert feasible.rest((), 0) == feasible
    rest = feasible.rest((0,), 1)
    assert rest is not None
    assert set(rest.every()) == {(), (0,), (1,), (2,)}
