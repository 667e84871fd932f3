"""The paper's model, and that of Gordon, Salmond and Smith with constant variances."""

import math

import numpy as np
import pytest
from scipy import stats

from oracles.moments import assert_mean
from pfdist.filters.simulation import simulate
from pfdist.models import load_model

MODEL, GORDON = load_model("ungm"), load_model("ungm_gordon")


# Paper, equation 9: x(t+1) = x(t)/2 + 25 x(t) / (1 + x(t)^2) + 8 cos(1.2 t) + w(t), w ~ N(0, 1).
@pytest.mark.parametrize(
    ("x", "t", "w", "following"),
    [
        (0.0, 0, 0.0, 8.0),
        (2.0, 0, 0.0, 1 + 10 + 8),
        (-2.0, 0, 0.0, -1 - 10 + 8),
        (1.0, 5, -0.5, 0.5 + 12.5 + 7.681362293202929 - 0.5),  # cos 6 = 0.960170286650366
        (3.0, 60, 1.0, 1.5 + 7.5 - 7.738004706191059 + 1),  # cos 72 = -0.967250588273882
    ],
)
def test_transition_is_the_papers(x, t, w, following):
    (value,) = MODEL.transition((x,), t, (w,), MODEL.p)
    assert value == pytest.approx(following, rel=1e-12)


# Paper, equation 10: y(t) = x(t)^2 / 20 + v(t), v ~ N(0, (sin(0.25 t) + 2)^2).
@pytest.mark.parametrize(
    ("x", "t", "v", "measured"),
    [
        (10.0, 0, 0.0, 5.0),
        (10.0, 0, 1.0, 5 + 2),
        (-10.0, 0, 1.0, 5 + 2),
        (2.0, 4, 1.0, 0.2 + 2.8414709848078965),  # sin 1 = 0.8414709848078965
        (2.0, 60, -2.0, 0.2 - 2 * 2.650287840157117),  # sin 15 = 0.650287840157117
    ],
)
def test_measurement_is_the_papers(x, t, v, measured):
    (value,) = MODEL.measurement((x,), t, (v,), MODEL.p)
    assert value == pytest.approx(measured, rel=1e-12)


def test_the_rest_is_the_papers_and_every_noise_is_one_normal():
    assert MODEL.initial((-1.5,), MODEL.p) == (-7.5,)  # Equation 12: x(0) ~ N(0, 5^2).
    assert MODEL.quantity_of_interest((3.25,), 7, MODEL.p) == (3.25,)  # Equation 11: z(t) = x(t).
    noises = MODEL.initial_noise, MODEL.process_noise, MODEL.measurement_noise
    assert noises == (("normal",),) * 3


def test_deviations_multiply_the_noise():
    p = MODEL.with_parameters({"initial_sd": 0.0, "process_sd": 3.0, "measurement_sd": 0.5}).p
    assert MODEL.initial((2.0,), p) == (0.0,)
    assert MODEL.transition((0.0,), 0, (1.0,), p) == (8 + 3,)
    assert MODEL.measurement((0.0,), 0, (1.0,), p) == (0.5 * 2,)
    assert MODEL.log_likelihood((1.0,), (0.0,), 0, p) == -0.5


# x(t+1) = x/2 + 25 x / (1 + x^2) + 8 cos(1.2 t) + w, w ~ N(0, 10); y = x^2 / 20 + v, v ~ N(0, 1).
def test_gordons_formulas_at_a_point():
    p = GORDON.p
    assert GORDON.initial((2.0,), p) == pytest.approx((2 * math.sqrt(2),), rel=1e-12)
    following = (1 + 10 + 8 * math.cos(3.6) + 2 * math.sqrt(10),)
    assert GORDON.transition((2.0,), 3, (2.0,), p) == pytest.approx(following, rel=1e-12)
    assert GORDON.quantity_of_interest((3.25,), 7, p) == (3.25,)
    for t in (0, 3, 60):  # the measurement's variance does not depend on t
        assert GORDON.measurement((-10.0,), t, (1.5,), p) == pytest.approx((6.5,), rel=1e-12)


@pytest.mark.parametrize("y", [-3.0, 0.0, 11.5])
def test_log_likelihoods_are_those_of_the_measurements_up_to_a_constant(y):
    x = np.linspace(-25, 25, 101)
    half = GORDON.with_parameters({"measurement_sd": 0.5})
    cases = [(MODEL, t, math.sin(0.25 * t) + 2) for t in (0, 4, 19, 60)]
    for model, t, sd in [*cases, (GORDON, 4, 1.0), (half, 4, 0.5)]:
        exact = stats.norm.logpdf(y, loc=x**2 / 20, scale=sd)
        # Rounding of values up to 0.5 * (34 / 0.5)^2 = 2400.
        assert np.ptp(model.log_likelihood((y,), (x,), t, model.p) - exact) < 1e-11


def test_simulated_draws_have_gordons_variances():
    draws = simulate(GORDON, 1, range(100_000), 5)
    before, after = draws.x[:, :, 0].T
    pushed = after - before / 2 - 25 * before / (1 + before**2) - 8
    noise = draws.y[:, :, 0] - draws.x[:, :, 0] ** 2 / 20
    for values, variance in ((before, 2.0), (pushed, 10.0), (noise[:, 0], 1.0), (noise[:, 1], 1.0)):
        assert_mean(values, 0.0)
        assert_mean(values**2, variance)
    assert_mean(pushed * before, 0.0)
