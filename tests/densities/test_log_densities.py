"""Log densities against SciPy, against 60 digits, and compiled against NumPy."""

import numpy as np
import pytest
from scipy import special, stats

import pfdist
from oracles.computed import formula, libraries_of
from oracles.in_turn import in_turn
from pfdist import densities
from pfdist.densities import DENSITIES, poisson_logpmf

RNG = np.random.default_rng(1)
COUNT = 400
ERROR = 1e-12  # of a value L, in units of max(1, abs(L))


def sizes(low, high):
    """Numbers from 10^low to 10^high."""
    return 10.0 ** RNG.uniform(low, high, COUNT)


PLACES, ANGLES = RNG.normal(0, 5, COUNT), RNG.uniform(-9, 9, COUNT)
SHAPES, SCALES, SHARES = sizes(-2, 2), sizes(-3, 3), RNG.uniform(0.001, 0.999, COUNT)
WHOLE = np.floor(sizes(0, 2.5))
NEAR = PLACES + SCALES * RNG.uniform(-600, 600, COUNT)  # where SciPy's density does not underflow
FAR = PLACES + SCALES * sizes(-3, 3) * RNG.choice([-1, 1], COUNT)

# SciPy's distribution, and values with parameters: SciPy's terms cancel where these are large.
SCIPY = {
    "normal": (stats.norm.logpdf, FAR, PLACES, SCALES),
    "student_t": (stats.t.logpdf, FAR, SHAPES, PLACES, SCALES),
    "laplace": (stats.laplace.logpdf, NEAR, PLACES, SCALES),
    "lognormal": (
        lambda y, a, s: stats.lognorm.logpdf(y, s, scale=np.exp(a)), sizes(-20, 20), PLACES, SCALES
    ),
    "gamma": (lambda y, k, s: stats.gamma.logpdf(y, k, 0, s), sizes(-9, 3), SHAPES, SCALES),
    "beta": (stats.beta.logpdf, SHARES, SHAPES, sizes(-2, 2)),
    "von_mises": (lambda y, a, k: stats.vonmises.logpdf(y, k, a), ANGLES, PLACES, SCALES),
    "poisson": (stats.poisson.logpmf, np.floor(sizes(-0.5, 2)), SHAPES),
    "binomial": (
        stats.binom.logpmf, np.floor(RNG.uniform(0, 1, COUNT) * (WHOLE + 1)), WHOLE, SHARES
    ),
    "negative_binomial": (
        lambda y, m, k: stats.nbinom.logpmf(y, k, k / (k + m)), np.floor(sizes(-0.5, 2)), SHAPES,
        sizes(-2, 2),
    ),
}  # fmt: skip

