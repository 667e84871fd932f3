"""Visits, installed sensors and groups: plans and bounds against brute force, by the Kalman filter.

All feasible sets are written down here as the manual says them, and tried one by one.
"""

import re
from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import combinations, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pfdist
from oracles.searched import exactly
from oracles.systems import SYSTEMS
from oracles.three_sensors import ThreeSensors
from oracles.windows import counted_errors
from pfdist import Problem, StateSpaceModel, plan
from pfdist.common.measurement_times import Times
from pfdist.errors import JobError
from pfdist.filters.kalman import expected_errors, expected_mse
from pfdist.problem.clock import Clock
from pfdist.problem.even_sets import even_sets
from pfdist.problem.feasible import Feasible
from pfdist.problem.points import Points
from pfdist.problem.visits import Installs
from pfdist.search import Exchange, Optimiser, StateSpaceRelaxation
from pfdist.search.first_windows import relaxation_with
from pfdist.search.gaps import gaps_with
from pfdist.search.programme import Programme, longer, near_optimal, with_multipliers
from pfdist.search.state_space_relaxation import first_relaxation

HORIZON = 9
PRICES = [1.0, 2, 1, 1, 2, 1, 1, 3, 1, 1]
ROUNDING = 1e-9


def _within(times: Times, last: int) -> int:
    """The number of visits of which each lasts so long from its first measurement."""
    number, first = 0, -last
    for t in times:
        if t - first >= last:
            number, first = number + 1, t
    return number


def _in(slots: Iterable[range], times: Times) -> int:
    """The number of slots with measurements; far too many if a time is outside of all."""
    used = [[slot for slot in slots if t in slot] for t in times]
    return len({slot[0] for slot in used if slot}) + 100 * sum(not slot for slot in used)


