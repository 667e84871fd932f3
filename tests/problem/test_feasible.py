"""The feasible sets against a list of all, tried one by one."""

from collections import Counter
from dataclasses import fields, replace
from itertools import combinations
from math import comb
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st
from scipy import stats

from oracles.every_set import every_set
from oracles.in_turn import in_turn
from pfdist.common.measurement_times import Times, regular
from pfdist.errors import MeasurementTimesError
from pfdist.problem.constraints import Constraints
from pfdist.problem.feasible import Feasible
from pfdist.problem.problem_section import ProblemSection
from pfdist.search.exchange import shifts

NAMES = "|".join(field.name for field in fields(Constraints))
quick = settings(
    max_examples=20, suppress_health_check=[HealthCheck.filter_too_much, HealthCheck.too_slow]
)
LARGE = [
    {"horizon": 11, "measurement_budget": 4, "minimum_spacing": 2, "forbidden": (3, 4)},
    {"horizon": 11, "measurement_budget": 4, "forbidden": (0, 7), "required": (5,)},
    {"horizon": 9, "price": (1, 2, 3, 1, 2, 3, 1, 2, 3, 1), "total_price": 7},
    {"horizon": 9, "price": (2, 2, 2, 4, 4, 4, 6, 6, 2, 2), "total_price": 15, "required": (7,)},
    {"horizon": 10, "price": (1,) * 5 + (3,) * 6, "total_price": 8, "minimum_spacing": 2},
    {"horizon": 7, "price": (1, 2, 3, 1) * 2, "total_price": 7, "smaller": True},
    {"horizon": 8, "price": (1, 2, 3) * 3, "total_price": 6, "smaller": True, "required": (4,)},
]


@st.composite
def constraints(draw: st.DrawFn) -> dict[str, Any]:
    """Constraints on few times, of each kind and together, possible or not."""
    horizon = draw(st.integers(1, 7))
    times = st.sets(st.integers(0, horizon), max_size=2).map(lambda some: tuple(sorted(some)))
    given_ = {
        "horizon": horizon,
        "forbidden": draw(times),
        "required": draw(times),
        "minimum_spacing": draw(st.integers(1, 3)),
    }
    if draw(st.booleans()):
        return {**given_, "measurement_budget": draw(st.integers(1, horizon + 1))}
    unit = draw(st.sampled_from([1, 1, 3]))
    prices = st.integers(1, 4).map(lambda price: unit * price)
    price = draw(st.lists(prices, min_size=horizon + 1, max_size=horizon + 1))
    total = draw(st.integers(1, 4 * unit * horizon))
    return {**given_, "price": tuple(price), "total_price": total, "smaller": draw(st.booleans())}


@st.composite
def possible(draw: st.DrawFn) -> tuple[Feasible, list[Times]]:
    """Feasible, and all its sets."""
    given_ = draw(constraints())
    every = every_set(**given_)
    assume(every)
    return Feasible(**given_), every


def subsets(horizon: int) -> list[Times]:
    instants = range(horizon + 1)
    return [times for size in range(horizon + 2) for times in combinations(instants, size)]


def nested(inner: Times, outer: Times) -> bool:
    return set(inner) <= set(outer)


@quick
@given(constraints())
def test_constraints_that_no_set_satisfies_are_an_error_and_no_others(given_: Any) -> None:
    if every_set(**given_):
        Feasible(**given_)
    else:
        with pytest.raises(MeasurementTimesError, match=rf"^({NAMES}) .*must"):
            Feasible(**given_)


@quick
@given(possible())
def test_it_gives_every_set_once_in_order_and_accepts_these_alone(case: Any) -> None:
    feasible, every = case
    assert list(feasible.every()) == every
    assert feasible.size == len(every)
    accepted = [times for times in subsets(feasible.horizon) if feasible.accepts(times)]
    assert sorted(accepted) == every


@quick
@given(possible())
def test_sets_that_may_be_chosen_break_none_and_those_that_break_none_may_be(case: Any) -> None:
    feasible, every = case
    whole = [times for times in subsets(feasible.horizon) if not feasible.broken(times)]
    assert set(every) <= set(whole)
    if feasible.counted or feasible.smaller:
        assert sorted(whole) == every
    else:  # what is left over may pay for more, which no choice leaves out
        assert all(any(set(times) <= set(other) for other in every) for times in whole)


