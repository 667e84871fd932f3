"""The measurements that may follow in the order of time, and the sets that a job allows."""

from dataclasses import replace
from itertools import combinations, product

import numpy as np
import pytest

from pfdist.common.measurement_times import Times
from pfdist.constraints.spacing import Spacing
from pfdist.constraints.together import Together
from pfdist.kernels.left import Left
from pfdist.problem.clock import Clock
from pfdist.problem.feasible import Feasible
from pfdist.problem.points import Points
from pfdist.problem.shared import Limit, OfSensors, Shared
from pfdist.problem.visits import Installs, Visits

LAST = 6
TWO = Points(Clock.counting(3), ("cheap", "sharp"))
THREE = Points(Clock.counting(2), ("a", "b_a", "b_b"), repeats=(0, 1, 1))
LATE = Points(Clock.counting(3), ("meter", "lab"), (0, 2))
FAR = Limit(spacing=Spacing.constant(2, 3))
WITHIN = Visits.on(tuple(range(3, LAST + 4)), price=2, most=2)
SLOTS = Visits.on((2, 2, 4, 4, 7, 7, 7), most=2)
EACH = {
    "budget": Feasible(LAST, 3),
    "spacing, forbidden, required": Feasible(LAST, 3, (1,), (4,), 2),
    "prices": Feasible(LAST, price=(1, 2, 3, 1, 2, 3, 1), total_price=5, required=(5,)),
    "most": Feasible(
        3, 3, points=TWO, shared=(OfSensors.on(TWO, (Limit(1), Limit(2))),), minimum_spacing=0
    ),
    "spacing of a sensor": Feasible(
        3, 3, required=(5,), points=TWO, minimum_spacing=0,
        shared=(OfSensors.on(TWO, (Limit(2), FAR)),),
    ),
    "one sensor at a time": Feasible(3, 3, points=TWO, minimum_spacing=1),
    "together": Feasible(
        2, 4, points=THREE, minimum_spacing=0, required=(4,),
        shared=(Shared(steps=(Together.made_of(((0,), (1, 2)), 3),)),),
    ),
    "install": Feasible(
        2, points=THREE, minimum_spacing=0, price=(1, 2, 1) * 3, total_price=6,
        shared=(Installs.on(THREE, [(2, (0,)), (1, (1, 2))]),), required=(7,),
    ),
    "visits within": Feasible(
        LAST, price=(1,) * 7, total_price=7, shared=(WITHIN,), required=(4,), minimum_spacing=2
    ),
    "visits in slots": Feasible(LAST, 4, forbidden=(3,), shared=(SLOTS,), required=(0, 5)),
    "late values": Feasible(
        3, 3, forbidden=(1, 3), required=(7,), points=LATE, minimum_spacing=0,
        shared=(OfSensors.on(LATE, (Limit(2), FAR)),),
    ),
}  # fmt: skip


def allowed(feasible: Feasible) -> set[Times]:
    """All sets with the required times that satisfy the constraints, and that can be paid for."""
    every = (t for n in range(feasible.possible + 1) for t in combinations(feasible.allowed, n))
    return {t for t in every if {*feasible.required} <= {*t} and feasible.allows(t)}


def in_time(feasible: Feasible) -> list[int]:
    """The points in the order in which it is decided whether they are measured."""
    return sorted(range(feasible.possible), key=lambda p: (feasible.points.made_at(p), -p))


@pytest.mark.parametrize("feasible", [pytest.param(each, id=name) for name, each in EACH.items()])
def test_what_is_measured_on_the_way_are_the_sets_that_are_allowed(feasible: Feasible) -> None:
    """Draws that take at random what they may reach all allowed sets, and no others."""
    wanted, draws, rng = allowed(feasible), 3000, np.random.default_rng(1)
    given = feasible.step_limits, feasible.points.ways, feasible.allowed, feasible.horizon + 1
    left = Left(*given, feasible.budget, draws)
    chosen = np.zeros((draws, feasible.possible), np.bool_)
    share = rng.uniform(size=(draws, 1))  # how often each draw measures
    for point in in_time(feasible):
        left.wait(max(0, feasible.points.made_at(point)))
        takes = (rng.random(draws) < share[:, 0]) | (point in feasible.required)
        chosen[:, point] = left.may(point) & takes
        left.take(point, chosen[:, point])
    assert {tuple(np.flatnonzero(row).tolist()) for row in chosen} == wanted
    prices = [feasible.price_of(np.flatnonzero(row).tolist()) for row in chosen]
    np.testing.assert_allclose(left.spent, np.array(prices, np.float64))


@pytest.mark.parametrize("feasible", [pytest.param(each, id=name) for name, each in EACH.items()])
def test_the_rest_allows_what_may_follow(feasible: Feasible) -> None:
    """After any beginning of an allowed set, the sets of the rest are the ends of such sets."""
    points, parts = feasible.points, dict[tuple[int, Times, Times], set[Times]]()
    for first, times in product((1, 2), allowed(feasible)):
        taken = tuple(p for p in times if points.instant(p) < first)
        end = times[len(taken) :]
        in_flight = tuple(p for p in end if points.made_at(p) < first)
        parts.setdefault((first, taken, in_flight), set()).add(end)
    for (first, taken, in_flight), wanted in parts.items():
        rest, start = feasible.rest(taken, first, in_flight), points.first(first)
        found = set() if rest is None else allowed(replace(rest, smaller=True))
        assert ({tuple(start + p for p in t) for t in found} or {()}) == wanted
