import math

import numpy as np
import pytest
from scipy import stats

from pfdist.errors import ModelError
from pfdist.filters.particle_filter import filter_draws
from pfdist.filters.simulation import simulate
from pfdist.models import load_model
from pfdist.times.measurement_times import regular

MODEL = load_model("ungm_gordon")


def assert_mean(values, expected):  # of independent values, within 4.5 standard errors
    assert abs(values.mean() - expected) < 4.5 * values.std() / np.sqrt(values.size)


# x(t+1) = x/2 + 25 x / (1 + x^2) + 8 cos(1.2 t) + w, w ~ N(0, 10); y = x^2 / 20 + v, v ~ N(0, 1).
def test_formulas_at_a_point():
    p = MODEL.p
    assert MODEL.initial((2.0,), p) == pytest.approx((2 * math.sqrt(2),), rel=1e-12)
    following = (1 + 10 + 8 * math.cos(3.6) + 2 * math.sqrt(10),)
    assert MODEL.transition((2.0,), 3, (2.0,), p) == pytest.approx(following, rel=1e-12)
    assert MODEL.quantity_of_interest((3.25,), 7, p) == (3.25,)
    for t in (0, 3, 60):  # the measurement's variance does not depend on t
        assert MODEL.measurement((-10.0,), t, (1.5,), p) == pytest.approx((6.5,), rel=1e-12)


@pytest.mark.parametrize("sd", [1.0, 0.5])
@pytest.mark.parametrize("y", [-3.0, 0.0, 11.5])
def test_log_likelihood_is_that_of_the_measurement_up_to_a_constant(y, sd):
    p = MODEL.with_parameters({"measurement_sd": sd}).p
    x = np.linspace(-25, 25, 101)
    exact = stats.norm.logpdf(y, loc=x**2 / 20, scale=sd)
    # Rounding of values up to 0.5 * (34 / 0.5)^2 = 2400.
    assert np.ptp(MODEL.log_likelihood((y,), (x,), 4, p) - exact) < 1e-11


def test_simulated_draws_have_gordons_variances():
    draws = simulate(MODEL, 1, range(100_000), 5)
    before, after = draws.x[:, :, 0].T
    pushed = after - before / 2 - 25 * before / (1 + before**2) - 8
    noise = draws.y[:, :, 0] - draws.x[:, :, 0] ** 2 / 20
    for values, variance in ((before, 2.0), (pushed, 10.0), (noise[:, 0], 1.0), (noise[:, 1], 1.0)):
        assert_mean(values, 0.0)
        assert_mean(values**2, variance)
    assert_mean(pushed * before, 0.0)


@pytest.mark.zoo
def test_measurements_help():
    draws = simulate(MODEL, 60, range(1000), 1)
    nothing, some, everything = (
        filter_draws(MODEL, draws, times, 500, 1).mse for times in ((), regular(60, 21), range(61))
    )
    for worse, better in ((nothing, some), (some, everything)):
        gain = worse - better
        assert gain.mean() > 4.5 * gain.std() / np.sqrt(gain.size)


@pytest.mark.parametrize(("name", "value"), [("process_sd", -1.0), ("measurement_sd", 0.0)])
def test_a_deviation_has_its_range(name, value):
    with pytest.raises(ModelError, match=f"ungm_gordon: parameter {name} must .*got {value}"):
        MODEL.with_parameters({name: value})
