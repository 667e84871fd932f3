import math

import numpy as np
import pytest
from scipy import special, stats

from oracles.kalman import LinearGaussian, kalman_filter
from oracles.moments import assert_covariance, assert_exact_filter, assert_mean
from pfdist.filters.particle_filter import filter_draws
from pfdist.filters.simulation import simulate
from pfdist.models import load_model

MODEL = load_model("constant_velocity")
STEP = np.array([[1 / 3, 1 / 2], [1 / 2, 1]])  # of white noise in continuous time, over a unit


def wrapped(angle):
    return np.angle(np.exp(1j * angle))


def test_formulas_at_a_point():
    changes = {"position_sd": 2.0, "velocity_sd": 0.5, "acceleration_sd": 0.6}
    p = MODEL.with_parameters(changes | {"range_sd": 0.2, "bearing_sd": 0.1}).p
    first = (-10 + 2, 2 - 2, 0.4 + 0.25, -1.0)
    assert MODEL.initial((1.0, -1.0, 0.5, -2.0), p) == pytest.approx(first, rel=1e-12)
    apart = 0.6 / math.sqrt(12)
    following = (1.1 + 0.3 - apart, 1.8 - 0.6 + 2 * apart, 0.7, -1.4)
    after = MODEL.transition((1.0, 2.0, 0.1, -0.2), 3, (1.0, -2.0, -1.0, 2.0), p)
    assert after == pytest.approx(following, rel=1e-12)
    x = (-3.0, 4.0, 0.1, -0.2)
    measured = (5 + 0.2 * 2, -math.atan(0.75) - 0.1)
    assert MODEL.measurement(x, 3, (2.0, -1.0), p) == pytest.approx(measured, rel=1e-12)
    assert MODEL.quantity_of_interest(x, 3, p) == (-3.0, 4.0)


def test_the_bearing_is_clockwise_from_north_and_wrapped():
    p = MODEL.with_parameters({"bearing_sd": 0.1}).p
    for x, v, bearing in (
        ((1.0, 0.0), 0.0, math.pi / 2),
        ((-1.0, 0.0), 0.0, -math.pi / 2),
        ((0.0, -1.0), 0.0, math.pi),
        ((0.0, -1.0), 1.0, 0.1 - math.pi),
    ):
        measured = MODEL.measurement((*x, 0.0, 0.0), 0, (0.0, v), p)
        assert measured == pytest.approx((1.0, bearing), rel=1e-12)


@pytest.mark.parametrize("sd", [math.radians(4), 1.0])
@pytest.mark.parametrize("y", [(4.0, -3.0), (5.5, 0.5), (3.0, 3.1)])
def test_log_likelihood_is_that_of_range_and_bearing_but_for_what_comes_round(y, sd):
    p = MODEL.with_parameters({"range_sd": 0.2, "bearing_sd": sd}).p
    bearing = np.linspace(-3.14, 3.14, 101)
    distance = np.linspace(3, 6, 101)
    x = (distance * np.sin(bearing), distance * np.cos(bearing), 0.0, 0.0)
    wound = (y[1] - bearing)[:, None] + 2 * np.pi * np.arange(-9, 10)
    exact = stats.norm.logpdf(y[0], loc=distance, scale=0.2)
    exact += special.logsumexp(stats.norm.logpdf(wound, scale=sd), axis=1)
    constant = stats.norm.logpdf(0.0, scale=0.2) + stats.norm.logpdf(0.0, scale=sd)
    difference = exact - constant - MODEL.log_likelihood(y, x, 0, p)
    # The nearest other turn weighs exp(-2 pi (pi - |d|) / sd^2) of this one, the rest of them less;
    # rounding of values up to 0.5 * (pi / sd)^2 = 1000.
    d = np.abs(wrapped(y[1] - bearing))
    assert (difference > -1e-11).all()
    assert (difference < np.log1p(2 * np.exp(-2 * np.pi * (np.pi - d) / sd**2)) + 1e-11).all()


@pytest.mark.zoo
def test_simulated_draws_have_the_moments_of_the_formulas():
    draws = simulate(MODEL.with_parameters({"acceleration_sd": 0.3}), 1, range(100_000), 5)
    before, after = draws.x[:, 0], draws.x[:, 1]
    start = before - [-10.0, 2.0, 0.4, 0.0]
    pushed = after - before @ np.kron([[1, 0], [1, 1]], np.eye(2))
    distance = np.hypot(before[:, 0], before[:, 1])
    noise = np.c_[
        draws.y[:, 0, 0] - distance,
        wrapped(draws.y[:, 0, 1] - np.arctan2(before[:, 0], before[:, 1])),
    ]
    for values, covariance in (
        (start, np.diag([0.3, 0.3, 0.05, 0.05]) ** 2),
        (pushed, 0.3**2 * np.kron(STEP, np.eye(2))),
        (noise, np.diag([0.5, math.radians(4)]) ** 2),
    ):
        assert_covariance(values, covariance)


@pytest.mark.zoo
def test_without_measurements_the_expected_mse_is_the_priors_variance():
    # Exact at whatever step, because the noise is that of continuous time: q t^3 / 3.
    t, particles = np.arange(41), 500
    variance = 2 * (0.3**2 + 0.05**2 * t**2 + 0.03**2 * t**3 / 3)
    mse = filter_draws(MODEL, simulate(MODEL, 40, range(5000), 3), (), particles, 1).mse
    assert_mean(mse, variance.mean() * (1 + 1 / particles))


@pytest.mark.zoo
@pytest.mark.parametrize("bearing", [0.0, 2.0, math.pi], ids=["north", "between", "south"])
def test_far_away_it_is_linear_and_gaussian(bearing):
    # From 10^6 km the range is the position along the line of sight, the bearing times 10^6 km that
    # across it, but for some 10^2 km^2 / 10^6 km. In the south bearings jump from pi to -pi.
    far, sd, q = 1e6, 0.3, 0.2**2
    along = np.array([math.sin(bearing), math.cos(bearing)])
    across = np.array([math.cos(bearing), -math.sin(bearing)])
    model = MODEL.with_parameters(
        {
            "east": far * along[0],
            "north": far * along[1],
            "velocity_east": 0.0,
            "position_sd": 0.5,
            "velocity_sd": 0.1,
            "acceleration_sd": math.sqrt(q),
            "range_sd": 2 * sd,
            "bearing_sd": sd / far,
        }
    )
    system = LinearGaussian(
        a=np.kron([[1.0, 1.0], [0.0, 1.0]], np.eye(2)),
        b=np.kron(np.linalg.cholesky(q * STEP), np.eye(2)),
        c=np.c_[[along, across], np.zeros((2, 2))],
        d=np.diag([2 * sd, sd]),
        h=np.eye(2, 4),
        b0=np.diag([0.5, 0.5, 0.1, 0.1]),
    )
    times, particles, count = (0, 3, 4, 9), 16_000, 100
    draws = simulate(model, 12, range(count), 1)
    filtered = filter_draws(model, draws, times, particles, 2, trajectories=True)
    y = np.stack([draws.y[..., 0] - far, far * wrapped(draws.y[..., 1] - bearing)], axis=-1)
    exact = [kalman_filter(system, measurements, times) for measurements in y]
    mean, variance = (np.array(values) for values in zip(*exact, strict=True))
    position = filtered.estimate - far * along
    assert_exact_filter(position, filtered.variance, mean, variance, particles)
