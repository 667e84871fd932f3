import math

import numpy as np
import pytest
from scipy import stats

from pfdist.errors import ModelError
from pfdist.models import load_model

MODEL = load_model("ungm")


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


@pytest.mark.parametrize("t", [0, 4, 19, 60])
@pytest.mark.parametrize("y", [-3.0, 0.0, 11.5])
def test_log_likelihood_is_that_of_the_measurement_up_to_a_constant(t, y):
    x = np.linspace(-25, 25, 101)
    exact = stats.norm.logpdf(y, loc=x**2 / 20, scale=math.sin(0.25 * t) + 2)
    difference = MODEL.log_likelihood((y,), (x,), t, MODEL.p) - exact
    # Rounding of values up to 0.5 * (34 / 1)^2 = 600.
    assert np.ptp(difference) < 1e-11


def test_the_first_state_has_the_papers_deviation():  # Paper, equation 12: x(0) ~ N(0, 5^2).
    assert MODEL.initial((-1.5,), MODEL.p) == (-7.5,)


def test_the_quantity_of_interest_is_the_state():  # Paper, equation 11: z(t) = x(t).
    assert MODEL.quantity_of_interest((3.25,), 7, MODEL.p) == (3.25,)


@pytest.mark.parametrize("noise", ["initial_noise", "process_noise", "measurement_noise"])
def test_every_noise_is_one_normal(noise):
    assert getattr(MODEL, noise) == ("normal",)


def test_deviations_multiply_the_noise():
    p = MODEL.with_parameters({"initial_sd": 0.0, "process_sd": 3.0, "measurement_sd": 0.5}).p
    assert MODEL.initial((2.0,), p) == (0.0,)
    assert MODEL.transition((0.0,), 0, (1.0,), p) == (8 + 3,)
    assert MODEL.measurement((0.0,), 0, (1.0,), p) == (0.5 * 2,)
    assert MODEL.log_likelihood((1.0,), (0.0,), 0, p) == -0.5


@pytest.mark.parametrize(
    ("name", "value"), [("initial_sd", -1.0), ("process_sd", -1.0), ("measurement_sd", 0.0)]
)
def test_a_deviation_cannot_be_negative_nor_that_of_a_measurement_zero(name, value):
    with pytest.raises(ModelError, match=f"{name}.*got {value}"):
        MODEL.with_parameters({name: value})
