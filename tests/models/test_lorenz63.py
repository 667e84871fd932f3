import numpy as np
import pytest
from scipy import stats
from scipy.integrate import solve_ivp

from pfdist.models import load_model

MODEL = load_model("lorenz63")
SIGMA, RHO, BETA = 10.0, 28.0, 8 / 3
SUBSTEPS = 10
START = np.array([1.508870, -1.531271, 25.46091])


def velocity(x):  # Lorenz 1963, equations 25 to 27
    a, b, c = x
    return np.array([SIGMA * (b - a), RHO * a - b - a * c, a * b - BETA * c])


def after(time, x, transitions):
    """The state that much later without noise, by so many transitions."""
    p = MODEL.with_parameters({"step": time / transitions}).p
    for _ in range(transitions):
        x = MODEL.transition(x, 0, (0.0,) * 3 * SUBSTEPS, p)
    return np.array(x)


def test_a_transition_is_ten_euler_maruyama_steps():
    p = MODEL.with_parameters({"step": 0.08, "diffusion": 3.0}).p
    w = np.random.default_rng(1).standard_normal((SUBSTEPS, 3))
    x = START
    for pushed in w:
        x = x + 0.008 * velocity(x) + 3 * np.sqrt(0.008) * pushed
    following = MODEL.transition(tuple(START), 5, tuple(w.ravel()), p)
    assert following == pytest.approx(tuple(x), rel=1e-12)


def test_the_start_is_normal_around_a_known_point():
    w = (1.0, -0.5, 2.0)
    first = MODEL.initial(w, MODEL.p)
    assert first == pytest.approx(tuple(START + np.sqrt(2) * np.array(w)), rel=1e-6)


@pytest.mark.parametrize("x", [(0.0, 0.0, 0.0), (9.0, 9.0, 27.0), (-9.0, -9.0, 27.0)])
def test_the_fixed_points_stay_where_they_are(x):  # +-sqrt(beta (rho - 1)), rho - 1
    p = MODEL.with_parameters({"beta": 3.0}).p
    assert MODEL.transition(x, 0, (0.0,) * 3 * SUBSTEPS, p) == x


def test_without_noise_it_approaches_the_equations_solution_in_the_first_order():
    exact = solve_ivp(lambda _, x: velocity(x), (0, 0.5), START, "DOP853", rtol=1e-12, atol=1e-12)
    errors = [np.abs(after(0.5, START, n) - exact.y[:, -1]) for n in (40, 80, 160)]
    # An error c h + d h^2: the ratio at half the step is 2 + O(h), and the O(h) is halved as well.
    first, second = errors[0] / errors[1] - 2, errors[1] / errors[2] - 2
    assert (np.abs(second) < 0.1).all()
    np.testing.assert_allclose(first / second, 2, atol=0.3)


@pytest.mark.parametrize("y", [-9.0, 0.0, 3.5])
def test_log_likelihood_is_that_of_the_measurement_up_to_a_constant(y):
    x = np.linspace(-20, 20, 101)
    exact = stats.norm.logpdf(y, loc=x, scale=np.sqrt(2))
    # Rounding of values up to 0.25 * 29^2 = 210.
    assert np.ptp(MODEL.log_likelihood((y,), (x, 0.0, 0.0), 3, MODEL.p) - exact) < 1e-11


def test_the_first_component_is_measured_and_the_state_is_wanted():
    x = (1.0, 2.0, 3.0)
    assert MODEL.measurement(x, 4, (-2.0,), MODEL.p) == pytest.approx((1 - 2 * np.sqrt(2),))
    assert MODEL.quantity_of_interest(x, 4, MODEL.p) == x
