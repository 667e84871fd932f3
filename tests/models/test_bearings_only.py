import math

import numpy as np
import pytest
from scipy import special, stats

from pfdist.models import load_model

MODEL = load_model("bearings_only")
KNOT = 1.852 / 60  # km a minute
EAST, SOUTH = math.pi / 2, math.pi
TURNING = {"observer_speed": 1.0, "first_course": EAST, "second_course": 0.0, "turn": 15.0}


def test_the_target_starts_at_80_degrees_and_comes_nearer():
    sine, cosine = 0.984807753012208, 0.17364817766693041  # of 80 degrees
    expected = (5 * sine, 5 * cosine, -4 * KNOT * sine, -4 * KNOT * cosine)
    assert MODEL.initial((0.5, 0.0, 0.5, 0.5), MODEL.p) == pytest.approx(expected, rel=1e-12)
    east, north, *velocity = MODEL.initial((1.0, 2.0, 0.0, 0.5), MODEL.p)
    farthest = (5 + 2 * math.sqrt(3)) * np.exp(1j * math.radians(83))
    assert complex(north, east) == pytest.approx(farthest, rel=1e-12)
    assert math.hypot(*velocity) == pytest.approx((4 - 2 * math.sqrt(3)) * KNOT, rel=1e-12)


def test_the_transition_is_gordons():  # x + v + a/2, v + a
    p = MODEL.with_parameters({"acceleration_sd": 0.5}).p
    following = MODEL.transition((1.0, 2.0, 0.1, -0.2), 3, (1.0, -2.0), p)
    assert following == pytest.approx((1.35, 1.3, 0.6, -1.2), rel=1e-12)


@pytest.mark.parametrize(
    ("t", "place"), [(0, (0.0, 0.0)), (7, (7.0, 0.0)), (15, (15.0, 0.0)), (20, (15.0, 5.0))]
)
def test_the_bearing_is_clockwise_from_north_where_the_observer_is(t, place):
    p = MODEL.with_parameters(TURNING | {"bearing_sd": 0.01}).p
    for east, north, bearing in ((3.0, 4.0, math.atan(0.75)), (1.0, 0.0, EAST), (-2.0, 0.0, -EAST)):
        x = (place[0] + east, place[1] + north, 0.0, 0.0)
        assert MODEL.measurement(x, t, (2.0,), p) == pytest.approx((bearing + 0.02,), rel=1e-12)
        assert MODEL.quantity_of_interest(x, t, p) == x[:2]


def test_the_measurement_is_wrapped():
    p = MODEL.with_parameters({"bearing_sd": 0.1}).p
    for v, bearing in ((0.0, SOUTH), (1.0, 0.1 - SOUTH), (-1.0, SOUTH - 0.1)):
        measured = MODEL.measurement((0.0, -1.0, 0.0, 0.0), 0, (v,), p)
        assert measured == pytest.approx((bearing,), rel=1e-12)


@pytest.mark.parametrize("sd", [math.radians(1.5), 1.0])
@pytest.mark.parametrize("y", [-3.0, 0.5, 3.1])
def test_log_likelihood_is_that_of_a_wrapped_normal_but_for_what_comes_round(y, sd):
    p = MODEL.with_parameters({"bearing_sd": sd}).p
    bearing = np.linspace(-3.14, 3.14, 101)
    x = (np.sin(bearing), np.cos(bearing), 0.0, 0.0)
    wound = (y - bearing)[:, None] + 2 * np.pi * np.arange(-9, 10)
    exact = special.logsumexp(stats.norm.logpdf(wound, scale=sd), axis=1)
    difference = exact - stats.norm.logpdf(0.0, scale=sd) - MODEL.log_likelihood((y,), x, 0, p)
    # The nearest other turn weighs exp(-2 pi (pi - |d|) / sd^2) of this one, the rest of them less;
    # rounding of values up to 0.5 * (pi / sd)^2 = 7200.
    d = np.abs(np.angle(np.exp(1j * (y - bearing))))
    assert (difference > -1e-11).all()
    assert (difference < np.log1p(2 * np.exp(-2 * np.pi * (np.pi - d) / sd**2)) + 1e-11).all()