SLOTS = [range(1, 4), range(4, 6), range(7, 10)]
DATES = {"start": "2026-05-04", "step": "8 h"}  # three instants a day
# The keys of [problem], and whether a set is feasible
KINDS: dict[str, tuple[dict[str, Any], Callable[[Times], bool]]] = {
    "at most two within three": (
        {"measurement_budget": 4, "visits": {"most": 2, "within": 3}},
        lambda m: len(m) <= 4 and _within(m, 3) <= 2,
    ),
    "paid within three": (
        {"price": PRICES, "total_price": 14, "visits": {"price": 4, "within": 3}},
        lambda m: sum(PRICES[t] for t in m) + 4 * _within(m, 3) <= 14,
    ),
    "paid, at most three within two": (
        {"price": PRICES, "total_price": 9, "visits": {"price": 1.5, "most": 3, "within": 2}},
        lambda m: _within(m, 2) <= 3 and sum(PRICES[t] for t in m) + 1.5 * _within(m, 2) <= 9,
    ),
    "a day": (
        {"measurement_budget": 4, "clock": DATES, "visits": {"most": 2, "per": "day"}},
        lambda m: len(m) <= 4 and len({t // 3 for t in m}) <= 2,
    ),
    "a paid day": (
        {
            "price": PRICES,
            "total_price": 12,
            "clock": DATES,
            "visits": {"price": 3, "per": "day"},
        },
        lambda m: sum(PRICES[t] for t in m) + 3 * len({t // 3 for t in m}) <= 12,
    ),
    "slots": (
        {"measurement_budget": 4, "visits": {"most": 2, "allowed": ["1:3", "4:5", "7:9"]}},
        lambda m: len(m) <= 4 and _in(SLOTS, m) <= 2,
    ),
    "required and apart": (
        {
            "measurement_budget": 4,
            "required": [5],
            "forbidden": [6],
            "minimum_spacing": 2,
            "visits": {"most": 2, "within": 4},
        },
        lambda m: 5 in m and 6 not in m and len(m) <= 4 and _within(m, 4) <= 2
        and all(b - a >= 2 for a, b in pairwise(m)),
    ),
}  # fmt: skip
NAMES = "stable", "random walk", "static", "constant velocity", "sharp now and then", "oscillator"
NAMES = (*NAMES, "wanted late", "unstable")


def _feasible(keys: dict[str, Any]) -> Feasible:
    horizon = {"horizon": HORIZON * 8} if "clock" in keys else {"horizon": HORIZON}
    return Problem("linear_gaussian", **horizon, **keys).job(seed=1).problem.feasible


def _every(
    possible: int, is_feasible: Callable[[Times], bool], most: int = HORIZON + 1
) -> list[Times]:
    sets = (times for n in range(most + 1) for times in combinations(range(possible), n))
    return [times for times in sets if is_feasible(times)]


def _found(optimiser: Optimiser, model: StateSpaceModel, horizon: int) -> Times:
    state, rng = optimiser.init(), np.random.default_rng(1)
    while not optimiser.done(state):
        state = optimiser.tell(state, exactly(model, horizon, optimiser.ask(state, rng)))
    return optimiser.finalists(state)[0].measurement_times


def _plan(feasible: Feasible, model: StateSpaceModel) -> Times:
    """The relaxation's set, improved by exchanges, as a plan is found."""
    best = _found(StateSpaceRelaxation(feasible), model, feasible.horizon)
    return _found(Exchange(feasible, draws=1, start=best), model, feasible.horizon)


def _bounds(feasible: Feasible, model: StateSpaceModel, optimum: float) -> list[float]:
    """Bounds of the filter's and of the smoother's relaxation."""
    bounds, longest = list[float](), feasible.horizon + 1
    for lag in (0, feasible.horizon):
        relaxation = (
            gaps_with(feasible, longest, lag) if lag else relaxation_with(feasible, 2, longest)
        )
        if lag:
            every = expected_errors(model, feasible.horizon, relaxation.sets, lag=lag)
            errors = np.concatenate([
                row[first : end + 1]
                for row, first, end in zip(every, relaxation.first, relaxation.ends, strict=True)
            ])  # fmt: skip
        else:
            errors = counted_errors(model, relaxation)
        programme = with_multipliers(relaxation, errors, relaxation.total, optimum)
        bounds.append(float(programme.mse[relaxation.total]))
    return bounds


@pytest.mark.parametrize("kind", KINDS)
def test_sets_are_those_of_the_manual(kind: str) -> None:
    """All sets, random sets and neighbours of sets; every set is reached by exchanges."""
    keys, is_feasible = KINDS[kind]
    feasible, every = _feasible(keys), _every(HORIZON + 1, is_feasible)
    assert [*feasible.every()] == sorted(every)
    assert all(feasible.accepts(times) for times in every)
    assert {*feasible.random(200, np.random.default_rng(1))} <= {*every}
    assert feasible.regular() in every
    reached, waiting = {feasible.regular()}, [feasible.regular()]
    while waiting:
        new = {*feasible.exchanges(waiting.pop())} - reached
        assert new <= {*every}
        reached |= new
        waiting += new
    assert reached == {*every}


@pytest.mark.parametrize("kind", KINDS)
def test_the_plan_of_eight_systems_is_nearly_always_the_optimum(kind: str) -> None:
    """In seven of eight at least, and within 1 % in all; the bound lies below in all."""
    keys, is_feasible = KINDS[kind]
    feasible, every = _feasible(keys), _every(HORIZON + 1, is_feasible)
    excess = []
    for name in NAMES:
        model = SYSTEMS[name]
        own = expected_mse(model, HORIZON, every)
        excess.append(expected_mse(model, HORIZON, [_plan(feasible, model)])[0] / own.min() - 1)
        smoothed = expected_mse(model, HORIZON, every, lag=HORIZON)
        bounds = _bounds(feasible, model, float(own.min()))
        for bound, optimum in zip(bounds, (own.min(), smoothed.min()), strict=True):
            assert 0 < bound <= optimum * (1 + ROUNDING)
    assert sorted(excess)[-2] < ROUNDING
    assert max(excess) < 0.01


def _proved(feasible: Feasible, model: StateSpaceModel, optimum: float) -> float:
    """The bound when no window along the best sets can grow any more."""
    relaxation, last = relaxation_with(feasible, 2, feasible.horizon + 1), None
    while relaxation != last:
        programme = Programme(relaxation, counted_errors(model, relaxation), relaxation.total)
        paths, last = near_optimal(programme, relaxation.total, 8, optimum), relaxation
        relaxation = relaxation.grown(*longer(relaxation, paths))
    return float(programme.mse[relaxation.total])


@pytest.mark.parametrize("kind", [kind for kind, (keys, _) in KINDS.items() if "price" in keys])
def test_prices_of_visits_are_exact_in_the_bound(kind: str) -> None:
    """Without a largest number of visits the optimum is proved."""
    keys = {**KINDS[kind][0]}
    keys["visits"] = {key: each for key, each in keys["visits"].items() if key != "most"}
    feasible = _feasible(keys)
    every = [*feasible.every()]
    for name in NAMES[::3]:
        optimum = expected_mse(SYSTEMS[name], HORIZON, every).min()
        assert _proved(feasible, SYSTEMS[name], optimum) == pytest.approx(optimum, rel=1e-9)


@pytest.mark.parametrize("taken", [(2,), (0, 4)])
def test_a_visit_that_has_begun_is_exact_in_the_bound(taken: Times) -> None:
    """The optimum of the rest is proved: its first measurements may share the visit before."""
    keys = KINDS["paid within three"][0]
    rest = _feasible(keys | {"visits": {"price": 4, "within": 4}}).rest(taken, taken[-1] + 1)
    assert rest is not None
    assert rest.shared[0].setups[0].open_until
    every = [*rest.every()]
    for name in NAMES[::3]:
        optimum = expected_mse(SYSTEMS[name], rest.horizon, every).min()
        assert _proved(rest, SYSTEMS[name], optimum) == pytest.approx(optimum, rel=1e-9)


def test_prices_of_installations_are_exact_in_the_bound() -> None:
    keys, _ = OF_SENSORS["installed"]
    visits = {"visits": {"price": 1, "within": 2}}
    for more in ({}, visits):
        feasible = Problem(_three(0), horizon=LAST, **keys, **more).job(seed=1).problem.feasible
        every = [*feasible.every()]
        for seed in range(3):
            optimum = expected_mse(_three(seed), LAST, every).min()
            assert _proved(feasible, _three(seed), optimum) == pytest.approx(optimum, rel=1e-9)


@pytest.mark.plugins("budget")
def test_the_curve_of_prices_has_the_optimum_of_each(tmp_path: Path) -> None:
    """The plan for at most so much money is the best of all sets, and is proved to be."""
    keys = KINDS["paid within three"][0]
    problem = Problem("linear_gaussian", horizon=HORIZON, engine="kalman", **keys)
    run = pfdist.budget(problem, {7, 10, 14}, tmp_path, report=False, pool="serial")
    table = run.table("sets").query("kind == 'found'")
    every = [times for n in range(8) for times in combinations(range(HORIZON + 1), n)]
    own = expected_mse(SYSTEMS["oscillator"], HORIZON, every)
    for row in table.itertuples():
        price = [sum(PRICES[t] for t in m) + 4 * _within(m, 3) for m in every]
        optimum = own[np.array(price) <= row.budget].min()
        assert row.expected_mse == pytest.approx(optimum, rel=1e-9)
        assert row.bound == pytest.approx(optimum, rel=1e-6)
        assert row.price <= row.budget
    assert table["budget"].tolist() == [7, 10, 14]
    assert [*table["label"]] == ["plan for 7", "plan for 10", "plan for 14"]


# --- sensors --------------------------------------------------------------------------------------

LAST, NAMES_OF_SENSORS = 5, ("near", "far", "both")


def _three(seed: int) -> StateSpaceModel:
    rng = np.random.default_rng(seed)
    rows = tuple((float(a), float(b)) for a, b in rng.normal(size=(3, 2)).round(2))
    sds = tuple(rng.uniform(0.2, 2.0, 3).round(2).tolist())
    return ThreeSensors(turn=0.7, decay=0.95, process_sd=0.6, rows=rows, sds=sds).as_model()


def _paid(times: Times) -> float:
    """Measurements cost 1, 2 and 1; the last two sensors are installed for 2 and 3."""
    used = {t % 3 for t in times}
    return sum((1, 2, 1)[t % 3] for t in times) + 2 * (1 in used) + 3 * (2 in used)


OF_SENSORS: dict[str, tuple[dict[str, Any], Callable[[Times], bool]]] = {
    "installed": (
        {
            "total_price": 8,
            "sensors": {
                "near": {"price": 1},
                "far": {"price": 2, "install": 2},
                "both": {"price": 1, "install": 3},
            },
        },
        lambda m: _paid(m) <= 8,
    ),
    "one of two": (
        {
            "measurement_budget": 4,
            "sensors": {"near": {"together": "one"}, "far": {}, "both": {"together": "one"}},
        },
        lambda m: len(m) <= 4 and not any(t % 3 == 0 and t + 2 in m for t in m),
    ),
    "visits of all": (
        {
            "measurement_budget": 4,
            "sensors": ["near", "far", "both"],
            "visits": {"most": 2, "within": 2},
        },
        lambda m: len(m) <= 4 and _within(tuple(t // 3 for t in m), 2) <= 2,
    ),
}


@pytest.mark.parametrize("kind", OF_SENSORS)
def test_installed_sensors_and_groups(kind: str) -> None:
    """The optimum in seven of eight systems at least, within 1 % in all, and the bounds below."""
    keys, is_feasible = OF_SENSORS[kind]
    every, excess = _every(3 * (LAST + 1), is_feasible, most=8 if "total_price" in keys else 4), []
    problem = Problem(_three(0), horizon=LAST, **keys)
    feasible = problem.job(seed=1).problem.feasible
    assert [*feasible.every()] == sorted(every)
    assert feasible.accepts(feasible.regular())
    for seed in range(8):
        model = _three(seed)
        own = expected_mse(model, LAST, every)
        excess.append(expected_mse(model, LAST, [_plan(feasible, model)])[0] / own.min() - 1)
        smoothed = expected_mse(model, LAST, every, lag=LAST)
        bounds = _bounds(feasible, model, float(own.min()))
        for bound, optimum in zip(bounds, (own.min(), smoothed.min()), strict=True):
            assert 0 < bound <= optimum * (1 + ROUNDING)
    assert sorted(excess)[-2] < ROUNDING
    assert max(excess) < 0.01


def test_a_sensor_of_a_group_may_repeat() -> None:
    """The others of the group wait; the ways are near a, near b, far and both."""
    sensors = {"near": {"together": "g", "repeats": 2}, "far": {"together": "g"}, "both": {}}
    problem = Problem(_three(0), horizon=1, measurement_budget=8, sensors=sensors)
    feasible = problem.job(seed=1).problem.feasible
    wanted = _every(8, lambda m: not any({t, t + 1} & {*m} and t + 2 in m for t in (0, 4)))
    assert [*feasible.every()] == sorted(wanted)
    for times in wanted:
        later = range(max(times, default=-1) + 1, 8)
        beyond = {t for t in later if (*times, t) not in wanted}
        (found,) = feasible.beyond_limits([times])
        assert beyond == {*found} & {*later}


# --- what is left after measurements --------------------------------------------------------------


@pytest.mark.parametrize("kind", [kind for kind in KINDS if "required" not in kind])
def test_the_rest_are_the_sets_that_begin_with_what_was_measured(kind: str) -> None:
    """A visit that has begun is paid for, and no further visit counts for it."""
    keys, is_feasible = KINDS[kind]
    feasible, every = _feasible(keys), _every(HORIZON + 1, is_feasible)
    for taken, first in (((), 2), ((2,), 3), ((1, 4), 5), ((4, 5), 6), ((1,), 7)):
        rest = feasible.rest(taken, first)
        left = [times for times in every if times[: len(taken)] == taken]
        wanted = sorted({t[len(taken) :] for t in left if all(x >= first for x in t[len(taken) :])})
        if rest is None:
            assert wanted in ([], [()])
        else:
            assert [tuple(t + first for t in times) for times in rest.every()] == wanted


def test_at_the_end_fewer_measurements_fit_than_are_left() -> None:
    feasible = _feasible({"measurement_budget": 4, "visits": {"most": 2, "within": 3}})
    for first in range(1, HORIZON + 1):
        rest = feasible.rest((0,), first)
        assert rest is not None
        assert rest.total == min(3, HORIZON + 1 - first)


def test_required_times_that_no_visit_is_left_for_are_left_out() -> None:
    visits = {"most": 2, "within": 2}
    feasible = _feasible({"measurement_budget": 4, "required": [5, 9], "visits": visits})
    rest = feasible.rest((0,), 1)
    assert rest is not None
    assert rest.required == (4,)


@pytest.mark.parametrize("taken", [(0,), (0, 1), (0, 2), (1, 4), (2,)])
def test_what_is_left_of_what_is_left(taken: Times) -> None:
    """A visit that has begun goes on, however often the rest is taken."""
    feasible = _feasible({"measurement_budget": 5, "visits": {"most": 2, "within": 4}})
    once, (first, *later), stop = feasible.rest(taken, taken[-1] + 1), taken, taken[-1] + 1
    rest = feasible.rest((first,), first + 1)
    assert rest is not None
    twice = rest.rest(tuple(t - first - 1 for t in later), stop - first - 1)
    assert once is not None
    assert twice is not None
    assert [*once.every()] == [*twice.every()]
    for times in once.every():
        beyond = {t for t in range(max(times, default=-1) + 1, once.possible)
                  if not once.is_within_limits((*times, t))}  # fmt: skip
        (found,) = once.beyond_limits([times])
        assert beyond == {*found}


@pytest.mark.parametrize("criterion", ["expected_mse", "information"])
def test_a_bound_names_the_largest_number_of_measurements(tmp_path: Path, criterion: str) -> None:
    """Two visits have no room for all six; nothing has a price."""
    visits = {"most": 2, "within": 2}
    problem = Problem(
        "random_walk", horizon=9, measurement_budget=6, visits=visits, criterion=criterion,
        engine="kalman",
    )  # fmt: skip
    run = plan(problem, tmp_path, changes=["comparison.draws=48"], report=False, pool="serial")
    proved = str(pfdist.bound(run, figures=False, pool="serial"))
    assert "no other set of at most 6 times" in " ".join(proved.split())


# --- sizes ----------------------------------------------------------------------------------------


def test_a_long_horizon_leaves_out_the_first_measurements_of_visits() -> None:
    """All moves between their states would need gigabytes; the bound is then lower."""
    visits = {"most": 3, "within": 24}
    keys = {"horizon": 1999, "measurement_budget": 4, "visits": visits}
    feasible = Problem("linear_gaussian", **keys).job(seed=1).problem.feasible
    relaxation = relaxation_with(feasible, 1, 10)
    assert relaxation.states == 1
    assert relaxation_with(_feasible(KINDS["at most two within three"][0]), 2, 10).states == 3


def test_with_many_states_only_the_highest_prices_of_installations_count() -> None:
    """States for all choices of six would need gigabytes."""
    points = Points(Clock.counting(499), tuple("abcdef"))
    feasible = Feasible(
        horizon=499, price=(1,) * points.number, total_price=200, points=points, smaller=True,
        shared=(Installs.on(points, [(10 + way, (way,)) for way in range(6)]),),
    )  # fmt: skip
    setups = relaxation_with(feasible, 1, 10).setups
    assert setups.size == 2**3
    assert [each.size for each in setups.ends] == [1, 1, 1, 2, 2, 2]


def test_many_visits_have_few_grids() -> None:
    keys = {"horizon": 299, "measurement_budget": 100, "visits": {"most": 50, "within": 3}}
    even = even_sets(Problem("linear_gaussian", **keys).job(seed=1).problem.feasible)
    assert len(even.lines(700)) < 1500


@pytest.mark.parametrize("fee", [0, 10.5])
def test_a_curve_in_coarse_units_has_a_plan_for_each_price(fee: float) -> None:
    """Prices are rounded down in the programme. Each plan is one that can be paid for."""
    prices = [20.92, 11.74, 6.02, 5.41, 25.33, 27.82, 20.17, 23.24, 18.59, 28.38]
    visits = {"visits": {"price": fee, "within": 3}} if fee else {}
    keys = {"price": prices, "total_price": 90, **visits}
    feasible, model = replace(_feasible(keys), smaller=True), SYSTEMS["oscillator"]
    start = first_relaxation(feasible, 3, 0)
    assert start.unit > 1
    sums = tuple(price * 100 // start.unit for price in (40, 60, 90))
    search = StateSpaceRelaxation(feasible, sought=sums, start=start)
    state, rng = search.init(), np.random.default_rng(1)
    while not search.done(state):
        state = search.tell(state, exactly(model, HORIZON, search.ask(state, rng)))
    found = [each.measurement_times for each in search.finalists(state)]
    every = [times for n in range(8) for times in combinations(range(HORIZON + 1), n)]
    for price in (40, 60, 90):
        own, best = (
            expected_mse(model, HORIZON, [m for m in sets if feasible.price_of(m) <= price]).min()
            for sets in (found, every)
        )
        assert own < 1.02 * best


# --- refusals and words ---------------------------------------------------------------------------

SENSORS = {"near": {"price": 1}, "far": {"price": 2}, "both": {"price": 1}}


@pytest.mark.parametrize(
    ("keys", "why"),
    [
        ({"visits": {"most": 2}}, "needs one of within, per and allowed, got none"),
        ({"visits": {"most": 2, "within": 2, "per": "day"}}, "got within and per"),
        ({"visits": {"within": 2}}, "needs price, most or most_within, got none"),
        ({"visits": {"price": 2, "within": 2}}, "visits.price needs total_price"),
        ({"visits": {"most": 2, "per": "day"}}, "visits.per = 'day' needs dates"),
        ({"visits": {"most": 2, "allowed": ["3:5", "5:7"]}}, "must list visits one after"),
        ({"visits": {"most": 2, "allowed": []}}, "should have at least 1 item"),
        ({"visits": {"most": 2, "allowed": ["1:5:2"]}}, "all instants from one to another"),
        ({"visits": {"most": 1, "within": 2}, "required": ["0 5 far"]}, "must keep all limits"),
        ({"visits": {"most": 1, "within": "2 h"}}, "the clock has no unit"),
        ({"visits": {"most": 0, "within": 2}}, "at least 1, got 0"),
        ({"sensors": SENSORS | {"far": {"install": 3}}}, "install needs total_price"),
    ],
)  # fmt: skip
def test_what_is_no_budget(keys: dict[str, Any], why: str) -> None:
    with pytest.raises(JobError, match=re.escape(why)):
        Problem(_three(0), horizon=HORIZON, measurement_budget=3, **keys)


def test_a_visit_must_be_paid_before_anything_is_measured() -> None:
    with pytest.raises(JobError, match="the cheapest has the price 6, got 5"):
        Problem(
            "linear_gaussian", horizon=3, price=[1] * 4, total_price=5,
            visits={"price": 5, "within": 2},
        )  # fmt: skip


def test_answers_and_refusals_name_visits() -> None:
    """A day is named once; with sensors, each measurement has its own."""
    keys, _ = KINDS["a day"]
    problem = Problem("linear_gaussian", horizon=72, **keys).job(seed=1).problem
    words = problem.by_parts(["2026-05-04T08:00", "2026-05-04T16:00", "2026-05-06T00:00"])
    assert (
        words
        == "in 2 visits. Visit 1, Mon 2026-05-04: 08:00, 16:00. Visit 2, Wed 2026-05-06: 00:00."
    )
    by_days = {"start": "2026-05-04", "step": "1 d"}
    weeks = {"measurement_budget": 4, "clock": by_days, "visits": {"most": 2, "per": "week"}}
    days = Problem("linear_gaussian", horizon=20, **weeks).job(seed=1).problem
    assert days.by_parts(["2026-05-06"]) == "in 1 visit. Visit 1, t = 2026-05-06."
    too_many = problem.broken([f"2026-05-0{day}T08:00" for day in (4, 5, 6)])
    assert too_many == ["problem.visits.most is 2, got 3 visits"]
    paid = Problem("linear_gaussian", horizon=HORIZON, **KINDS["paid within three"][0])
    assert paid.job(seed=1).problem.feasible.price_of((0, 2, 3)) == 3 + 2 * 4