@quick
@given(possible())
def test_additions_and_removals_lead_towards_some_set(case: Any) -> None:
    feasible, every = case
    for times in subsets(feasible.horizon):
        others = [t for t in range(feasible.horizon + 1) if t not in times]
        larger = [tuple(sorted({*times, t})) for t in others]
        smaller = [tuple(t for t in times if t != out) for out in times]
        assert feasible.additions(times) == [
            grown for grown in larger if any(nested(grown, whole) for whole in every)
        ]
        assert feasible.removals(times) == [
            shrunk for shrunk in smaller if any(nested(whole, shrunk) for whole in every)
        ]


@quick
@given(possible())
def test_extensions_are_the_times_that_follow_in_some_set(case: Any) -> None:
    feasible, every = case
    following: dict[Times, set[int]] = {}
    for whole in every:
        for number in range(len(whole) + 1):
            following.setdefault(whole[:number], set()).update(whole[number : number + 1])
    for prefix, times in following.items():
        assert list(feasible.extensions(prefix)) == sorted(times)


@quick
@given(possible(), st.integers(1, 7))
def test_exchanges_hold_every_set_in_which_one_time_is_another_that_is_near(
    case: Any, reach: int
) -> None:
    feasible, every = case
    for times in every:
        near = {
            other
            for other in every
            for out, new in [(set(times) - set(other), set(other) - set(times))]
            if len(out) == len(new) == 1 and abs(min(out) - min(new)) <= reach
        }
        found = feasible.exchanges(times, reach)
        assert len(found) == len(set(found))
        assert near <= set(found) <= set(every) - {times}
        if feasible.counted:
            assert set(found) == near
        if feasible.smaller:
            one_more_or_less = {other for other in every if len(set(times) ^ set(other)) == 1}
            assert one_more_or_less <= set(found)
        assert set(found) <= set(feasible.exchanges(times))


@quick
@given(possible())
def test_shifts_are_the_sets_in_which_a_run_of_times_lies_one_allowed_time_off(case: Any) -> None:
    feasible, every = case

    def is_shifted(times: Times, other: Times) -> bool:
        """Whether the indices of both differ by the same step, 1 or -1, in one run alone."""
        pairs = zip(times, other, strict=True)
        steps = [feasible.index[new] - feasible.index[old] for old, new in pairs]
        moved = [place for place, step in enumerate(steps) if step]
        in_a_row = bool(moved) and moved == list(range(moved[0], moved[-1] + 1))
        return in_a_row and {steps[place] for place in moved} in ({1}, {-1})

    for times in every:
        found = shifts(feasible, times)
        assert len(found) == len({*found})
        alike = (other for other in every if len(other) == len(times))
        assert {*found} == {other for other in alike if is_shifted(times, other)}


@pytest.mark.parametrize("number", [41, 48, 100])
def test_a_set_has_so_many_shifts_as_its_number_of_times_and_no_square(number: int) -> None:
    feasible = Feasible(3 * number, number)
    times = tuple(range(1, 3 * number, 3))
    found = shifts(feasible, times)
    every = number * (number + 1)  # runs of any length, to the left and to the right
    assert len(found) == every - max(0, number - 48) * (number - 47)
    assert len(found) <= 2 * 48 * number


@quick
@given(possible())
def test_what_can_be_paid_for_is_completed_to_a_feasible_set(case: Any) -> None:
    feasible, every = case
    assume(not feasible.counted)
    for times in filter(feasible.allows, subsets(feasible.horizon)):
        completed = feasible.completed(times)
        assert completed in every
        assert {*times} <= {*completed}
        if feasible.smaller:
            assert {*completed} == {*times, *feasible.required}


@quick
@given(possible())
def test_regular_times_are_the_nearest_set_to_the_papers(case: Any) -> None:
    feasible, every = case
    times = feasible.regular()
    assert times in every
    assert len(times) == feasible.measurements
    if feasible.counted and feasible.total > 1:
        papers = regular(feasible.horizon, feasible.total)

        def distance(chosen: Times) -> int:
            return sum(abs(a - b) for a, b in zip(chosen, papers, strict=True))

        least = min(map(distance, every))
        nearest = [chosen for chosen in every if distance(chosen) == least]
        assert all(feasible.is_regular(chosen) == (chosen == papers) for chosen in every)
        assert times == min(nearest, key=lambda chosen: chosen[::-1])


