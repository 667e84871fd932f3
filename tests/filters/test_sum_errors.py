"""Sums of errors over draws: those of the filter of each set, alone and up to each instant.

Each estimate of the errors is summed: by the variance of the particles, and by the squared error.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from pfdist import load_model, where
from pfdist.filters import particle_filter, plain
from pfdist.filters.interface import SUMS
from pfdist.filters.particle_filter import filter_checked_sets
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation
from pfdist.kernels.estimators import ESTIMATORS

HORIZON, PARTICLES, STREAM = 12, 60, 5
SETS = [(0, 3, 7), (0, 3), (), (0, 3, 7, 11), (0, 4), (3,), (0, 3, 7)]
ENDS = [9, 6, 12, 12, 4, 8, 12]
UNGM = load_model("ungm")


engines = pytest.mark.parametrize("engine", [particle_filter, plain], ids=["compiled", "plain"])
estimators = pytest.mark.parametrize("estimator", ESTIMATORS)


@engines
@estimators
def test_they_are_the_growth_of_the_errors_up_to_each_instant(engine, estimator):
    draws = simulate(UNGM, HORIZON, range(3, 10), 1)
    settings = Estimation(PARTICLES, estimator=estimator)
    found = engine.filter_checked_sets(UNGM, draws, SETS, ENDS, STREAM, settings, SUMS).errors
    for row, times, end in zip(found, SETS, ENDS, strict=True):
        prefixes = [tuple(time for time in times if time <= t) for t in range(end + 1)]
        upto = filter_checked_sets(UNGM, draws, prefixes, range(end + 1), STREAM, settings)[0]
        expected = np.diff(upto.sum(axis=0), prepend=0.0) * (HORIZON + 1)
        np.testing.assert_allclose(row[: end + 1], expected, rtol=1e-9, atol=1e-9)


DEGENERATE = {  # some draws alone, and at one instant alone
    "log_likelihood": lambda y, x, t, p: where(
        y[0] > where(t == 7, 3.0, math.inf), -math.inf, -0.5 * (y[0] - x[0]) ** 2
    )
}
INFINITE = {"quantity_of_interest": lambda x, t, p: (where(t == 8, math.inf, x[0]),)}


@engines
@pytest.mark.parametrize(
    "estimator", [name for name, each in ESTIMATORS.items() if not each.weights.evidence]
)
@pytest.mark.parametrize(
    ("changes", "wrong"),
    [
        pytest.param(DEGENERATE, [False] * len(SETS), id="degenerate"),
        pytest.param(INFINITE, [end >= 8 for end in ENDS], id="infinite"),
    ],
)
def test_a_set_with_an_infinite_draw_has_no_sum_and_others_are_as_alone(
    engine, estimator, changes, wrong
):
    model = replace(UNGM, **changes)
    draws = simulate(UNGM, HORIZON, range(20), 1)
    settings = Estimation(PARTICLES, estimator=estimator)
    with np.errstate(invalid="ignore"):
        found = engine.filter_checked_sets(model, draws, SETS, ENDS, STREAM, settings, SUMS).errors
    assert not all(wrong)
    for row, times, end, is_wrong in zip(found, SETS, ENDS, wrong, strict=True):
        if is_wrong:
            assert np.isnan(row).all()
        else:
            (alone,) = engine.filter_checked_sets(
                model, draws, [times], [end], STREAM, settings, SUMS
            ).errors
            assert np.isfinite(alone[: end + 1]).all()
            np.testing.assert_allclose(row[: end + 1], alone[: end + 1], rtol=1e-12)


@engines
def test_an_unexplained_measurement_has_an_infinite_evidence(engine):
    """Else the upper side of the information would be too low; z does not matter."""
    draws = simulate(UNGM, HORIZON, range(20), 1)
    for changes, wrong in ((DEGENERATE, [7 in each for each in SETS]), (INFINITE, [False] * 7)):
        given = replace(UNGM, **changes), draws, SETS, ENDS, STREAM
        settings = Estimation(PARTICLES, estimator="evidence")
        with np.errstate(invalid="ignore"):
            found = engine.filter_checked_sets(*given, settings, SUMS).errors
        for row, end, is_wrong in zip(found, ENDS, wrong, strict=True):
            assert np.isfinite(row[: end + 1]).all() != (is_wrong and end >= 7)
