"""Quantiles of gamma, von Mises, Poisson and binomial variables.

A quantile is found from its tails. A tail is the density times the integral of exp(-D(y)), where y
is the distance beyond the quantile, on a logarithmic scale for gamma and beta variables. D rises
from 0, so Gauss's nodes between 0 and the place where D is about 40 give 10 digits.

References
----------
Abramowitz, Stegun, "Handbook of mathematical functions", 1964 (26.2.23 and 26.4.17: first guesses).
Peizer, Pratt, "A normal approximation for binomial, F, beta, and other common, related tail
probabilities, I", Journal of the American Statistical Association 63, 1968.
"""

import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np

from pfdist.densities.special import (
    LOG_2PI,
    deviance,
    erfc,
    lgamma,
    log_bessel,
    log_beta_part,
    log_gamma_part,
)

_HALF_OF_NODES = (  # of Gauss and Legendre, 20 nodes in -1..1, and their weights
    (0.9931285991850949, 0.017614007139152118), (0.9639719272779138, 0.04060142980038694),
    (0.912234428251326, 0.06267204833410907), (0.8391169718222188, 0.08327674157670475),
    (0.7463319064601508, 0.10193011981724044), (0.636053680726515, 0.11819453196151841),
    (0.5108670019508271, 0.13168863844917664), (0.37370608871541955, 0.14209610931838204),
    (0.22778585114164507, 0.14917298647260374), (0.07652652113349734, 0.15275338713072584),
)  # fmt: skip
_NODES = [
    (0.5 + 0.5 * side * node, 0.5 * weight) for side in (-1, 1) for node, weight in _HALF_OF_NODES
]
_STEPS = 16  # a shape is raised by so much, and the difference is a sum of so many terms
_DEEP = 40.0  # exp(-40) is 4e-18
_TINY = 1e-30  # not 0 in float32
_SMALLEST = -80.0  # of logarithms: exp(-80) has all its digits, in float32, too


def _integral(arguments: str, integrand: str) -> Callable[..., Any]:
    """The integral over y from 0 to `reach`, written out, because LLVM vectorises no inner loop."""
    terms = [
        f"{weight} * " + re.sub(r"\by\b", f"({node} * reach)", integrand) for node, weight in _NODES
    ]
    source = f"lambda reach, {arguments}: reach * ({' + '.join(terms)})"
    integral: Callable[..., Any] = eval(source, {"__name__": __name__, "np": np})  # noqa: S307  our text
    return integral


def tails(u):
    """The probabilities below and above a quantile, which a negative u gives as 1 + u."""
    return np.where(u < 0.0, 1.0 + u, u), np.where(u < 0.0, -u, 1.0 - u)


def log_tail(low, high):
    """The logarithm of `low`, exact also where `high` is tiny."""
    return np.where(low < high, np.log(low), np.log1p(-high))


def _normal_quantile(low, high):
    """A first guess: the standard normal quantile within 5e-4."""
    t = np.sqrt(-2.0 * np.log(np.minimum(low, high)))
    top = 2.515517 + t * (0.802853 + t * 0.010328)
    z = t - top / (1.0 + t * (1.432788 + t * (0.189269 + t * 0.001308)))
    return np.where(low < high, -z, z)


def _reach(slope, curvature):
    """The place where slope y + curvature y^2 / 2 is `_DEEP`."""
    return 2.0 * _DEEP / (slope + np.sqrt(slope * slope + 2.0 * _DEEP * curvature))


_beyond_gamma = _integral("a, x, side", "np.exp(a * side * y - x * (np.exp(side * y) - 1.0))")
_beyond_beta = _integral("a, n, p, q", "np.exp(-a * y - n * np.log(q + p * np.exp(-y)))")
_beyond_angle = _integral("c, angle, cosine", "np.exp(-c * (cosine - np.cos(angle + y)))")


