"""Plans under a store and a rate are those of an enumeration, and rules keep every limit."""

from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pfdist
from oracles.watched import WALK
from pfdist import Job, Problem
from pfdist.filters.exact import exact_mse
from pfdist.filters.particle_filter import filter_checked_draws
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation
from pfdist.kernels.rules import Applied, Thresholds
from pfdist.runner.build import build

SUN = [0.0] * 6 + [round(0.7 * float(np.sin(np.pi * (t - 5) / 14)), 2) for t in range(6, 19)]
NODE: dict[str, Any] = {
    "horizon": 23,
    "measurement_budget": 3,
    "sensors": {"cheap": {"price": 1}, "sharp": {"price": 4}},
    "store": {"capacity": 6, "start": 2, "income": SUN + [0.0] * 5},
}
RATE: dict[str, Any] = {
    "horizon": 15,
    "measurement_budget": 4,
    "sensors": {"cheap": {}, "sharp": {"most_within": {"number": 1, "time": 9}}},
    "most_within": {"number": 2, "time": 6},
}
LABORATORY: dict[str, Any] = {  # what is taken in a visit is known two instants later
    "horizon": 15,
    "measurement_budget": 4,
    "sensors": {"cheap": {"delay": 2}, "sharp": {"delay": 2}},
    "visits": {"within": 2, "most": 2},
}


def job_of(keys: dict[str, Any], **sections: Any) -> Job:
    return Problem(WALK, engine="kalman", **keys).job(seed=1, comparison={"draws": 100}, **sections)


@pytest.mark.parametrize(
    "keys", [pytest.param(NODE, id="store"), pytest.param(RATE, id="rate"),
             pytest.param(LABORATORY, id="visits with a delay")]
)  # fmt: skip
def test_the_plan_is_the_best_of_all_sets(keys: dict[str, Any], tmp_path: Path) -> None:
    job = job_of(keys)
    built = build(job)
    feasible, every = built.feasible, range(built.feasible.possible)
    sets = [
        times
        for number in range(feasible.total + 1)
        for times in combinations(every, number)
        if feasible.accepts(times)
    ]
    errors = exact_mse(built.evaluator, sets)
    assert errors is not None
    run = pfdist.plan(job, results=tmp_path / "run", pool="serial", figures=False)
    times = feasible.points.checked(run.best.measurement_times)
    assert errors[sets.index(times)] == pytest.approx(errors.min(), rel=1e-12)
    assert len(times) > 1


@pytest.mark.parametrize(
    ("keys", "thresholds"),
    [
        pytest.param(NODE, (1.2, 1.6), id="store"),
        pytest.param(RATE, (1.2, 1.6), id="rate"),
        pytest.param(LABORATORY, (1.45, 9.0), id="visits with a delay"),
    ],
)
def test_a_rule_keeps_every_limit_in_each_draw(
    keys: dict[str, Any], thresholds: tuple[float, float]
) -> None:
    feasible = Problem(WALK, **keys).job().problem.feasible
    draws = simulate(WALK, feasible.horizon, range(2000), 1)
    rule = Applied(Thresholds(thresholds, 0.0, feasible.budget), feasible.step_limits)
    found = filter_checked_draws(
        WALK, draws, feasible.allowed, 2, Estimation(50, rule=rule)
    ).measured
    sets = {tuple(np.flatnonzero(row).tolist()) for row in found}
    assert all(feasible.allows(times) for times in sets)
    free = replace(feasible, shared=())
    given = draws, free.allowed, 2, Estimation(50, rule=rule._replace(follows=free.step_limits))
    others = filter_checked_draws(WALK, *given).measured
    bound = [tuple(np.flatnonzero(row).tolist()) for row in others]
    assert sum(not feasible.allows(times) for times in bound) > 1000  # the limits bind
