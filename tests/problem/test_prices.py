"""Prices with decimals: exact sums, the unit of the programme, and the words of errors."""

from decimal import Decimal
from itertools import combinations

import pytest

from pfdist import Job
from pfdist.constraints.step import money
from pfdist.errors import JobError, MeasurementTimesError
from pfdist.problem.constraints import Constraints
from pfdist.problem.feasible import Feasible
from pfdist.results.sets import described

PRICES = (0.1, 0.2, 0.3, 0.7, 0.25, 1.25, 0.1)


def priced(prices: tuple[float, ...], total: float, **others: object) -> Feasible:
    price = tuple(map(money, prices))
    return Feasible(horizon=len(prices) - 1, price=price, total_price=money(total), **others)


def test_a_price_is_the_number_that_is_written() -> None:
    assert money(0.1) == Decimal("0.1")
    assert money(0.1) + money(0.2) == money(0.3)
    assert money(3) == 3


def test_the_unit_is_the_largest_in_which_all_prices_are_whole() -> None:
    feasible = priced(PRICES, 1.7)
    assert feasible.unit == Decimal("0.05")
    assert feasible.units == (2, 4, 6, 14, 5, 25, 2)
    assert feasible.total == 34
    assert priced((0.5, 1.5, 2.0), 2.75).units == (1, 3, 4)  # the rest of the money buys nothing
    assert priced((0.5, 1.5, 2.0), 2.75).total == 5


@pytest.mark.parametrize("total", [0.3, 0.6, 1.0, 1.7])
def test_the_sets_are_those_of_brute_force(total: float) -> None:
    # With prices in cents, which are whole: floats would lose 0.1 + 0.2 <= 0.3.
    feasible, cents = priced(PRICES, total), [round(100 * price) for price in PRICES]
    affordable = {
        times
        for number in range(len(PRICES) + 1)
        for times in combinations(range(len(PRICES)), number)
        if sum(cents[t] for t in times) <= round(100 * total)
    }
    maximal = {
        times for times in affordable if not any({*times} < {*other} for other in affordable)
    }
    assert {tuple(times) for times in feasible.every()} == maximal
    assert all(feasible.allows(times) for times in affordable)


def test_whole_prices_with_points_are_whole_prices() -> None:
    jobs = [
        Job(seed=1, problem={"horizon": 3, "price": price, "total_price": total})
        for price, total in (([1, 2, 1, 1], 3), ([1.0, 2.0, 1.0, 1.0], 3.0))
    ]
    assert jobs[0].identity() == jobs[1].identity()
    assert str(jobs[1].identity()["problem"]["price"]) == "[1, 2, 1, 1]"


def test_sentences_have_the_money_as_it_is_written() -> None:
    feasible = priced((0.5, 1.25, 2.0), 2.5)
    assert feasible.broken((0, 1, 2)) == ["total_price is 2.5, got times with the price 3.75"]
    job = Job(seed=1, problem={"horizon": 2, "price": {"0": 0.5, "1:2": 1.25}, "total_price": 1.75})
    about = described(job.identity(), "regular", [0, 1])
    assert "spends 1.75 of 1.75" in about["description"]


@pytest.mark.parametrize(
    ("prices", "total", "message"),
    [
        ((0.5, 0.0), 1.0, r"^price must be above 0, got 0"),
        ((0.5, 0.75), 0.25, r"the cheapest has the price 0\.5, got 0\.25$"),
        ((0.001, 12.3456), 12.5, r"10,000 times .* whole, 0\.0002, got 12\.5: give rounder"),
        ((1 / 3, 1), 2, r"10,000 times the largest unit"),
    ],
)
def test_wrong_prices_are_refused_in_one_line(
    prices: tuple[float, ...], total: float, message: str
) -> None:
    with pytest.raises(MeasurementTimesError, match=message):
        priced(prices, total)


@pytest.mark.parametrize("value", ["inf", "nan", "true", "'2'"])
def test_a_price_must_be_a_finite_number(value: str) -> None:
    price = {"inf": float("inf"), "nan": float("nan"), "true": True, "'2'": "2"}[value]
    with pytest.raises(JobError, match=r"problem\.price must be a (finite )?number, got"):
        Job(seed=1, problem={"horizon": 1, "price": [1, price], "total_price": 2})
    with pytest.raises(JobError, match=r"total_price"):
        Job(seed=1, problem={"horizon": 1, "price": [1, 1], "total_price": price})


def test_constraints_without_money_count_measurements() -> None:
    assert (Constraints(4, 2).unit, Constraints(4, 2).units, Constraints(4, 2).total) == (
        1,
        (1,) * 5,
        2,
    )