def _gamma_tails(shape, x):
    """The probabilities below and above x, and x^shape exp(-x) / gamma(shape); the scale is 1."""
    part, is_below = np.exp(log_gamma_part(shape, x)), x < np.maximum(shape, 1.0)
    raised = shape + np.where(is_below, _STEPS, 0.0)  # so that D has no two scales
    lower, upper = _reach(raised - x, 0.6 * x), np.log1p(_DEEP / x + _reach(x - shape, x))
    reach = np.where(is_below, lower, upper)
    tail = _beyond_gamma(reach, raised, x, np.where(is_below, -1.0, 1.0))
    below = tail * raised
    for k in range(_STEPS, 0, -1):
        below = 1.0 + below * x / (shape + k)
    below, above = part * below / shape, part * tail
    return np.where(is_below, below, 1.0 - above), np.where(is_below, 1.0 - below, above), part


def log_gamma_quantile(u, shape):
    """The logarithm of the quantile of a gamma variable of scale 1, by Halley's iteration."""
    low, high = tails(u)
    log_low, log_high = log_tail(low, high), log_tail(high, low)
    # First guesses: Wilson and Hilferty's, that of a small x, and of a large x of a small shape.
    root = 1.0 - 1.0 / (9.0 * shape) + _normal_quantile(low, high) / (3.0 * np.sqrt(shape))
    usual = np.log(shape) + 3.0 * np.log(np.maximum(root, 1e-3))
    small = (log_low + lgamma(shape + 1.0)) / shape
    far = np.maximum(-log_high - lgamma(shape), 1.0)
    large = np.where(far > 1.0, np.log(far - (1.0 - shape) * np.log(far)), small)
    s = np.where(shape < 1.0, large, np.maximum(small, usual))
    # Loops around loops are not vectorised, so the three steps are written out.
    s = _closer(s, log_low, log_high, shape)
    s = _closer(s, log_low, log_high, shape)
    return _closer(s, log_low, log_high, shape)


def _closer(s, log_low, log_high, shape):
    """A step of Halley's iteration towards the logarithm of the quantile."""
    x, is_low = np.exp(np.maximum(s, _SMALLEST)), log_low < log_high
    below, above, part = _gamma_tails(shape, x)
    ratio = part / np.where(is_low, below, -above)
    error = np.where(is_low, np.log(below) - log_low, np.log(above) - log_high) / ratio
    step = error / np.maximum(1.0 - 0.5 * error * (shape - x - ratio), 0.5)
    return np.where(s < _SMALLEST, s, s - step)


def _beta_below(a, b, p, q):
    """The lower tail in units of p^a q^b / B(a, b), for p of a / (a + b) or less; q is 1 - p."""
    shape, n = a + _STEPS, a + b + _STEPS
    reach = _reach(shape * q - b * p, 0.6 * n * p * q)
    reach = np.minimum(reach, np.log1p(np.expm1((_DEEP + b * reach) / n) / q))
    total = shape * _beyond_beta(reach, shape, n, p, q)
    for k in range(_STEPS, 0, -1):
        total = 1.0 + total * p * (a + b + (k - 1.0)) / (a + k)
    return total / a


def _count_tails(k, mean, n):
    """P(Y <= k), P(Y > k) and P(Y = k) of a Poisson count, or of a binomial count of n trials."""
    if n is None:
        above, below, part = _gamma_tails(k + 1.0, mean)
        return below, above, part / mean
    p, a, b = mean / np.maximum(n, 1.0), k + 1.0, n - k
    q, is_above = 1.0 - p, (n + 1.0) * p <= a
    here = np.exp(log_beta_part(a, b + 1.0, p, q)) / ((n + 1.0) * p * q)
    below = _beta_below(
        np.where(is_above, a, b),
        np.where(is_above, b, a),
        np.where(is_above, p, q),
        np.where(is_above, q, p),
    )
    tail = here * p * b * below
    return np.where(is_above, 1.0 - tail, tail), np.where(is_above, tail, 1.0 - tail), here


def _next_to_this(k, mean, n):
    """P(Y = k + 1) / P(Y = k)."""
    if n is None:
        return mean / (k + 1.0)
    return (n - k) / (k + 1.0) * mean / np.maximum(n - mean, _TINY)


def _closer_normal(low, high):
    """The standard normal quantile within 1e-9, from the first guess."""
    z = np.abs(_normal_quantile(low, high))
    tail = 0.5 * erfc(z * math.sqrt(0.5))
    step = (tail - np.minimum(low, high)) * np.exp(0.5 * (z * z + LOG_2PI))
    z = z + step * (1.0 + 0.5 * z * step)
    return np.where(low < high, -z, z)


