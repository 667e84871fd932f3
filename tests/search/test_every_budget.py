"""The programme for every number of measurements against brute force, with costs known exactly."""

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest

from oracles.kalman import SCALAR, THREE, TRACKING, LinearGaussian, prefix_costs
from pfdist.evaluation.estimate import SearchEvaluation
from pfdist.search import EveryBudget, SearchOptimiser, Survivors
from pfdist.times.feasible import Feasible
from pfdist.times.measurement_times import Times

CONSTRAINED = {
    "none": Feasible(10, 6),
    "all times": Feasible(6, 7),
    "forbidden": Feasible(12, 5, forbidden=(0, 3, 4, 5, 9)),
    "required": Feasible(11, 6, required=(6, 11)),
    "spacing": Feasible(12, 5, minimum_spacing=3),
    "together": Feasible(14, 5, forbidden=(1, 2, 8), required=(10,), minimum_spacing=2),
}
Cost = Callable[[Times, int], float]


def _run(search: SearchOptimiser, horizon: int, cost: Cost) -> tuple[Any, int]:
    """Its last state, and for how many different evaluations it asked."""
    state, asked, rng = search.init(), set(), np.random.default_rng(0)
    while not search.done(state):
        told = []
        for times, end, *_ in search.ask(state, rng):
            last = horizon if end is None else end
            asked.add((times, last))
            told.append(SearchEvaluation(times, np.empty(0), exact=cost(times, last), end=end))
        state = search.tell(state, told)
    return state, len(asked)


@pytest.mark.parametrize("constraint", CONSTRAINED)
@pytest.mark.parametrize("system", [SCALAR, TRACKING, THREE], ids=["scalar", "tracking", "three"])
@pytest.mark.parametrize(
    "settings", [{"survivors": 2}, {"survivors": 3, "by_previous": True}], ids=["last", "previous"]
)
def test_of_every_number_it_finds_what_brute_force_finds(
    constraint: str, system: LinearGaussian, settings: dict[str, Any]
) -> None:
    feasible = CONSTRAINED[constraint]
    cost = prefix_costs(system, feasible.horizon)
    search = EveryBudget(feasible, 2, **settings)
    state, _ = _run(search, feasible.horizon, cost)
    found = sorted(
        search.finalists(state), key=lambda evaluation: len(evaluation.measurement_times)
    )
    assert [len(evaluation.measurement_times) for evaluation in found] == list(
        range(2, feasible.total + 1)
    )
    for evaluation in found:
        sets = replace(feasible, measurement_budget=len(evaluation.measurement_times))
        best = min(cost(times, feasible.horizon) for times in sets.every())
        assert sets.accepts(evaluation.measurement_times)
        assert evaluation.cost == pytest.approx(best, rel=1e-12)


def test_it_asks_for_less_than_one_programme_for_each_number() -> None:
    run = partial(_run, horizon=20, cost=prefix_costs(TRACKING, 20))
    _, together = run(EveryBudget(Feasible(20, 9), 5))
    one_by_one = sum(run(Survivors(Feasible(20, number)))[1] for number in range(5, 10))
    assert together < one_by_one / 2


def test_limits_that_are_in_the_way_are_widened() -> None:
    """Measurements are wanted late, far from their proportional places and far apart."""

    def cost(times: Times, end: int) -> float:
        return -sum(math.exp(t - 40) for t in times)

    search = EveryBudget(Feasible(40, 5), 4)
    state, _ = _run(search, 40, cost)
    found = [evaluation.measurement_times for evaluation in search.finalists(state)]
    assert found == [tuple(range(41 - number, 41)) for number in (5, 4)]
    assert state.widening > search.init().widening
