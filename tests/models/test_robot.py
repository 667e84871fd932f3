"""The robot's formulas at points, its likelihood, and its filter against a filter on the circle."""

import math

import numpy as np
import pytest
from scipy import stats

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


def test_the_first_heading_is_anywhere():
    p = MODEL.with_parameters({"position_sd": 0.5}).p
    first = MODEL.initial((1.0, -2.0, 0.25), p)
    assert first == pytest.approx((0.5, -1.0, math.pi / 2), rel=1e-12)


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
