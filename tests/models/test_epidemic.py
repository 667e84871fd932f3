from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from scipy import stats
from scipy.integrate import solve_ivp

import pfdist
from oracles.quadrature import quadrature_filter
from pfdist import load_job
from pfdist.errors import ModelError
from pfdist.filters.particle_filter import filter_draws
from pfdist.filters.simulation import simulate
from pfdist.models import load_model
from pfdist.models.epidemic import TESTS
from pfdist.times.measurement_times import regular

SOURCE = load_model("epidemic")
MODEL = SOURCE.on_clock(range(81))
REPRODUCTION, DAYS, RETURN, SD = 2.2, 6.0, 20.0, 0.25
MEAN = np.log(REPRODUCTION / DAYS)
TIMES = regular(80, 12)
# A rate that never returns to its mean stays what it was at first: there is no process noise.
CONSTANT = MODEL.with_parameters({"return_days": 1e12})


def assert_mean(values, expected):  # of independent values, within 4.5 standard errors
    assert abs(values.mean() - expected) < 4.5 * values.std() / np.sqrt(values.size)


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


@cache
def filtered():
    """Draws with a constant rate, and the exact mean and variance of the prevalence."""
    draws = simulate(CONSTANT, 80, range(300), 2020)
    return draws, *quadrature_filter(CONSTANT, draws, TIMES)


@pytest.mark.zoo
def test_half_the_step_of_the_quadrature_changes_nothing():
    draws, mean, _ = filtered()
    fine, _ = quadrature_filter(CONSTANT, draws[:20], TIMES, points=301)
    np.testing.assert_allclose(mean[:20], fine, rtol=1e-3, atol=1e-4)


@pytest.mark.zoo
def test_the_exact_filters_mse_is_the_variance_it_believes():
    draws, mean, variance = filtered()
    assert_mean(np.mean((draws.z[:, :, 0] - mean) ** 2 - variance, axis=1), 0.0)


@pytest.mark.zoo
@pytest.mark.parametrize("particles", [500, 8000])
def test_what_the_particle_filter_loses_is_its_distance_from_the_exact_mean(particles):
    # The exact mean's error is orthogonal to all that is computed from the measurements.
    draws, mean, _ = filtered()
    estimate = filter_draws(CONSTANT, draws, TIMES, particles, 1, trajectories=True).estimate
    z = draws.z[:, :, 0]
    lost = np.mean((z - estimate[:, :, 0]) ** 2 - (z - mean) ** 2, axis=1)
    assert_mean(lost - np.mean((estimate[:, :, 0] - mean) ** 2, axis=1), 0.0)


@pytest.mark.zoo
def test_the_particle_filter_comes_near_the_exact_mean():
    # Particles without process noise do not recover, so this takes many more than a job.
    draws, mean, _ = filtered()
    distances = [
        np.median(np.mean((estimate[:, :, 0] - mean) ** 2, axis=1))
        for estimate in (
            filter_draws(CONSTANT, draws, TIMES, particles, 1, trajectories=True).estimate
            for particles in (500, 8000)
        )
    ]
    assert distances[1] < distances[0] / 4


@pytest.mark.zoo
def test_measurements_help():
    draws = simulate(MODEL, 80, range(1000), 1)
    nothing, some, everything = (
        filter_draws(MODEL, draws, times, 500, 1).mse for times in ((), TIMES, range(81))
    )
    for worse, better in ((nothing, some), (some, everything)):
        gain = worse - better
        assert gain.mean() > 4.5 * gain.std() / np.sqrt(gain.size)


@pytest.mark.parametrize(
    ("name", "value"), [("sensitivity", 1.0), ("return_days", 0.0), ("first_infectious", 1.5)]
)
def test_a_parameter_has_its_range(name, value):
    with pytest.raises(ModelError, match=f"{name}.*got {value}"):
        MODEL.with_parameters({name: value})


@pytest.mark.zoo
def test_the_job_speaks_of_days(request):
    job = load_job(request.config.rootpath / "jobs" / "epidemic.toml")
    evaluation = pfdist.evaluate(job, [20, 40], draws=20, particles=20)
    assert evaluation.measurement_times == (20.0, 40.0)
