import numpy as np
import pytest
from scipy import stats

from pfdist.common.measurement_times import regular
from pfdist.filters.particle_filter import filter_draws
from pfdist.filters.simulation import simulate
from pfdist.models import load_model

TRUTH = load_model("tumour")
FILTER = TRUTH.with_parameters({"frequency_sd": 0.005})
BOX = ((8.8, 24.0), (0.52, 0.84), (-5.8, 5.8))


@pytest.mark.parametrize(
    ("shares", "state"),
    [((0.0, 0.5, 1.0), (8.8, 0.68, 5.8)), ((1.0, 0.0, 0.5), (24.0, 0.52, 0.0))],
)
def test_the_first_state_fills_the_box(shares, state):
    assert TRUTH.initial(shares, TRUTH.p) == pytest.approx(state, rel=1e-12)


def test_the_position_is_a_sine_with_time_in_steps():
    x = (10.0, 0.6, 2.0)
    expected = 10 * 0.1411200080598672 + 2  # sin(0.6 * 5)
    assert TRUTH.quantity_of_interest(x, 5, TRUTH.p) == pytest.approx((expected,), rel=1e-12)
    assert TRUTH.measurement(x, 5, (-1.5,), TRUTH.p) == pytest.approx((expected - 1.5,), rel=1e-12)


@pytest.mark.parametrize(
    ("model", "x", "w", "following"),
    [
        (TRUTH, (10.0, 0.6, 2.0), (0.5, 3.0, -1.0), (10.5, 0.6, 1.0)),
        (FILTER, (10.0, 0.6, 2.0), (0.5, 3.0, -1.0), (10.5, 0.615, 1.0)),
        (FILTER, (23.5, 0.839, 5.0), (1.0, 1.0, 1.0), (24.0, 0.84, 5.8)),
        (FILTER, (9.0, 0.521, -5.0), (-1.0, -1.0, -1.0), (8.8, 0.52, -5.8)),
    ],
)
def test_the_state_walks_and_stays_in_the_box(model, x, w, following):
    assert model.transition(x, 3, w, model.p) == pytest.approx(following, rel=1e-12)


@pytest.mark.parametrize("sd", [1.0, 0.5])
def test_log_likelihood_is_that_of_the_measurement_up_to_a_constant(sd):
    p = TRUTH.with_parameters({"measurement_sd": sd}).p
    x = tuple(np.linspace(low, high, 101) for low, high in BOX)
    (z,) = TRUTH.quantity_of_interest(x, 7, p)
    exact = stats.norm.logpdf(3.0, loc=z, scale=sd)
    # Rounding of values up to 0.5 * (33 / 0.5)^2 = 2200.
    assert np.ptp(TRUTH.log_likelihood((3.0,), x, 7, p) - exact) < 1e-11


# The authors' figures are of 100,000 draws, with 1,000 particles and multinomial resampling. So
# are these, because the bias is not small: against 5,000 particles 1,000 cost 1.8 % more with the
# regular times, 500 cost 4 % more, 200 17 %, 100 63 %.
@pytest.mark.zoo
@pytest.mark.parametrize(
    ("times", "authors", "again", "error"),
    [
        (regular(30, 11), 8.25, 8.14, 0.13),
        ((1, 4, 6, 8, 10, 12, 15, 20, 22, 24, 27), 5.148, 5.16, 0.07),
    ],
)
def test_the_expected_mse_is_the_authors(times, authors, again, error):
    draws = simulate(TRUTH, 30, range(10_000), 2022)
    mse = filter_draws(FILTER, draws, times, 1000, 1).mse
    of_the_mean = mse.std() / np.sqrt(mse.size)
    assert abs(mse.mean() - authors) < 3.5 * np.hypot(of_the_mean, mse.std() / np.sqrt(100_000))
    assert abs(mse.mean() - again) < 3.5 * np.hypot(of_the_mean, error)
