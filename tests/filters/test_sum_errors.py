"""Sums of errors over draws: those of the filter of each set, alone and up to each instant."""

import math
from dataclasses import replace

import numpy as np
import pytest

from pfdist import load_model, where
from pfdist.filters import particle_filter, plain
from pfdist.filters.draws import simulate
from pfdist.filters.particle_filter import filter_sets, sum_errors
from pfdist.filters.settings import FilterSettings

HORIZON, PARTICLES, STREAM = 12, 60, 5
SETS = [(0, 3, 7), (0, 3), (), (0, 3, 7, 11), (0, 4), (3,), (0, 3, 7)]
ENDS = [9, 6, 12, 12, 4, 8, 12]
UNGM, VELOCITY = load_model("ungm"), load_model("constant_velocity")


@pytest.mark.parametrize("engine", [particle_filter, plain], ids=["compiled", "plain"])
@pytest.mark.parametrize("model", [UNGM, VELOCITY], ids=["ungm", "constant_velocity"])
@pytest.mark.parametrize("estimator", ["filter_variance", "two_filters"])
def test_they_are_the_growth_of_the_errors_up_to_each_instant(engine, model, estimator):
    draws = simulate(model, HORIZON, range(3, 10), 1)
    settings = FilterSettings(PARTICLES, estimator=estimator)
    found = engine.sum_errors(model, draws, SETS, ENDS, STREAM, settings)
    for row, times, end in zip(found, SETS, ENDS, strict=True):
        prefixes = [tuple(time for time in times if time <= t) for t in range(end + 1)]
        upto = filter_sets(
            model, draws, prefixes, PARTICLES, STREAM, ends=range(end + 1), estimator=estimator
        )
        expected = np.diff(upto.sum(axis=0), prepend=0.0) * (HORIZON + 1)
        np.testing.assert_allclose(row[: end + 1], expected, rtol=1e-9, atol=1e-9)


def test_draws_may_be_added_in_blocks():
    draws, settings = (
        simulate(UNGM, HORIZON, range(8), 1),
        FilterSettings(PARTICLES, estimator="filter_variance"),
    )
    parts = [sum_errors(UNGM, draws[i : i + 2], SETS, ENDS, STREAM, settings) for i in (0, 2, 4, 6)]
    whole = sum_errors(UNGM, draws, SETS, ENDS, STREAM, settings)
    for row, added, end in zip(whole, np.sum(parts, axis=0), ENDS, strict=True):
        np.testing.assert_allclose(added[: end + 1], row[: end + 1], rtol=1e-12)


@pytest.mark.parametrize("engine", [particle_filter, plain], ids=["compiled", "plain"])
def test_a_degenerate_draw_leaves_no_sum(engine):
    likelihood = lambda y, x, t, p: where(y[0] > 3.0, -math.inf, -0.5 * (y[0] - x[0]) ** 2)  # noqa: E731
    model = replace(UNGM, log_likelihood=likelihood)
    draws = simulate(model, HORIZON, range(40), 1)
    settings = FilterSettings(PARTICLES, estimator="filter_variance")
    with np.errstate(invalid="ignore"):
        found = engine.sum_errors(model, draws, SETS, ENDS, STREAM, settings)
    assert np.isnan(found).all()
