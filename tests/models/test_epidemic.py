from itertools import pairwise

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import solve_ivp

from oracles.moments import assert_mean
from pfdist.models import load_model
from pfdist.models.library.epidemic import TESTS

SOURCE = load_model("epidemic")
MODEL = SOURCE.on_clock(range(81))
REPRODUCTION, DAYS, RETURN, SD = 2.2, 6.0, 20.0, 0.25
MEAN = np.log(REPRODUCTION / DAYS)


def after(days, x, step):
    """The state that many days later without noise, by steps of a length."""
    model = SOURCE.on_clock(np.arange(0, days + step, step))
    for t in range(round(days / step)):
        x = model.transition(x, t, (0.0,), model.p)
    return np.array(x)


def test_the_state_follows_kermack_and_mckendrick_to_the_first_order_of_the_step():
    first = np.array([0.99, 0.01])
    exact = solve_ivp(
        lambda _, x: [
            -REPRODUCTION / DAYS * x[0] * x[1],
            REPRODUCTION / DAYS * x[0] * x[1] - x[1] / DAYS,
        ],
        (0, 40), first, "DOP853", rtol=1e-12, atol=1e-12,
    )  # fmt: skip
    errors = [
        np.abs(after(40, (*first, MEAN), step)[:2] - exact.y[:, -1]) for step in (0.5, 0.25, 0.125)
    ]
    for error, at_half_the_step in pairwise(errors):
        np.testing.assert_allclose(error / at_half_the_step, 2, atol=0.1)


def test_shares_stay_within_0_and_1_however_long_the_step_is():
    model = SOURCE.on_clock((0.0, 1e6, 2e6))
    susceptible, infectious, _ = model.transition((0.6, 0.4, 9.0), 0, (9.0,), model.p)
    assert 0 <= susceptible <= susceptible + infectious <= 1


def test_the_log_transmission_rate_is_a_stationary_autoregression():
    """Its covariance over a time d is SD^2 exp(-d / RETURN)."""
    model = SOURCE.on_clock((0.0, 0.5, 7.0))
    first = model.initial((0.0, 2.0), model.p)
    assert first[2] == pytest.approx(MEAN + 2 * SD, rel=1e-12)
    for t, days in enumerate((0.5, 6.5)):
        kept = np.exp(-days / RETURN)
        expected = MEAN + kept * (first[2] - MEAN) - SD * np.sqrt(1 - kept**2)
        assert model.transition(first, t, (-1.0,), model.p)[2] == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("prevalence", [0.0, 0.03, 0.5, 1.0])
def test_a_measurement_is_a_binomial_count_and_the_likelihood_is_its_probability(prevalence):
    # Rogan and Gladen: the chance of a positive test.
    chance = 0.85 * prevalence + 0.01 * (1 - prevalence)
    rng = np.random.default_rng(1)
    v = tuple(rng.uniform(size=(TESTS, 20_000)))
    (counts,) = MODEL.measurement((0.0, prevalence, 0.0), 3, v, MODEL.p)
    assert set(counts) <= set(range(TESTS + 1))
    assert_mean(counts, TESTS * chance)
    assert_mean((counts - TESTS * chance) ** 2, TESTS * chance * (1 - chance))
    y = np.arange(TESTS + 1)
    exact = stats.binom.logpmf(y, TESTS, chance) - stats.binom.logpmf(y, TESTS, 0.5)
    value = MODEL.log_likelihood((y,), (0.0, prevalence, 0.0), 3, MODEL.p)
    # The rest does not depend on the prevalence; rounding of values up to 200 * log(100) = 900.
    np.testing.assert_allclose(value, exact + TESTS * np.log(0.5), atol=1e-10)


def test_the_prevalence_is_wanted_in_per_cent():
    assert MODEL.quantity_of_interest((0.5, 0.25, 0.0), 4, MODEL.p) == pytest.approx((25.0,))
