from itertools import pairwise

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import solve_ivp

import pfdist
from oracles.moments import assert_mean
from pfdist import load_job
from pfdist.filters.simulation import simulate
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


@pytest.mark.zoo
@pytest.mark.parametrize("times", [(0, 1, 2, 3), (0, 0.5, 0.6, 7)], ids=["even", "irregular"])
def test_the_log_transmission_rate_has_stationary_moments_and_its_correlation(times):
    model = SOURCE.on_clock(times)
    x = simulate(model, 3, range(100_000), 5).x[:, :, 2] - MEAN
    for t, (time, later) in enumerate(pairwise(times)):
        assert_mean(x[:, t], 0.0)
        assert_mean(x[:, t] ** 2, SD**2)
        assert_mean(x[:, t] * x[:, t + 1], SD**2 * np.exp(-(later - time) / RETURN))


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


@pytest.mark.zoo
def test_the_job_speaks_of_days(request):
    job = load_job(request.config.rootpath / "jobs" / "epidemic.toml")
    evaluation = pfdist.evaluate(job, [20, 40], draws=20, particles=20)
    assert evaluation.measurement_times == (20.0, 40.0)
