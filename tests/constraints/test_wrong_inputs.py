"""Wrong limits get a line that says what, got and allowed; amounts of a store are exact."""

from typing import Any

import pytest

from oracles.kalman import SCALAR
from oracles.watched import WALK
from pfdist import Problem
from pfdist.constraints.kinds import PlainStep
from pfdist.errors import JobError
from pfdist.problem.feasible import Feasible

TEN = {"horizon": 9, "measurement_budget": 3}


def feasible_of(**keys: Any) -> Feasible:
    return Problem(SCALAR.as_model(), **{**TEN, **keys}).job().problem.feasible


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"store": {"capacity": 3}, "forbidden": [*range(10)]}, "forbidden must leave a time"),
        ({"store": {"capacity": 3, "start": 0}}, "store holds too little at 0: no measurement"),
        ({"store": {"capacity": 3, "income": [-1] * 10}}, "store.income must be at least 0"),
        ({"store": {"capacity": 3}, "price": -1}, "price must be at least 0 with a store, got -1"),
        ({"store": {"capacity": 1e300}}, "store.capacity must be at most"),
        ({"store": {"capacity": 1, "start": 2}}, "store.start must be at most its capacity, 1"),
        ({"most_within": {"number": 1}}, "most_within needs time or per, got neither"),
        (
            {"most_within": {"number": 1, "time": 2, "per": "day"}},
            "most_within needs time or per, got both",
        ),
    ],
)
def test_a_wrong_limit_gets_a_line(keys: dict[str, Any], message: str) -> None:
    with pytest.raises(JobError, match=f"^{message}"):
        feasible_of(**keys)


def test_a_wrong_limit_of_a_sensor_names_the_sensor() -> None:
    sharp = {"most_within": {"number": 1}}
    with pytest.raises(JobError, match=r"^sensors\.sharp\.most_within needs time or per"):
        Problem(WALK, sensors={"cheap": {}, "sharp": sharp}, **TEN)


@pytest.mark.parametrize("capacity", [1, 100, 10**9])
def test_amounts_with_many_digits_have_compiled_steps(capacity: int) -> None:
    """Computed incomes have 17 digits; the store holds what their sum says."""
    income = [0.35000000000000003] * 10
    feasible = feasible_of(store={"capacity": capacity, "start": 0, "income": income})
    assert [bool(feasible.left().may(t)[0]) for t in range(10)] == [t >= 2 for t in range(10)]
    assert [feasible.is_within_limits((t,)) for t in range(10)] == [t >= 2 for t in range(10)]


def test_tenths_are_exact_in_any_store() -> None:
    """Ten prices of 0.1 empty a store of 1, whatever the income of other instants is."""
    store = {"capacity": 1, "income": [0.0] * 10 + [1 / 3]}
    keys = {"horizon": 10, "measurement_budget": 10, "price": 0.1, "store": store}
    assert feasible_of(**keys).accepts((*range(10),))


def test_what_is_above_the_capacity_is_lost() -> None:
    """An income of any size fills the store, and no income pays for more than it holds."""
    feasible = feasible_of(store={"capacity": 2, "start": 0, "income": [1e30] + [0.0] * 9})
    assert feasible.accepts((0, 9))
    assert not feasible.accepts((0, 5, 9))
    prices = [1, 3, 1e30, *[1] * 7]
    feasible = feasible_of(price=prices, store={"capacity": 2, "income": 2})
    assert {t for t in range(10) if not feasible.accepts((t,))} == {1, 2}


def test_no_measurement_before_the_first_instant_is_looked_up() -> None:
    """With a delay some points have no instant, where the tables of steps have no number."""
    problem = Problem(
        WALK, sensors={"cheap": {"delay": 3, "minimum_spacing": 2}, "sharp": {}}, **TEN
    )
    feasible = problem.job().problem.feasible
    (broken,) = feasible.beyond_limits([()])
    assert not broken


@pytest.mark.parametrize("most", [0, -1])
def test_numbers_of_a_file_that_are_no_limit_do_not_run(most: int) -> None:
    table, start = (most, 2, 1, 2, 1, 2), (0,) * (1 + most)
    assert not PlainStep("most_within", table, start).is_of(1, 2)
    assert PlainStep("most_within", (1, *table[1:]), (0, 0)).is_of(1, 2)
