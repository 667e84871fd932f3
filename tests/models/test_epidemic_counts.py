"""Counts of patients are Poisson numbers, and the epidemic is the other model's."""

import numpy as np
import pytest
from scipy import stats

from oracles.moments import assert_mean
from pfdist.models import load_model
from pfdist.models.library import epidemic

MODEL = load_model("epidemic_counts").on_clock(range(81))


@pytest.mark.parametrize("prevalence", [0.0, 0.03, 0.3])
def test_a_measurement_is_a_poisson_count_and_the_likelihood_is_its_probability(prevalence):
    mean = 5000 * (0.1 * prevalence + 0.0005)
    x = (0.0, prevalence, 0.0)
    uniform = np.random.default_rng(1).uniform(size=50_000)
    with np.errstate(all="ignore"):  # as in the filter in NumPy
        (counts,) = MODEL.measurement(x, 3, (uniform,), MODEL.p)
    assert_mean(counts, mean)
    assert_mean((counts - mean) ** 2, mean)
    y = np.arange(400.0)
    exact = stats.poisson.logpmf(y, mean)
    np.testing.assert_allclose(MODEL.log_likelihood((y,), x, 3, MODEL.p), exact, rtol=1e-9)


def test_the_epidemic_is_that_of_the_tests():
    assert MODEL.transition is epidemic.model.transition
    assert MODEL.initial is epidemic.model.initial
    assert MODEL.quantity_of_interest((0.5, 0.25, 0.0), 4, MODEL.p) == pytest.approx((25.0,))
    for name in ("reproduction_number", "infectious_days", "first_infectious"):
        assert MODEL.parameters[name] == epidemic.model.parameters[name]
