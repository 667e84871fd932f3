import math

import numpy as np
import pytest
from scipy import stats

from oracles.moments import assert_mean
from pfdist.filters.particle_filter import filter_draws
from pfdist.filters.simulation import simulate
from pfdist.models import load_model

MODEL = load_model("stochastic_volatility")
MU, PHI, SIGMA = -0.87, 0.98, 0.16
VARIANCE = SIGMA**2 / (1 - PHI**2)  # stationary


def test_formulas_at_a_point():
    p = MODEL.with_parameters({"mu": 1.0, "phi": 0.6, "sigma": 2.0}).p
    assert MODEL.initial((2.0,), p) == pytest.approx((1 + 2 / 0.8 * 2,), rel=1e-12)
    assert MODEL.transition((3.0,), 4, (-1.0,), p) == pytest.approx((1 + 0.6 * 2 - 2,), rel=1e-12)
    x = (2 * math.log(3),)  # exp(x/2) = 3
    assert MODEL.measurement(x, 4, (-0.5,), p) == pytest.approx((-1.5,), rel=1e-12)
    assert MODEL.quantity_of_interest(x, 4, p) == pytest.approx((3.0,), rel=1e-12)


@pytest.mark.parametrize("y", [-4.0, 0.0, 0.3])
def test_log_likelihood_is_that_of_the_measurement_up_to_a_constant(y):
    x = np.linspace(-5, 3, 101)
    exact = stats.norm.logpdf(y, scale=np.exp(x / 2))
    # Rounding of values up to 0.5 * 16 * e^5 = 1200.
    assert np.ptp(MODEL.log_likelihood((y,), (x,), 3, MODEL.p) - exact) < 1e-11


@pytest.mark.zoo
def test_simulated_draws_have_the_stationary_moments_at_all_times():
    draws = simulate(MODEL, 40, range(100_000), 5)
    for t in (0, 1, 40):
        x, y, z = (values[:, t, 0] for values in (draws.x, draws.y, draws.z))
        assert_mean(x, MU)
        assert_mean((x - MU) ** 2, VARIANCE)
        assert_mean(z, math.exp(MU / 2 + VARIANCE / 8))
        assert_mean(y, 0.0)
        assert_mean(y**2, math.exp(MU + VARIANCE / 2))
    before, after = draws.x[:, 0, 0], draws.x[:, 1, 0]
    pushed = after - MU - PHI * (before - MU)
    assert_mean(pushed, 0.0)
    assert_mean(pushed**2, SIGMA**2)
    assert_mean(pushed * (before - MU), 0.0)


@pytest.mark.zoo
def test_without_measurements_the_expected_mse_is_the_variance_of_the_volatility():
    particles = 500
    mse = filter_draws(MODEL, simulate(MODEL, 60, range(5000), 3), (), particles, 1).mse
    variance = math.exp(MU + VARIANCE / 4) * math.expm1(VARIANCE / 4)
    assert_mean(mse, variance * (1 + 1 / particles))
