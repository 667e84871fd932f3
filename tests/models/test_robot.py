"""The robot's formulas at points, its likelihood, and its filter against a filter on the circle."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from oracles.circle import circle_filter
from oracles.moments import assert_mean
from pfdist.filters.particle_filter import filter_draws
from pfdist.filters.simulation import simulate
from pfdist.models import load_model
from pfdist.models.library.robot import BEACONS

MODEL = load_model("robot")


def wrapped(angle):
    return np.angle(np.exp(1j * angle))


@pytest.mark.parametrize(("t", "turned"), [(13, 0.1), (14, 1.3), (21, 1.3), (22, 0.1)])
def test_it_drives_along_an_arc_in_the_bend(t, turned):
    changes = {"speed": 2.0, "speed_sd": 0.5, "turn_rate": 1.0, "slip": 0.1, "drift_sd": 0.05}
    p = MODEL.with_parameters(changes).p
    # 3 m ahead while it turns: the chord of the arc has the direction in the middle.
    after = MODEL.transition((1.0, -1.0, 0.4), t, (2.0, 2.0), p)
    middle = 0.4 + turned / 2
    expected = (1 + 3 * math.cos(middle), -1 + 3 * math.sin(middle), 0.4 + turned)
    assert after == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("heading", [0.0, 1.0, -8.0, 40.0])
def test_beacons_are_seen_from_the_nose(heading):
    p = MODEL.with_parameters({"concentration": 1e8}).p
    x = (3.0, -2.0, heading)
    seen = MODEL.measurement(x, 0, (0.5, 0.5), p)
    for angle, (east, north) in zip(seen, BEACONS, strict=True):
        exact = wrapped(math.atan2(north + 2, east - 3) - heading)
        assert abs(wrapped(angle - exact)) < 1e-6
        assert -math.pi < angle <= math.pi


def test_the_log_likelihood_is_that_of_von_mises():
    heading = np.linspace(-9.0, 9.0, 61)
    x, y = (3.0, -2.0, heading), (3.1, -0.4)
    exact = sum(
        stats.vonmises.logpdf(value - (math.atan2(north + 2, east - 3) - heading), 30.0)
        for value, (east, north) in zip(y, BEACONS, strict=True)
    )
    np.testing.assert_allclose(MODEL.log_likelihood(y, x, 0, MODEL.p), exact, rtol=1e-10)


@pytest.mark.zoo
def test_where_the_position_is_known_the_filter_is_that_on_the_circle():
    # The robot stands still and turns, so the directions of both beacons are known. The product of
    # two von Mises densities is one, whose concentration is the length of the sum of two vectors.
    changes = {"position_sd": 0.0, "speed": 0.0, "speed_sd": 0.0, "concentration": 3.0}
    turning = {"bend": 0.0, "turn_rate": 0.1, "slip": 2.0, "drift_sd": 0.1}
    model = MODEL.with_parameters(changes | turning)
    times = (2, 5, 6)
    draws = simulate(model, 8, range(2000), 3)
    bearings = [math.atan2(north, east) for east, north in BEACONS]
    vectors = sum(np.exp(1j * (bearing - draws.y[:, :, k])) for k, bearing in enumerate(bearings))
    believed = SimpleNamespace(
        p=SimpleNamespace(drift=model.p.turn_rate, turn_sd=0.3, concentration=3.0 * np.abs(vectors))
    )
    mean, variance = circle_filter(believed, np.angle(vectors), times)
    exact = 1 - np.cos(draws.z[:, :, 0] - mean)
    assert_mean(exact.mean(axis=1) - variance.mean(axis=1))
    filtered = filter_draws(model, draws, times, 2000, 1, trajectories=True)
    # Before the first measurement the heading is uniform, and every estimate is as good.
    error = 1 - np.cos(draws.z[:, :, 0] - filtered.estimate[:, :, 0])
    difference = (error - exact)[:, times[0] :].mean(axis=1)
    standard_error = difference.std() / np.sqrt(difference.size)
    assert abs(difference.mean()) < 4.5 * standard_error + 10 * exact.mean() / 2000
    apart = 1 - np.cos(filtered.estimate[:, list(times), 0] - mean[:, list(times)])
    assert apart.mean() < 2e-3


@pytest.mark.zoo
def test_the_first_heading_is_not_known_at_all():
    # The resultant of P uniform directions is nearly 0: the error is 1 at every instant.
    draws = simulate(MODEL, 6, range(4000), 2)
    assert_mean(filter_draws(MODEL, draws, (), 200, 1).mse, 1.0)
