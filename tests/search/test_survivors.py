"""The survivor programme against brute force, where costs are known exactly."""

import math
from collections import Counter
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from oracles.kalman import SCALAR, THREE, TRACKING, LinearGaussian, prefix_costs, riccati_cost
from pfdist.evaluation.estimate import Evaluation
from pfdist.search import Survivors
from pfdist.search.survivors import SurvivorState
from pfdist.times.feasible import Feasible
from pfdist.times.measurement_times import Times

PROBLEMS = [
    (system, Feasible(horizon, budget))
    for system in (SCALAR, TRACKING, THREE)
    for horizon, budget in ((10, 3), (12, 4), (14, 5))
]
EARLY_IS_CHEAP, OFTEN_DEAR = (1,) * 6 + (2,) * 7, (1, 3, 2) * 4 + (1,)
CONSTRAINED = {
    "forbidden": Feasible(12, 4, forbidden=(0, 3, 4, 5, 9)),
    "required": Feasible(12, 5, required=(6, 7, 12)),
    "spacing": Feasible(12, 4, minimum_spacing=3),
    "tight": Feasible(12, 5, minimum_spacing=3),
    "together": Feasible(14, 5, forbidden=(1, 2, 8), required=(10,), minimum_spacing=2),
    "one price": Feasible(12, cost=(2,) * 13, total_cost=9),
    "dearer": Feasible(12, cost=EARLY_IS_CHEAP, total_cost=7),
    "mixed": Feasible(12, cost=OFTEN_DEAR, total_cost=8),
    "all": Feasible(
        12, None, forbidden=(2,), required=(8,), minimum_spacing=2, cost=OFTEN_DEAR, total_cost=9
    ),
}
Cost = Callable[[Times, int], float]


def test_the_costs_are_those_of_the_kalman_filter() -> None:
    for system in (SCALAR, TRACKING, THREE):
        cost = prefix_costs(system, 12)
        for times in ((), (0, 3, 12), (5, 6, 7)):
            assert cost(times, 12) == pytest.approx(riccati_cost(system, 12, times), rel=1e-12)


def _states(search: Survivors, cost: Cost) -> Iterator[SurvivorState]:
    """Give each state of the programme before its end, and run it."""
    state, rng = search.init(), np.random.default_rng(0)
    while not state.done:
        yield state
        candidates = search.ask(state, rng)
        ends = [
            search.feasible.horizon if candidate.end is None else candidate.end
            for candidate in candidates
        ]
        told = [
            Evaluation(
                candidate.measurement_times, np.empty(0),
                exact=cost(candidate.measurement_times, end),
                end=candidate.end,
            )
            for candidate, end in zip(candidates, ends, strict=True)
        ]  # fmt: skip
        state = search.tell(state, told)
    yield state


def _run(search: Survivors, cost: Cost) -> tuple[SurvivorState, int]:
    """Its last state, and for how many sets it has asked."""
    *before, last = _states(search, cost)
    return last, sum(len(search.ask(state, np.random.default_rng(0))) for state in before)


@pytest.mark.parametrize(("system", "feasible"), PROBLEMS)
@pytest.mark.parametrize(
    "settings", [{"survivors": 2}, {"survivors": 3, "by_previous": True}], ids=["last", "previous"]
)
def test_it_finds_what_brute_force_finds(
    system: LinearGaussian, feasible: Feasible, settings: dict[str, Any]
) -> None:
    cost = prefix_costs(system, feasible.horizon)
    best = min(cost(times, feasible.horizon) for times in feasible.every())
    state, _ = _run(Survivors(feasible, **settings), cost)
    assert state.whole[0].cost == pytest.approx(best, rel=1e-12)


@pytest.mark.parametrize("constraint", CONSTRAINED)
@pytest.mark.parametrize("system", [SCALAR, TRACKING, THREE], ids=["scalar", "tracking", "three"])
@pytest.mark.parametrize(
    "settings", [{"survivors": 2}, {"survivors": 3, "by_previous": True}], ids=["last", "previous"]
)
def test_it_finds_what_brute_force_finds_under_constraints(
    constraint: str, system: LinearGaussian, settings: dict[str, Any]
) -> None:
    feasible = CONSTRAINED[constraint]
    cost = prefix_costs(system, feasible.horizon)
    best = min(cost(times, feasible.horizon) for times in feasible.every())
    state, _ = _run(Survivors(feasible, **settings), cost)
    assert all(feasible.accepts(evaluation.measurement_times) for evaluation in state.whole)
    assert state.whole[0].cost == pytest.approx(best, rel=1e-12)


def test_more_survivors_are_never_worse_here_and_ask_more() -> None:
    cost = prefix_costs(THREE, 14)
    found = [_run(Survivors(Feasible(14, 5), survivors), cost) for survivors in (1, 2, 4)]
    asked = [count for _, count in found]
    best = [state.whole[0].cost for state, _ in found]
    assert asked == sorted(set(asked))
    assert best == sorted(best, reverse=True)
    assert best[0] > best[1]  # one survivor is not enough for this one


@pytest.mark.parametrize("constraint", ["together", "dearer", "mixed", "all"])
def test_of_all_that_end_at_one_time_and_cost_the_same_two_are_extended(constraint: str) -> None:
    search = Survivors(CONSTRAINED[constraint], survivors=2)
    extended: Counter[tuple[int, float, int, int]] = Counter()
    for state in _states(search, prefix_costs(THREE, search.feasible.horizon)):
        limits = state.largest_gap, state.corridor  # when they are widened, it begins anew
        for times in state.front:
            extended[*limits, times[-1] if times else -1, search.feasible.spent(times)] += 1
    assert max(extended.values()) == 2


def test_limits_that_are_in_the_way_are_widened() -> None:
    """Measurements are wanted late, far from their proportional places and far apart."""

    def cost(times: Times, end: int) -> float:
        return -sum(math.exp(t - 40) for t in times)

    search = Survivors(Feasible(40, 4))
    state, _ = _run(search, cost)
    assert state.whole[0].measurement_times == (37, 38, 39, 40)
    assert state.largest_gap > search.init().largest_gap


def test_all_times_and_one_time() -> None:
    cost = prefix_costs(SCALAR, 5)

    def best(budget: int) -> Times:
        return _run(Survivors(Feasible(5, budget)), cost)[0].whole[0].measurement_times

    assert best(6) == (0, 1, 2, 3, 4, 5)
    singles = [cost((t,), 5) for t in range(6)]
    assert best(1) == (int(np.argmin(singles)),)