# Computed with 60 digits (mpmath) from the textbook's formulas.
EXACT = [
    ("normal", (1e200, 0.0, 1e190), -4.999999999999999e19),
    ("normal", (3.0, 3.0, 1e-200), 459.59808006560445),
    ("student_t", (1e100, 0.01, 0.0, 1.0), -237.88932825649644),
    ("student_t", (5.0, 1000000000000.0, 0.0, 1.0), -13.418938533061173),
    ("student_t", (-40.0, 100000.0, 1.0, 2.0), -211.29889302508008),
    ("student_t", (1e200, 1.0, 0.0, 1.0), -922.1787670834676),
    ("student_t", (-1e300, 1.0, 0.0, 1e-300), -2073.4713135804905),
    ("student_t", (-3e9, 2.0, 0.0, 1.0), -65.46563437684357),
    ("laplace", (-1e300, 0.0, 1e290), -10000000668.442823),
    ("lognormal", (1e-300, 0.0, 1.0), -237895.5583821629),
    ("lognormal", (1e300, 5.0, 0.01), -2351441060.4096646),
    ("gamma", (1e-300, 0.001, 1.0), 683.1775734849316),
    ("gamma", (100030000.0, 100000000.0, 1.0), -14.6286790634746),
    ("gamma", (10000000000.0, 10000000000.0, 1.0), -12.431863998183234),
    ("gamma", (700.0, 1.0, 0.5), -1399.30685281944),
    ("beta", (1e-300, 0.5, 0.5), 344.2430340632574),
    ("beta", (0.5001, 100000000.0, 100000000.0), 5.331122568362308),
    ("beta", (0.9999999999999991, 3.0, 0.001), 27.716445765361865),
    ("beta", (1e-06, 1.0, 1000000.0), 12.815511057964441),
    ("von_mises", (3.14, 0.0, 10000.0), -19996.301098123236),
    ("von_mises", (0.0001, 0.0, 100000000.0), 7.791401837938176),
    ("von_mises", (2.0, -2.0, 1e-08), -1.8378770729457816),
    ("poisson", (1000000000000.0, 1000003000000.0), -19.23444009118928),
    ("poisson", (0.0, 1e-300), -1e-300),
    ("poisson", (1000000.0, 1e-05), -24328443.8496384),
    ("poisson", (3.0, 100000.0), -99967.25298307432),
    ("binomial", (5000000000.0, 10000000000.0, 0.5), -11.738716817639956),
    ("binomial", (999999.0, 1000000.0, 1e-06), -13815482.926944159),
    ("binomial", (1.0, 1000000000000.0, 1e-12), -0.9999999999995),
    ("binomial", (999997.0, 1000000.0, 0.999999999), -22.51602838799498),
    ("negative_binomial", (1000000.0, 1000000.0, 1000000000000.0), -7.826694395519893),
    ("negative_binomial", (0.0, 1000000.0, 1e-06), -2.7631021115929548e-05),
    ("negative_binomial", (1000000000.0, 1000.0, 0.25), -249987.65925416167),
]
OUTSIDE = [
    ("lognormal", -1.0, (0.0, 1.0)),
    ("gamma", -1.0, (2.0, 1.0)),
    ("beta", 1.5, (2.0, 3.0)),
    ("poisson", -1.0, (3.0,)),
    ("poisson", 1.5, (3.0,)),
    ("binomial", 6.0, (5.0, 0.5)),
    ("binomial", 0.5, (5.0, 0.5)),
    ("negative_binomial", 0.5, (3.0, 2.0)),
]
CERTAIN = [
    ("poisson", 0.0, (0.0,)),
    ("binomial", 0.0, (5.0, 0.0)),
    ("binomial", 5.0, (5.0, 1.0)),
    ("binomial", 0.0, (0.0, 0.3)),
    ("binomial", 0.0, (0.0, 1.0)),
]


def assert_close(given, expected):
    expected = np.asarray(expected)
    finite = np.isfinite(expected)
    np.testing.assert_array_equal(np.asarray(given)[~finite], expected[~finite])
    error = np.abs(given - expected)[finite] / np.maximum(1, np.abs(expected[finite]))
    assert error.max(initial=0.0) < ERROR


@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # NumPy's, of values that are not chosen
@pytest.mark.parametrize("name", SCIPY)
def test_a_log_density_is_scipys_in_both_engines_and_calls_no_c_library(name):
    exact, *arguments = SCIPY[name]
    function = DENSITIES[name].log_density
    expected = exact(*arguments)
    assert_close(function(*arguments), expected)
    assert_close(formula(function)(*arguments), expected)
    assert not libraries_of(function, len(arguments))


