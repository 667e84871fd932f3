"""Evenly spaced times: which grids there are, and how near to the best of all the chosen one is."""

from itertools import pairwise

import numpy as np
import pytest

import pfdist
from pfdist.problem.clock import Clock
from pfdist.problem.even_grids import even_grids
from pfdist.problem.feasible import Feasible
from pfdist.problem.points import Points
from pfdist.runner.build import build


@pytest.mark.parametrize(("horizon", "number"), [(11, 4), (60, 21), (9, 10), (30, 1), (12, 2)])
def test_each_is_evenly_spaced_and_the_regular_times_come_first(horizon: int, number: int) -> None:
    feasible = Feasible(horizon=horizon, measurement_budget=number)
    grids = even_grids(feasible)
    assert grids[0] == feasible.regular()
    assert len({*grids}) == len(grids)
    for grid in grids:
        assert len(grid) == number
        assert feasible.accepts(grid)
        steps = {later - earlier for earlier, later in pairwise(grid)}
        assert not steps or max(steps) - min(steps) <= 1  # rounded to instants


def test_grids_are_moved_to_allowed_instants() -> None:
    feasible = Feasible(horizon=20, measurement_budget=4, forbidden=(0, 5, 6, 7), required=(9,))
    grids = even_grids(feasible)
    assert len(grids) > 10
    assert all(feasible.accepts(grid) for grid in grids)


def test_on_an_uneven_clock_grids_are_even_in_time() -> None:
    times = (0.0, 1.0, 2.0, 3.0, 4.0, 8.0, 12.0, 16.0)
    feasible = Feasible(horizon=7, measurement_budget=3, points=Points(Clock(times)))
    assert (0, 5, 7) in even_grids(feasible)  # 0, 8 and 16


@pytest.mark.parametrize("number", [2, 4, 5])
@pytest.mark.parametrize("model", ["random_walk", "linear_gaussian"])
def test_of_exact_errors_the_best_is_no_worse_than_any_integer_grid(
    model: str, number: int
) -> None:
    """First + k * step, for every first instant and every step."""
    horizon = 15
    job = pfdist.Problem(model, horizon=horizon, measurement_budget=number, engine="kalman").job()
    every = {
        tuple(range(first, first + number * step, step))
        for first in range(horizon)
        for step in range(1, horizon + 1)
        if first + (number - 1) * step <= horizon
    }
    evaluator = build(job).evaluator
    errors, found = (
        np.array(evaluator.expected_mse([*sets]))
        for sets in (every, even_grids(job.problem.feasible))
    )
    assert found.min() <= errors.min()
