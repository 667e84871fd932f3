"""Draws: quantiles against the distribution, other transforms against their distribution."""

import inspect

import numpy as np
import pytest
from scipy import integrate, special, stats

from oracles.computed import formula
from oracles.in_turn import in_turn
from pfdist import densities
from pfdist.densities import DENSITIES, gamma_draw, laplace_draw, von_mises_draw
from pfdist.kernels.variates import variates
from pfdist.models.tracing import Formula, trace

RNG = np.random.default_rng(2)
COUNT = 300
# Centred noise: in the middle, and towards both ends as far as 2^-43; SciPy's quantiles go no
# further.
U = np.concatenate([RNG.uniform(-0.5, 0.5, COUNT), 2.0 ** -RNG.uniform(1, 43, COUNT)])
U[::2] *= -1
LOW, HIGH = np.where(U < 0, 1 + U, U), np.where(U < 0, -U, 1 - U)
pytestmark = pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of values that are not chosen


def sizes(low, high):
    return 10.0 ** RNG.uniform(low, high, U.size)


def assert_has_tails(below, above, error):
    """The probabilities on both sides of a quantile are those of u; the smaller one is precise."""
    ratio = np.where(LOW < HIGH, below / LOW, above / HIGH)
    np.testing.assert_allclose(ratio, 1, rtol=error)


@pytest.mark.parametrize("exponents", [(-2, 0), (0, 2), (2, 4)])
def test_a_gamma_draw_is_the_quantile(exponents):
    shape = sizes(*exponents)
    x = gamma_draw(U, shape, 3.0) / 3
    seen = x > 1e-290  # smaller quantiles of small shapes underflow
    assert seen.mean() > 0.6
    below, above = special.gammainc(shape, x), special.gammaincc(shape, x)
    assert_has_tails(np.where(seen, below, LOW), np.where(seen, above, HIGH), 1e-9)


def test_a_laplace_draw_is_the_quantile():
    x = (laplace_draw(U, 2.0, 0.5) - 2) / 0.5
    assert_has_tails(stats.laplace.cdf(x), stats.laplace.sf(x), 1e-12)


@pytest.mark.parametrize("concentration", [0.0, 0.01, 1.0, 30.0, 1e4])
def test_a_von_mises_draw_is_the_quantile(concentration):
    some = np.abs(U) > 1e-9  # the integral has an absolute error
    angles = von_mises_draw(U[some], 0.7, concentration) - 0.7
    assert np.abs(angles).max() <= np.pi

    def density(angle):
        return np.exp(concentration * (np.cos(angle) - 1)) / special.i0e(concentration) / 2 / np.pi

    for angle, tail in zip(np.abs(angles)[::9], np.minimum(LOW, HIGH)[some][::9], strict=True):
        end = min(np.pi, angle + 12 / np.sqrt(concentration + 1e-9))
        beyond = integrate.quad(density, angle, end, epsabs=1e-16, epsrel=1e-10)[0]
        assert beyond == pytest.approx(tail, rel=1e-6)