def test_every_density_is_compared_with_scipy():
    of_tuples = {"categorical", "mixture"}  # see below
    assert SCIPY.keys() | of_tuples == DENSITIES.keys()


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@in_turn(("name", "arguments", "value"), EXACT)
def test_far_tails_and_large_parameters_have_twelve_digits(name, arguments, value):
    assert_close(DENSITIES[name].log_density(*arguments), value)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_a_student_t_has_its_tail_where_squares_overflow_and_none_without_a_scale():
    """Far out, log(1 + z^2 / df) is 2 log(z) - log(df), and a scale of 0 is the limit."""
    df, scale = SHAPES, sizes(-300, 2)
    z = sizes(8, 14) ** RNG.choice([1.0, 20.0], COUNT)  # up to 1e280
    y = z * np.maximum(scale, 1e-20) * RNG.choice([-1, 1], COUNT)
    log_z = np.log(np.abs(y)) - np.log(scale)
    constant = special.gammaln(0.5 * df + 0.5) - special.gammaln(0.5 * df)
    tail = -(df + 1) * (log_z - 0.5 * np.log(df))
    expected = constant - 0.5 * np.log(df * np.pi) - np.log(scale) + tail
    assert np.mean(log_z > 355) > 0.3  # their squares are infinite
    assert np.isfinite(expected).all()
    ends = np.array([3.0, -1e-300, 0.0, np.inf])  # a point at 0: no density elsewhere
    of_ends = ends, np.full(4, 2.0), np.zeros(4), np.array([0.0, 0.0, 0.0, 1.0])
    function = DENSITIES["student_t"].log_density
    for arguments, exact in (
        ((y, df, np.zeros(COUNT), scale), expected),
        (of_ends, [-np.inf, -np.inf, np.inf, -np.inf]),
    ):
        assert_close(function(*arguments), exact)
        assert_close(formula(function)(*arguments), exact)
    assert np.isnan(function(np.nan, 2.0, 0.0, 1.0))


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@in_turn(("name", "y", "parameters"), OUTSIDE)
def test_outside_its_support_a_density_is_0(name, y, parameters):
    assert DENSITIES[name].log_density(y, *parameters) == -np.inf


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize(("name", "y", "parameters"), CERTAIN)
def test_a_certain_count_has_the_probability_1(name, y, parameters):
    assert DENSITIES[name].log_density(y, *parameters) == 0


def test_categories_and_mixtures_need_no_normalised_weights():
    weights = (1.0, 0.0, 5.0, 2.0)
    found = [densities.categorical_logpmf(float(k), weights) for k in (0, 2, 3)]
    np.testing.assert_allclose(np.exp(found), [1 / 8, 5 / 8, 2 / 8], rtol=1e-15)
    y = np.array([-40.0, 0.3, 900.0])
    logs = (stats.norm.logpdf(y, 0, 1), stats.norm.logpdf(y, 5, 2))
    expected = special.logsumexp([logs[0] + np.log(0.25), logs[1] + np.log(0.75)], axis=0)
    np.testing.assert_allclose(densities.mixture_logpdf(logs, (1.0, 3.0)), expected, rtol=1e-14)
    of_tuples = formula(
        lambda a, b, y: (
            densities.mixture_logpdf((a, b), (1.0, 3.0))
            + densities.categorical_logpmf(y, (1.0, 0.5, 2.5))
        )
    )
    assert of_tuples(*(log[0] for log in logs), 2.0) == pytest.approx(
        expected[0] + np.log(2.5 / 4), rel=1e-14
    )


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize(
    ("name", "exact", "x", "error"),
    [
        ("lgamma", special.gammaln, np.concatenate([sizes(-300, 300), sizes(-2, 2)]), 1e-14),
        ("erf", special.erf, np.concatenate([PLACES, sizes(-300, 0)]), 0),
        ("erfc", special.erfc, np.concatenate([RNG.uniform(-6, 26.5, COUNT), sizes(-9, 0)]), 0),
    ],
)
def test_special_functions_are_scipys(name, exact, x, error):
    function = getattr(densities, name)
    for given in (function(x), formula(function)(x)):
        np.testing.assert_allclose(given, exact(x), rtol=1e-13, atol=error)
    assert not libraries_of(function, 1)


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_special_functions_at_their_ends():
    assert densities.lgamma(0.0) == densities.lgamma(np.inf) == np.inf
    assert np.isnan(densities.lgamma(np.array([-0.5, -1.5]))).all()
    ends = np.array([-np.inf, np.inf])
    assert densities.erf(ends).tolist() == [-1, 1]
    assert densities.erfc(ends).tolist() == [2, 0]
    assert densities.logsumexp((-np.inf, -np.inf)) == -np.inf
    assert densities.logsumexp((np.inf, 0.0)) == np.inf


@pytest.mark.parametrize(
    "function",
    [
        lambda y, x: 1 * densities.poisson_logpmf(y, x),
        lambda y, x: 1 * pfdist.densities.poisson_logpmf(y, x),
        lambda y, x: 1 * poisson_logpmf(y, x),
    ],
    ids=["densities.f", "pfdist.densities.f", "f"],
)
def test_a_formula_may_import_a_density_in_any_way(function):
    exact = stats.poisson.logpmf(3, 2.5)
    assert formula(function)(3.0, 2.5) == pytest.approx(exact, rel=1e-14)
