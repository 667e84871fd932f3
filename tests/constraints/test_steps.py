"""Constraints by their steps, against definitions that know no steps, in random small jobs.

Each constraint is defined for a whole set of measurements at once: a store by its level at every
instant, the most in a stretch by counting in every stretch, visits by those that are begun.
"""

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from itertools import combinations
from typing import Any

import numpy as np
import pytest

from oracles.kalman import SCALAR
from oracles.watched import WALK as TWO_SENSORS
from pfdist import Problem
from pfdist.common.measurement_times import Times
from pfdist.errors import PfdistError
from pfdist.problem.feasible import Feasible

JOBS = 300
Measured = list[tuple[int, int]]  # instants and sensors, in the order in which they are made
Rule = Callable[[Measured], bool]


@dataclass
class Case:
    """A job, and what it allows."""

    sensors: int
    horizon: int
    keys: dict[str, Any] = field(default_factory=dict)
    of_sensors: list[dict[str, Any]] = field(default_factory=list)
    rules: list[Rule] = field(default_factory=list)
    delays: list[int] = field(default_factory=list)
    prices: list[int] = field(default_factory=list)
    visit: Callable[[Measured], Measured] = lambda made: made

    @property
    def feasible(self) -> Feasible:
        model, keys = SCALAR.as_model(), dict(self.keys)
        if self.sensors > 1:
            model = TWO_SENSORS
            keys["sensors"] = dict(zip(("cheap", "sharp"), self.of_sensors, strict=True))
            keys.pop("price", None)
        return Problem(model, horizon=self.horizon, **keys).job().problem.feasible

    def allows(self, points: Iterable[int]) -> bool:
        """Whether a set of points, which are those of arrivals, keeps all rules."""
        made = sorted(
            (p // self.sensors - self.delays[p % self.sensors], p % self.sensors) for p in points
        )
        return all(t >= 0 for t, _ in made) and all(rule(made) for rule in self.rules)


def at_most(most: int, counted: Callable[[Measured], Measured], length: int) -> Rule:
    """At most so many of some in any stretch: in each that begins at an instant."""

    def keeps(made: Measured) -> bool:
        instants = [t for t, _ in counted(made)]
        return all(sum(u <= t < u + length for t in instants) <= most for u in {*instants})

    return keeps


def stored(capacity: float, level: float, income: list[float], prices: list[float]) -> Rule:
    """The level at every instant, with all that arrives and all that is drawn."""

    def keeps(made: Measured) -> bool:
        now, drawn = level, Counter[int]()
        for t, sensor in made:
            drawn[t] += prices[sensor]
        for t, new in enumerate(income):
            now = min(capacity, now + new) - drawn[t]
            if now < -1e-9:
                return False
        return True

    return keeps


def begun(length: int) -> Callable[[Measured], Measured]:
    """The measurements that begin a visit."""

    def firsts(made: Measured) -> Measured:
        found = Measured()
        for t, sensor in made:
            if not found or t >= found[-1][0] + length:
                found.append((t, sensor))
        return found

    return firsts


def add_visits(case: Case, rng: np.random.Generator) -> None:
    length, most = int(rng.integers(1, 4)), int(rng.integers(1, 3))
    case.visit = begun(length)
    case.keys["visits"] = {"within": length, "most": most}
    case.rules.append(lambda made: len(case.visit(made)) <= most)


def add_budget(case: Case, rng: np.random.Generator) -> None:
    """A number, or money, of which visits cost some, too."""
    number, total, fee = int(rng.integers(2, 5)), int(rng.integers(4, 10)), 0
    if rng.integers(2):
        case.keys["measurement_budget"] = number
        case.rules.append(lambda made: len(made) <= number)
        return
    if "visits" in case.keys:
        fee = case.keys["visits"]["price"] = int(rng.integers(1, 3))
    case.keys |= {"price": case.prices[0], "total_price": total}
    case.rules.append(
        lambda made: sum(case.prices[s] for _, s in made) + fee * len(case.visit(made)) <= total
    )


def add_store(case: Case, rng: np.random.Generator) -> None:
    income = rng.choice([0.0, 0.5, 1.0], case.horizon + 1).tolist()
    capacity, start = int(rng.integers(3, 6)), int(rng.integers(2, 4))
    case.keys["store"] = {"capacity": capacity, "start": min(start, capacity), "income": income}
    has_prices = "price" in case.keys or case.sensors > 1
    drawn = case.prices if has_prices else [1]
    case.rules.append(stored(capacity, start, income, drawn))


def add_most_within(case: Case, rng: np.random.Generator) -> None:
    most, length = int(rng.integers(1, 3)), int(rng.integers(2, 5))
    section = {"number": most, "time": length}
    if "visits" in case.keys and rng.integers(2):
        case.keys["visits"]["most_within"] = section
        case.rules.append(at_most(most, case.visit, length))
    elif case.sensors > 1 and rng.integers(2):
        case.of_sensors[1]["most_within"] = section
        case.rules.append(at_most(most, lambda made: [m for m in made if m[1]], length))
    else:
        case.keys["most_within"] = section
        case.rules.append(at_most(most, lambda made: made, length))


def add_limits_of_sensors(case: Case, rng: np.random.Generator) -> None:
    most, apart = int(rng.integers(1, 3)), int(rng.integers(2, 4))
    case.of_sensors[0]["most"] = most
    case.of_sensors[1]["minimum_spacing"] = apart
    case.rules.append(lambda made: sum(not s for _, s in made) <= most)
    case.rules.append(at_most(1, lambda made: [m for m in made if m[1]], apart))


def add_group(case: Case) -> None:
    for own in case.of_sensors:
        own["together"] = "group"
    case.rules.append(lambda made: len({t for t, _ in made}) == len(made))


def add_delays(case: Case, rng: np.random.Generator) -> None:
    case.delays = rng.integers(0, 3, case.sensors).tolist()
    if case.sensors == 1 and case.delays[0]:
        case.keys["sensor"] = {"delay": case.delays[0]}
    for own, delay in zip(case.of_sensors, case.delays, strict=True):
        own.update({"delay": delay} if delay else {})


def case_of(rng: np.random.Generator) -> Case:
    """A job with one or two sensors, a budget, and one to four other constraints."""
    sensors = int(rng.choice([1, 2]))
    case = Case(sensors, 7 if sensors == 1 else 4, delays=[0] * sensors)
    case.prices = rng.integers(1, 4, sensors).tolist()
    case.of_sensors = [{"price": price} for price in case.prices]
    kinds = ["store", "most_within", "visits", "group", "sensors", "required", "spacing", "delays"]
    chosen = {*rng.choice(kinds, int(rng.integers(1, 5)), replace=False).tolist()}
    if "delays" in chosen:
        add_delays(case, rng)
    if "visits" in chosen:
        add_visits(case, rng)
    add_budget(case, rng)
    if "store" in chosen:
        add_store(case, rng)
    if "most_within" in chosen:
        add_most_within(case, rng)
    if {"group", "sensors"} & chosen and sensors > 1:
        add_group(case) if "group" in chosen else add_limits_of_sensors(case, rng)
    if "required" in chosen and not any(case.delays):
        case.keys["required"] = [3] if sensors == 1 else ["3 cheap"]
        case.rules.append(lambda made: (3, 0) in made)
    if "spacing" in chosen and len({*case.delays}) == 1:
        case.keys["minimum_spacing"] = 2
        case.rules.append(at_most(1, lambda made: made, 2))
    return case


def jobs() -> list[tuple[Case, Feasible]]:
    """Random jobs whose constraints a set can satisfy."""
    rng, found = np.random.default_rng(11), list[tuple[Case, Feasible]]()
    while len(found) < JOBS:
        case = case_of(rng)
        try:
            found.append((case, case.feasible))
        except PfdistError as error:
            assert "must" in str(error) or "possible" in str(error), error  # noqa: PT017
    return found


@pytest.fixture(scope="module")
def each_job() -> list[tuple[Case, Feasible]]:
    return jobs()


def allowed(case: Case, feasible: Feasible) -> set[Times]:
    """All sets that the rules allow."""
    points = range(feasible.possible)
    every = (t for n in range(feasible.total + 1) for t in combinations(points, n))
    return {times for times in every if case.allows(times)}


def complete(sets: set[Times], feasible: Feasible) -> set[Times]:
    """Those that a job may choose: of N, or with nothing to add, if no smaller ones are."""
    if feasible.counted:
        return {times for times in sets if len(times) == feasible.total}
    if feasible.smaller:
        return sets
    larger = {frozenset(times) for times in sets}
    points = range(feasible.possible)
    return {
        times for times in sets if not any({*times, p} in larger for p in points if p not in times)
    }


def test_sets_what_may_follow_and_random_sets_are_those_of_the_definitions(
    each_job: list[tuple[Case, Feasible]],
) -> None:
    kinds = Counter[str]()
    for case, feasible in each_job:
        within = allowed(case, feasible)
        wanted = complete(within, feasible)
        assert [*feasible.every()] == sorted(wanted), case
        assert feasible.size == len(wanted)
        assert {feasible.regular()} <= wanted
        for times in feasible.random(5, np.random.default_rng(2)):
            assert times in wanted
        for times in sorted(wanted)[::7]:
            for k in range(len(times) + 1):
                prefix = times[:k]
                following = {each[k] for each in wanted if each[:k] == prefix and len(each) > k}
                assert {*feasible.extensions(prefix)} == following, (case, prefix)
        kinds.update(step.kind for step in feasible.steps)
    assert min(kinds.values()) > 20, kinds  # each kind has its jobs


def test_the_compiled_steps_are_those_of_python(each_job: list[tuple[Case, Feasible]]) -> None:
    """After sets at random, feasible or not: which points break a constraint as the next one."""
    rng = np.random.default_rng(3)
    for case, feasible in each_job:
        if not feasible.steps:
            continue
        every = range(feasible.possible)
        sets = [tuple(p for p in every if rng.random() < 0.25) for _ in range(10)]
        sets = [times for times in sets if feasible.is_within_limits(times)]
        moments = feasible.points.moments
        for times, broken in zip(sets, feasible.beyond_limits(sets), strict=True):
            last = max((moments[p] for p in times), default=-1)
            later = [p for p in every if moments[p] > last and feasible.points.made_at(p) >= 0]
            found = [p for p in later if not feasible.is_within_limits(sorted((*times, p)))]
            assert [*broken] == found, (case, times)


def test_what_is_measured_on_the_way_are_the_sets_of_the_definitions(
    each_job: list[tuple[Case, Feasible]],
) -> None:
    """Draws that take at random what they may reach allowed sets alone, and nearly all of them."""
    rng, reached, possible = np.random.default_rng(4), 0, 0
    for case, feasible in each_job[::3]:
        wanted = {t for t in allowed(case, feasible) if {*feasible.required} <= {*t}}
        left = feasible.left()
        draws = 400
        left = type(left)(
            feasible.step_limits, feasible.points.ways, feasible.allowed, feasible.horizon + 1,
            feasible.budget, draws,
        )  # fmt: skip
        chosen = np.zeros((draws, feasible.possible), np.bool_)
        share = rng.uniform(size=draws)
        made_at = feasible.points.made_at
        for point in sorted(range(feasible.possible), key=lambda p: (made_at(p), -p)):
            left.wait(max(0, made_at(point)))
            takes = (rng.random(draws) < share) | (point in feasible.required)
            chosen[:, point] = left.may(point) & takes
            left.take(point, chosen[:, point])
        found = {tuple(np.flatnonzero(row).tolist()) for row in chosen}
        assert found <= wanted, (case, found - wanted)
        reached, possible = reached + len(found), possible + len(wanted)
    assert reached > 0.7 * possible


def test_the_rest_allows_what_may_follow(each_job: list[tuple[Case, Feasible]]) -> None:
    """After a beginning of an allowed set, the sets of the rest are the ends of such sets."""
    for case, feasible in each_job[::4]:
        within = {t for t in allowed(case, feasible) if {*feasible.required} <= {*t}}
        points, first = feasible.points, 2
        for times in sorted(within)[::5]:
            taken = tuple(p for p in times if points.instant(p) < first)
            flying = tuple(p for p in times[len(taken) :] if points.made_at(p) < first)
            start, begun_so = points.first(first), {*taken, *flying}
            wanted = {
                tuple(p - start for p in each if p >= start)
                for each in within
                if {p for p in each if points.made_at(p) < first} == begun_so
            }
            rest = feasible.rest(taken, first, flying)
            found = {()} if rest is None else {
                t
                for n in range(rest.possible + 1)
                for t in combinations(rest.allowed, n)
                if {*rest.required} <= {*t} and rest.allows(t)
            }  # fmt: skip
            assert (found or {()}) == wanted, (case, taken, flying)
