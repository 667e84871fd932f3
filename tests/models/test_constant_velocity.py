import math

import numpy as np
import pytest
from scipy import special, stats

from pfdist.models import load_model

MODEL = load_model("constant_velocity")


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
