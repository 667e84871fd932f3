import math

import numpy as np
import pytest
from scipy import stats

from pfdist.models import load_model

MODEL = load_model("stochastic_volatility")


def test_formulas_at_a_point():
    p = MODEL.with_parameters({"mu": 1.0, "phi": 0.6, "sigma": 2.0}).p
    assert MODEL.initial((2.0,), p) == pytest.approx((1 + 2 / 0.8 * 2,), rel=1e-12)
    assert MODEL.transition((3.0,), 4, (-1.0,), p) == pytest.approx((1 + 0.6 * 2 - 2,), rel=1e-12)
    x = (2 * math.log(3),)  # exp(x/2) = 3
    assert MODEL.measurement(x, 4, (-0.5,), p) == pytest.approx((-1.5,), rel=1e-12)
    assert MODEL.quantity_of_interest(x, 4, p) == pytest.approx((3.0,), rel=1e-12)


@pytest.mark.parametrize("y", [-4.0, 0.0, 0.3])
def test_log_likelihood_is_that_of_the_measurement_up_to_a_constant(y):
    x = np.linspace(-5, 3, 101)
    exact = stats.norm.logpdf(y, scale=np.exp(x / 2))
    # Rounding of values up to 0.5 * 16 * e^5 = 1200.
    assert np.ptp(MODEL.log_likelihood((y,), (x,), 3, MODEL.p) - exact) < 1e-11
