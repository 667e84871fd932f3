"""The survivor programme against brute force, where costs are known exactly."""

import itertools
import math
from functools import cache

import numpy as np
import pytest

from oracles.kalman import SCALAR, THREE, TRACKING, LinearGaussian, kalman_filter
from pfdist.search.survivors import Prefix, Survivors, SurvivorState

PROBLEMS = [
    (system, horizon, budget)
    for system in (SCALAR, TRACKING, THREE)
    for horizon, budget in ((10, 3), (12, 4), (14, 5))
]


def costs_of(system: LinearGaussian, horizon: int):
    """Exact cost of a prefix: the variances up to its end, over T + 1."""
    nothing = np.zeros((horizon + 1, len(system.c)))

    @cache
    def cost(prefix: Prefix) -> float:
        _, variances = kalman_filter(system, nothing, prefix.measurement_times)
        return float(variances[: prefix.end + 1].sum() / (horizon + 1))

    return cost


def run(search: Survivors, cost) -> tuple[SurvivorState, int]:
    state, asked = search.init(), 0
    while not state.done:
        prefixes = search.ask(state)
        asked += len(prefixes)
        state = search.tell(state, prefixes, [cost(prefix) for prefix in prefixes])
    return state, asked


@pytest.mark.parametrize(("system", "horizon", "budget"), PROBLEMS)
@pytest.mark.parametrize(
    "settings", [{"survivors": 2}, {"survivors": 3, "by_previous": True}], ids=["last", "previous"]
)
def test_it_finds_what_brute_force_finds(system, horizon, budget, settings) -> None:
    cost = costs_of(system, horizon)
    sets = itertools.combinations(range(horizon + 1), budget)
    best = min(cost(Prefix(times, horizon)) for times in sets)
    state, _ = run(Survivors(horizon, budget, **settings), cost)
    assert state.best is not None
    assert state.best[0] == pytest.approx(best, rel=1e-12)


def test_more_survivors_are_never_worse_here_and_ask_more() -> None:
    cost = costs_of(THREE, 14)
    found = [run(Survivors(14, 5, survivors), cost) for survivors in (1, 2, 4)]
    asked = [count for _, count in found]
    best = [state.best[0] for state, _ in found]
    assert asked == sorted(set(asked))
    assert best == sorted(best, reverse=True)
    assert best[0] > best[1]  # one survivor is not enough for this one


def test_limits_that_are_in_the_way_are_widened() -> None:
    """Measurements are wanted late, far from their proportional places and far apart."""

    def cost(prefix: Prefix) -> float:
        return -sum(math.exp(t - 40) for t in prefix.measurement_times)

    state, _ = run(Survivors(40, 4), cost)
    assert state.best is not None
    assert state.best[1] == (37, 38, 39, 40)
    assert state.longest_gap > Survivors(40, 4).init().longest_gap


def test_all_times_and_one_time() -> None:
    cost = costs_of(SCALAR, 5)
    assert run(Survivors(5, 6), cost)[0].best[1] == (0, 1, 2, 3, 4, 5)
    singles = [cost(Prefix((t,), 5)) for t in range(6)]
    assert run(Survivors(5, 1), cost)[0].best[1] == (int(np.argmin(singles)),)