COUNTS = {
    "poisson": (lambda k, m: (stats.poisson.cdf(k, m), stats.poisson.sf(k, m)), sizes(-6, 5)),
    "binomial": (
        lambda k, n, p: (stats.binom.cdf(k, n, p), stats.binom.sf(k, n, p)),
        np.floor(sizes(0, 5)),
        special.expit(RNG.uniform(-11, 11, U.size)),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", COUNTS)
def test_a_draw_of_a_count_is_the_smallest_count_whose_probability_reaches_u(name):
    tails_of, *parameters = COUNTS[name]
    k = DENSITIES[name].draw(U, *parameters)
    (below, above), (before, after) = tails_of(k, *parameters), tails_of(k - 1, *parameters)
    slack = 1e-9  # of both probabilities
    reaches = np.where(LOW < HIGH, below > LOW * (1 - slack), above < HIGH * (1 + slack))
    smallest = np.where(LOW < HIGH, before < LOW * (1 + slack), after > HIGH * (1 - slack))
    assert reaches.all()
    assert (smallest | (k == 0)).all()
    assert np.ptp(k) > 100


def test_the_quantile_of_a_large_count_is_exact():
    """Counts with deviations of up to 5,000; the slack is SciPy's error."""
    n, p = np.floor(sizes(7, 8)), RNG.uniform(0.1, 0.9, U.size)
    k, near = densities.binomial_draw(U, n, p), np.abs(U) > 1e-5
    below, before = (stats.binom.cdf(each, n, p) for each in (k, k - 1))
    assert ((before < LOW + 1e-9) & (below > LOW - 1e-9))[near].all()


@pytest.mark.parametrize(("name", "most"), [("binomial", 1900), ("poisson", 1300)])
def test_a_count_has_few_operations(name, most):
    """One exact tail each: with three tails, they were 4,727 and 2,185, and took thrice as long."""
    draw = DENSITIES[name].draw
    given = Formula(
        lambda x, p: draw(*x), "a formula", {"x": 3 - (name == "poisson"), "p": 0}, {}, "a model"
    )
    (program,) = trace(given, range(1)).programs
    assert len(program.operations) < most


def test_counts_that_are_certain():
    assert densities.poisson_draw(U, 0.0).tolist() == [0] * U.size
    for n, p, k in ((5.0, 0.0, 0), (5.0, 1.0, 5), (0.0, 0.3, 0)):
        assert densities.binomial_draw(U, n, p).tolist() == [k] * U.size


def test_a_category_is_the_quantile_of_its_number():
    weights = (1.0, 0.0, 5.0, 2.0)
    ends = np.cumsum(weights)[:-1] / 8
    found = densities.categorical_draw(U, weights)
    np.testing.assert_array_equal(found, np.searchsorted(ends, LOW))
    draws = tuple(np.full(U.size, 10.0 * k) for k in range(4))
    np.testing.assert_array_equal(densities.mixture_draw(U, draws, weights), 10 * found)


W = tuple(variates("normal", 40_000, 1, 0, 0, 0, component) for component in range(2))
V = tuple(variates("centred", 40_000, 1, 0, 0, 1, component) for component in range(2))
TRANSFORMS = {
    "normal": (stats.norm(2, 3), (2.0, 3.0)),
    "lognormal": (stats.lognorm(0.5, scale=np.exp(1)), (1.0, 0.5)),
    "student_t": (stats.t(3, 1, 2), (3.0, 1.0, 2.0)),
    "beta": (stats.beta(0.3, 2), (0.3, 2.0)),
    "negative_binomial": (stats.nbinom(2, 2 / 12), (10.0, 2.0)),
}


@pytest.mark.parametrize("name", TRANSFORMS)
def test_a_transform_has_its_distribution(name):
    distribution, parameters = TRANSFORMS[name]
    noise = DENSITIES[name].noise
    given = (W if noise[0] == "normal" else V)[: len(noise)]
    x = DENSITIES[name].draw(*given, *parameters)
    if name != "negative_binomial":
        assert stats.kstest(x, distribution.cdf).pvalue > 1e-3
        return
    counts = np.arange(45)
    expected = x.size * distribution.pmf(counts)  # at least 5 in each class
    squares = ((x[:, None] == counts).sum(axis=0) - expected) ** 2 / expected
    assert expected.min() > 5
    assert stats.chi2(counts.size - 1).sf(squares.sum()) > 1e-3


@pytest.mark.parametrize("power", [30, 50])
def test_centred_noise_reaches_where_uniform_noise_ends(power):
    """Quantiles of both ends, beyond the 2^-24 at which uniform noise ends."""
    u = 2.0**-power
    assert laplace_draw(np.array([u, -u]), 0.0, 1.0).tolist() == pytest.approx(
        [(1 - power) * np.log(2), (power - 1) * np.log(2)], rel=1e-14
    )
    assert gamma_draw(-u, 1.0, 1.0) == pytest.approx(power * np.log(2), rel=1e-12)
    assert gamma_draw(u, 1.0, 1.0) == pytest.approx(u, rel=1e-12)
    # Bailey's: 1 + t^2 / df = u^(-2 / df) where the second variate is 0.
    assert densities.student_t_draw(u, 0.0, 3.0, 0.0, 1.0) == pytest.approx(
        np.sqrt(3 * (u ** (-2 / 3) - 1)), rel=1e-14
    )


@in_turn("name", DENSITIES)
def test_a_draw_takes_the_declared_noise_and_the_parameters_of_the_log_density(name):
    density = DENSITIES[name]
    arguments = list(inspect.signature(density.draw).parameters)
    noise = ["w"] if density.noise == ("normal",) else ["u", "v"][: len(density.noise)]
    between = ["draws"] if name == "mixture" else []
    assert arguments == [*noise, *between, *density.parameters]


EXAMPLES = {
    "laplace": (1.0, 2.0),
    "student_t": (3.0, 1.0, 2.0),
    "gamma": (2.5, 2.0),
    "poisson": (7.5,),
    "binomial": (20.0, 0.3),
    "von_mises": (0.5, 2.0),
    "normal": (1.0, 2.0),
    "lognormal": (1.0, 2.0),
}


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_compiled_draw_is_that_of_numpy(name):
    density, parameters = DENSITIES[name], EXAMPLES[name]
    draw, two = density.draw, len(density.noise) == 2
    u, v = U, U[::-1].copy()
    out = formula(lambda u, v: draw(*((u, v) if two else (u,)), *parameters))(u, v)
    expected = draw(*((u, v) if two else (u,)), *parameters)
    np.testing.assert_allclose(out, expected, rtol=1e-9)
    if density.support.startswith("0, 1"):
        np.testing.assert_array_equal(out, expected)