def _closer_count(k, z, mean, deviation, n):
    """A step of Newton's iteration towards z, for Peizer and Pratt's quantile of P(Y <= k)."""
    a, distance = k + 0.5, k + 2.0 / 3.0 - mean
    twice, slope = 2.0 * deviance(a, mean), np.log(a / mean)
    if n is not None:
        trials = np.maximum(n, 1.0)
        b, failures = np.maximum(n - a, 0.5), np.maximum(n - mean, _TINY)
        distance = distance - mean / (3.0 * trials)
        twice = (twice + 2.0 * deviance(b, failures)) / (1.0 + 1.0 / (6.0 * trials))
        slope = slope - np.log(b / failures)
    root = np.sqrt(twice)
    is_far = root > 0.01  # else both are 0 / 0
    found = distance * np.where(is_far, root / np.abs(a - mean), 1.0 / deviation)
    return k + (z - found) * np.where(is_far, np.abs(root / slope), deviation)


def count_quantile(u, mean, variance, skewness, n):
    """The quantile of a Poisson count, or of a binomial count of n trials."""
    low, high = tails(u)
    is_low = low < high
    largest = math.inf if n is None else n
    mean = np.where(mean == 0.0, _TINY, mean)  # so that no probability is 0 / 0
    z, deviation = _closer_normal(low, high), np.sqrt(np.maximum(variance, _TINY))
    k = mean + z * deviation + skewness * (z * z - 1.0) / 6.0
    for _ in range(2):
        k = _closer_count(np.minimum(np.maximum(k, 0.0), largest), z, mean, deviation, n)
    k = np.floor(k + 0.5) + np.where(is_low, -2.0, 2.0)  # within 3 of the quantile
    k = np.minimum(np.maximum(k, 0.0), largest)
    below, above, here = _count_tails(k, mean, n)
    tail = np.where(is_low, below, above)
    for _ in range(5):  # each tail grows towards the other, so no digit is lost
        ratio = np.where(is_low, _next_to_this(k, mean, n), 1.0 / _next_to_this(k - 1.0, mean, n))
        moves = np.where(is_low, tail < low, (tail + here <= high) & (k > 0.0))
        following = np.where(moves, here * ratio, here)
        tail = tail + np.where(moves, np.where(is_low, following, here), 0.0)
        k = k + np.where(moves, np.where(is_low, 1.0, -1.0), 0.0)
        here = following
    return k


def von_mises_quantile(tail, concentration):
    """The angle in 0..pi beyond which a von Mises variable of mean 0 has this probability."""
    z = -_normal_quantile(tail, 1.0 - tail) / np.sqrt(concentration + _TINY)
    rest = np.maximum(math.pi - 2.0 * np.arcsin(np.minimum(0.5 * z, 1.0)), 2.0 * math.pi * tail)
    rest = np.minimum(rest, math.pi)
    rest = _closer_angle(_closer_angle(rest, tail, concentration), tail, concentration)
    return math.pi - _closer_angle(_closer_angle(rest, tail, concentration), tail, concentration)


def _closer_angle(rest, tail, concentration):
    """A step of Newton's iteration, for the logarithms of the tail and of pi - angle."""
    angle, twice = math.pi - rest, 2.0 * concentration
    half = np.sin(0.5 * angle)
    density = np.exp(-twice * half * half - LOG_2PI - log_bessel(concentration))
    reach = _reach_of_angle(_reach_of_angle(rest, angle, twice), angle, twice)
    beyond = _beyond_angle(reach, concentration, angle, np.cos(angle))
    step = (np.log(tail) - np.log(beyond * density)) * beyond / rest
    return np.minimum(rest * np.exp(step), math.pi)


def _reach_of_angle(reach, angle, twice):
    """A smaller reach: up to this one, D rises at least as a share of angle y + y^2 / 2."""
    middle = angle + 0.5 * reach
    share = twice * np.sin(0.5 * reach) * np.sin(middle) / (reach * middle)
    share = np.maximum(share, 0.0)  # pi may be rounded up
    return np.minimum(reach, _reach(share * angle, share))