@quick
@given(possible())
def test_where_times_cost_money_regular_ones_spend_the_most_on_the_most_measurements(
    case: Any,
) -> None:
    feasible, every = case
    assume(not feasible.counted)

    def rank(times: Times) -> tuple[int, int, int, Times]:
        wanted = ((feasible.horizon + 1) // 2,)
        if len(times) > 1:
            wanted = regular(feasible.horizon, len(times))
        distance = sum(abs(a - b) for a, b in zip(times, wanted, strict=True))
        return -sum(feasible.price[t] for t in times), -len(times), distance, times[::-1]

    assert feasible.regular() == min(filter(None, every), key=rank)


@in_turn("price", [1, 3])
@in_turn(
    ("number", "given_"),
    [(number, {}) for number in (1, 2, 5, 13, 21, 61)]
    + [(10, {"forbidden": tuple(range(20, 31))}), (10, {"required": (7, 40)})]
    + [(10, {"minimum_spacing": 5})],
)
def test_where_all_times_cost_the_same_regular_ones_are_those_of_as_many(
    number: int, given_: dict[str, Any], price: int
) -> None:
    left_over = price - 1
    paid = Feasible(60, price=(price,) * 61, total_price=number * price + left_over, **given_)
    assert paid.regular() == Feasible(60, number, **given_).regular()


@quick
@given(possible(), st.data())
def test_a_repaired_set_is_feasible_and_keeps_what_it_can(case: Any, data: Any) -> None:
    feasible, every = case
    broken = tuple(sorted(data.draw(st.sets(st.integers(0, feasible.horizon)))))
    rng = np.random.default_rng(data.draw(st.integers(0, 99)))
    before = rng.bit_generator.state
    repaired = feasible.repair(broken, rng)
    assert repaired in every
    if broken in every:
        assert repaired == broken
        assert rng.bit_generator.state == before
    # No other set keeps all that this one keeps, and more.
    kept = set(repaired) & set(broken)
    assert not any(kept < set(whole) & set(broken) for whole in every)


@quick
@given(possible(), st.integers(0, 99))
def test_random_sets_are_feasible(case: Any, seed: int) -> None:
    feasible, every = case
    drawn = feasible.random(20, np.random.default_rng(seed))
    assert len(drawn) == 20
    assert set(drawn) <= set(every)


@pytest.mark.parametrize("given_", LARGE)
def test_random_sets_are_equally_probable(given_: dict[str, Any]) -> None:
    every = every_set(**given_)
    assert len(every) > 20
    counts = Counter(Feasible(**given_).random(40 * len(every), np.random.default_rng(1)))
    assert set(counts) == set(every)
    assert stats.chisquare(list(counts.values())).pvalue > 1e-3


def test_without_constraints_random_sets_are_those_of_the_papers_run() -> None:
    """Drawn as by the first version: the paper's run stays what it is, byte for byte."""
    rng = np.random.default_rng(2020)
    order = rng.permuted(np.tile(np.arange(61), (50, 1)), axis=1)
    expected = [tuple(row) for row in np.sort(order[:, :21], axis=1).tolist()]
    assert Feasible(60, 21).random(50, np.random.default_rng(2020)) == expected


@pytest.mark.parametrize("given_", LARGE)
def test_exchanges_lead_from_every_set_to_every_other(given_: dict[str, Any]) -> None:
    feasible = Feasible(**given_)
    first = next(feasible.every())
    reached, open_ = {first}, [first]
    while open_:
        new = set(feasible.exchanges(open_.pop())) - reached
        reached |= new
        open_ += new
    assert len(reached) == feasible.size


def test_regular_times_for_money_are_found_at_once_among_very_many() -> None:
    rng = np.random.default_rng(1)
    feasible = Feasible(500, price=tuple(rng.integers(1, 50, 501).tolist()), total_price=3000)
    times = feasible.regular()
    assert feasible.accepts(times)
    assert feasible.price_of(times) == 3000


def test_those_nearest_to_a_time_that_costs_too_much_give_way_to_it() -> None:
    feasible = Feasible(8, price=(1, 1, 1, 1, 2, 1, 1, 1, 1), total_price=3)
    assert {neighbour for neighbour in feasible.exchanges((0, 3, 8)) if 4 in neighbour} == {
        (0, 4),
        (4, 8),
    }


def test_the_money_left_buys_the_times_that_are_farthest_from_the_rest() -> None:
    feasible = Feasible(8, price=(1,) * 9, total_price=4)
    assert feasible.completed((0,)) == (0, 2, 4, 8)  # 8, then the middle, then 2 before 6


def test_many_sets_are_counted_exactly_and_drawn() -> None:
    """Choosing N of T+1 at least d apart is choosing N of T+1 - (N-1)(d-1)."""
    feasible = Feasible(300, 60, minimum_spacing=4)
    places = 301 - 59 * 3
    assert feasible.size == comb(places, 60)
    assert all(map(feasible.accepts, feasible.random(20, np.random.default_rng(1))))


BUDGET = {"measurement_budget": 3}
IMPOSSIBLE = [
    ({}, r"measurement_budget must be given, or instead price and total_price, got none of them$"),
    (BUDGET | {"total_price": 5}, r"must be given, or .*, got measurement_budget and total_price$"),
    ({"price": ()}, r"got price$"),
    ({"total_price": 5}, r"got total_price$"),
    ({"price": (1, 2), "total_price": 5}, r"price needs 11 values, one for each instant, got 2$"),
    ({"price": (0,) + (1,) * 10, "total_price": 5}, r"price must be above 0, got 0: give wh"),
    ({"price": (3,) * 11, "total_price": 2}, r"and the cheapest has the price 3, got 2$"),
    ({"price": (3,) * 11, "total_price": 5, "required": (1, 4)}, r"whose price is 6, got 5$"),
    ({"price": (9999, *(10_000,) * 10), "total_price": 99_999}, r"10,000 times .* rounder prices$"),
    (
        {"forbidden": tuple(range(11)), "price": (1,) * 11, "total_price": 3},
        r"leave a time, got all",
    ),
    ({"measurement_budget": 12}, r"at most the number of instants, 11, got 12$"),
    ({"measurement_budget": 5, "minimum_spacing": 3}, r"at most 4, .* minimum_spacing = 3, got 5$"),
    ({"measurement_budget": 1, "required": (1, 2)}, r"at least 2, .* required times, got 1$"),
    (BUDGET | {"forbidden": (11,)}, r"^forbidden .* 0\.\.10, got 11$"),
    (BUDGET | {"forbidden": (3, 5), "required": (5,)}, r"got 5 in both$"),
    (BUDGET | {"required": (4, 5), "minimum_spacing": 2}, r"= 2, got 4 and 5$"),
]


@in_turn(("given_", "message"), IMPOSSIBLE)
def test_what_is_impossible_is_said_in_a_sentence(given_: dict[str, Any], message: str) -> None:
    with pytest.raises(MeasurementTimesError, match=message):
        Feasible(10, **given_)


COUNTED = Feasible(10, 3, forbidden=(3, 4), required=(6,), minimum_spacing=2)
PAID = replace(COUNTED, measurement_budget=None, price=(2,) * 11, total_price=7)


@pytest.mark.parametrize(
    ("feasible", "times", "sentences"),
    [
        (COUNTED, (1, 6, 8), []),
        (PAID, (6,), []),  # money that is left over breaks nothing
        (COUNTED, (0, 3, 6), ["forbidden: 3 is measured"]),
        (COUNTED, (5, 6, 7), ["minimum_spacing is 2, got 5 and 6, 6 and 7"]),
        (PAID, (0, 6, 8, 10), ["total_price is 7, got times with the price 8"]),
        (
            COUNTED,
            (3, 4, 0, 9),
            [
                "measurement_budget is 3, got 4 times",
                "forbidden: 3, 4 are measured",
                "required: 6 is not measured",
                "minimum_spacing is 2, got 3 and 4",
            ],
        ),
    ],
)
def test_every_broken_constraint_is_named_with_what_breaks_it(
    feasible: Feasible, times: Times, sentences: list[str]
) -> None:
    assert feasible.broken(times) == sentences


def test_dates_have_their_weekdays_in_words_and_a_season_a_count_a_month() -> None:
    """A year, and a day with hours, are said once; three to twelve months are counted."""
    days = {
        "horizon": 400,
        "measurement_budget": 3,
        "clock": {"start": "2027-04-13", "step": "1 d"},
    }
    problem = ProblemSection(**days)
    assert problem.when([]) == "at no time"
    assert problem.when(["2027-04-13", "2027-05-01"]) == "on Tue 2027-04-13, Sat 2027-05-01"
    season = ["2027-04-13", "2027-04-14", "2027-05-01", "2028-01-02"]
    words = "on Tue 2027-04-13, Wed 2027-04-14, Sat 2027-05-01, Sun 2028-01-02"
    assert problem.when(season) == f"{words} (by month: Apr 2, May 1, Jan 1)"
    hours = ProblemSection(
        horizon=24, measurement_budget=3, sensors=["ct", "grab"],
        clock={"start": "2027-04-13T08:00", "step": "6 h"},
    )  # fmt: skip
    written = ["2027-04-13T08:00 ct", "2027-04-13T14:00 ct", "2027-04-14T02:00 grab"]
    assert hours.when(written) == "on Tue 2027-04-13 08:00 ct, 14:00 ct, Wed 2027-04-14 02:00 grab"
    assert ProblemSection(horizon=4, measurement_budget=2).when([0, 3]) == "at t = 0, 3"
