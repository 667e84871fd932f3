import numpy as np
import pytest
from scipy import stats
from scipy.integrate import solve_ivp

from oracles.moments import assert_mean
from pfdist.filters.simulation import simulate
from pfdist.models import load_model

MODEL = load_model("lotka_volterra")
BIRTH, PREDATION, DEATH = 0.5, 0.0025, 0.3
SUBSTEPS = 10
START = np.array([71.0, 79.0])
STOICHIOMETRY = np.array([[1, -1, 0], [0, 1, -1]])  # of a birth, a meal and a death
SILENT = (0.0,) * 3 * SUBSTEPS


def rates(x):
    return np.array([BIRTH * x[0], PREDATION * x[0] * x[1], DEATH * x[1]])


def conserved(x):
    return PREDATION * (x[0] + x[1]) - DEATH * np.log(x[0]) - BIRTH * np.log(x[1])


def after(time, x, transitions):
    """The populations that much later without noise, by so many transitions."""
    p = MODEL.with_parameters({"step": time / transitions}).p
    for _ in range(transitions):
        x = MODEL.transition(x, 0, SILENT, p)
    return np.array(x)


def test_a_transition_is_ten_euler_maruyama_steps_of_the_chemical_langevin_equation():
    p = MODEL.with_parameters({"step": 2.0}).p
    w = np.random.default_rng(1).standard_normal((SUBSTEPS, 3))
    x = START
    for noise in w:
        x = x + STOICHIOMETRY @ (0.2 * rates(x) + np.sqrt(0.2 * rates(x)) * noise)
    following = MODEL.transition(tuple(START), 5, tuple(w.ravel()), p)
    assert following == pytest.approx(tuple(x), rel=1e-12)


def test_the_equilibrium_stays_where_it_is():
    x = (DEATH / PREDATION, BIRTH / PREDATION)
    assert MODEL.transition(x, 0, SILENT, MODEL.p) == pytest.approx(x, rel=1e-12)


def assert_first_order(errors):
    # An error c h + d h^2: the ratio at half the step is 2 + O(h), and the O(h) is halved as well.
    first, second = errors[0] / errors[1] - 2, errors[1] / errors[2] - 2
    assert (np.abs(second) < 0.1).all()
    np.testing.assert_allclose(first / second, 2, atol=0.3)


def test_without_noise_it_approaches_the_equations_solution_in_the_first_order():
    exact = solve_ivp(
        lambda _, x: STOICHIOMETRY @ rates(x), (0, 10), START, "DOP853", rtol=1e-12, atol=1e-12
    )
    assert_first_order([np.abs(after(10, START, n) - exact.y[:, -1]) for n in (50, 100, 200)])


def test_without_noise_volterras_integral_is_conserved_up_to_the_first_order():
    before = conserved(START)
    assert_first_order([abs(conserved(after(20, START, n)) - before) for n in (200, 400, 800)])


def test_without_predation_draws_have_the_moments_of_births_and_of_deaths():
    # With g = 1 + rate h a substep of length h makes of a mean m and a variance v the mean g m and
    # the variance g^2 v + |rate| h m:
    # after n, m = g^n x and v = |rate| h x g^(n-1) (g^n - 1) / (g - 1).
    alone = MODEL.with_parameters({"predation": 0.0, "initial_sd": 0.0})
    populations = simulate(alone, 3, range(100_000), 5).x[:, 3].T
    for start, rate, population in zip(START, (BIRTH, -DEATH), populations, strict=True):
        growth = 1 + rate / SUBSTEPS
        mean = start * growth**30
        variance = start * growth**29 * (growth**30 - 1) * np.sign(rate)
        assert_mean(population, mean)
        assert_mean((population - mean) ** 2, variance)


def test_a_population_does_not_fall_below_one():
    few = MODEL.transition((1.5, 1.2), 0, (-9.0, 9.0, 9.0) * SUBSTEPS, MODEL.p)
    assert few[0] == 1.0
    assert MODEL.transition((1.5, 1.2), 0, (-9.0, -9.0, 9.0) * SUBSTEPS, MODEL.p)[1] == 1.0
    wide = MODEL.with_parameters({"initial_sd": 9.0}).p
    assert MODEL.initial((-9.0, -9.0), wide) == (1.0, 1.0)


def test_the_first_populations_are_log_normal():
    first = MODEL.initial((1.0, -2.0), MODEL.with_parameters({"initial_sd": 0.5}).p)
    assert first == pytest.approx(tuple(START * np.exp([0.5, -1.0])), rel=1e-12)


def test_the_logarithm_of_the_prey_is_measured_and_both_are_wanted():
    x = (np.exp(3.0), np.exp(5.0))
    assert MODEL.measurement(x, 4, (-2.0,), MODEL.p) == pytest.approx((3 - 2 * 0.1,), rel=1e-12)
    assert MODEL.quantity_of_interest(x, 4, MODEL.p) == pytest.approx((3.0, 5.0), rel=1e-12)


@pytest.mark.parametrize("count", [1.0, 30.0, 300.0])
def test_log_likelihood_is_that_of_a_log_normal_count_up_to_a_constant(count):
    prey = np.geomspace(1, 1000, 101)
    exact = stats.lognorm.logpdf(count, 0.1, scale=prey)
    value = MODEL.log_likelihood((np.log(count),), (prey, 50.0), 3, MODEL.p)
    # Rounding of values up to 0.5 * (log(1000) / 0.1)^2 = 2400.
    assert np.ptp(value - exact) < 1e-11
