"""Special functions that NumPy lacks, and the parts that log densities share.

Each polynomial interpolates at the Chebyshev nodes of its interval, the highest power first.

References
----------
Loader, "Fast and accurate computation of binomial probabilities", 2000 (deviance).
Shepherd, Laframboise, "Chebyshev approximation of (1 + 2x) exp(x^2) erfc x in 0 <= x < infinity",
Mathematics of Computation 36, 1981.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

LOG_2PI = 1.8378770664093453  # a number: math.log is the C library's
_LEAST_STIRLING = 8.0


def _polynomial(*coefficients: float) -> Callable[[Any], Any]:
    """A polynomial whose terms are written out: LLVM would not unroll a long loop over them."""
    terms = repr(coefficients[0])
    for coefficient in coefficients[1:]:
        terms = f"({terms}) * x + {coefficient!r}"
    polynomial: Callable[[Any], Any] = eval(f"lambda x: {terms}", {"__name__": __name__})  # noqa: S307  numbers alone
    return polynomial


_STIRLING = _polynomial(  # x (lgamma(x) - Stirling's formula) in 1/x^2, for x of 8 or more
    0.005065905360156132, -0.001890382993887715, 0.0008414700852503147, -0.0005952365845057049,
    0.0007936507897524059, -0.002777777777773988, 0.08333333333333333,
)  # fmt: skip
_ERFCX = _polynomial(  # (1 + 2x) exp(x^2) erfc(x) in (x - 3.75) / (x + 3.75), for x of 0 or more
    3.2052623379289157e-10, -2.618520156503145e-09, -3.798189797736207e-09, 3.195398612057818e-08,
    2.3398534313040898e-08, -2.4851108650210706e-07, -5.741076073013916e-08,
    1.7419011945194367e-06, -9.733875167494142e-07, -1.1437980374495534e-05,
    2.2384138525656757e-05, 5.164649341002877e-05, -0.00029015404203352704, 0.000293714390578856,
    0.001755625843431864, -0.00974657968596217, 0.028362277420377335, -0.05869339857631061,
    0.09230432116025894, -0.10880393014246645, 0.08227673849014977, 0.003585415485479575,
    -0.14024059858554702, 1.2375126308378275,
)  # fmt: skip
_ERF = _polynomial(  # erf(x) / x in x^2, for x of 1/2 or less
    1.4725865480556744e-06, -1.4845849259707869e-05, 0.00012053335124353741,
    -0.0008548297753674966, 0.00522397737302147, -0.026866170632887928, 0.11283791670925353,
    -0.37612638903183476, 1.1283791670955126,
)  # fmt: skip
_BESSEL = _polynomial(  # sqrt(x) exp(-x) I_0(x) in 12/x, for x of 12 or more
    -1.2131916224711462e-08, 5.5379906971723384e-08, -9.014917507644161e-08, 3.454126213730234e-08,
    9.606174530526062e-08, -1.7885734863737275e-07, 1.5991736412223253e-07, -8.073279666014496e-08,
    5.057395419815497e-08, 6.884108122701506e-08, 3.653491619574959e-07, 2.15758014559578e-06,
    1.6909385748796346e-05, 0.00019479603511366196, 0.004155648754184463, 0.39894228040143265,
)  # fmt: skip
_BESSEL_SERIES = _polynomial(*(1 / math.factorial(k) ** 2 for k in range(28, -1, -1)))  # in x^2 / 4


def lgamma(x: Any) -> Any:
    """The logarithm of the gamma function of positive numbers; NaN for negative numbers.

    Parameters
    ----------
    x : float or array

    Returns
    -------
    float or array

    Examples
    --------
    >>> float(lgamma(5.0).round(12)), float(np.log(24).round(12))
    (3.178053830348, 3.178053830348)
    """
    small = np.minimum(x, _LEAST_STIRLING)  # lgamma(x) = lgamma(x + 8) - log(x (x + 1) ... (x + 7))
    product = small
    for k in range(1, 8):
        product = product * (small + k)
    is_small = x < _LEAST_STIRLING
    z = np.where(is_small, small + 8.0, x)
    value = (z - 0.5) * (np.log(z) - 1.0) + (0.5 * LOG_2PI - 0.5) + _stirling_rest(z)
    return np.where(is_small, value - np.log(np.where(x < 0.0, math.nan, product)), value)


def _stirling_rest(x):
    return _STIRLING(1.0 / (x * x)) / x


def stirling_excess(x):
    """The excess of lgamma(x) over Stirling's (x - 1/2) log(x) - x + log(2 pi) / 2."""
    small = np.minimum(x, _LEAST_STIRLING)
    below = lgamma(small) - (small - 0.5) * np.log(small) + small - 0.5 * LOG_2PI
    return np.where(x < _LEAST_STIRLING, below, _stirling_rest(np.maximum(x, _LEAST_STIRLING)))


def erfc(x: Any) -> Any:
    """The complement 1 - erf(x) of the error function, accurate even where it is tiny.

    Parameters
    ----------
    x : float or array

    Returns
    -------
    float or array
    """
    a = np.minimum(np.abs(x), 30.0)  # erfc(30) is 0 in floating point
    tail = np.exp(-a * a) * _ERFCX((a - 3.75) / (a + 3.75)) / (1.0 + 2.0 * a)
    return np.where(a < 0.5, 1.0 - x * _ERF(a * a), np.where(x < 0.0, 2.0 - tail, tail))


def log_normal_tail(z):
    """The logarithm of the probability that a standard normal variable exceeds z."""
    a = np.maximum(z, 0.0) * math.sqrt(0.5)
    scaled = _ERFCX((a - 3.75) / (a + 3.75)) / (1.0 + 2.0 * a)  # exp(a^2) erfc(a)
    near = np.log(0.5 * erfc(np.minimum(z, 1.0) * math.sqrt(0.5)))
    return np.where(z < 0.7, near, np.log(0.5 * scaled) - a * a)


def erf(x: Any) -> Any:
    """The error function.

    Parameters
    ----------
    x : float or array

    Returns
    -------
    float or array
    """
    small = np.minimum(np.abs(x), 0.5)
    return np.where(np.abs(x) < 0.5, x * _ERF(small * small), 1.0 - erfc(x))


def logsumexp(values: Any) -> Any:
    """The logarithm of a sum of exponentials, without overflow.

    Parameters
    ----------
    values : tuple of float or array

    Returns
    -------
    float or array

    Examples
    --------
    >>> float(logsumexp((1000.0, 1000.0)) - np.log(2))
    1000.0
    """
    top, total = largest_finite(values), 0.0
    for value in values:
        total = total + np.exp(value - top)
    return top + np.log(total)


def largest_finite(values):
    """The largest of some values, or 0 where it is infinite."""
    top = values[0]
    for value in values:
        top = np.maximum(top, value)
    return np.where(np.abs(top) < math.inf, top, 0.0)


def log_bessel(x):
    """The logarithm of exp(-x) I_0(x), for x of 0 or more."""
    small, large = np.minimum(x, 12.0), np.maximum(x, 12.0)
    below = np.log(_BESSEL_SERIES(0.25 * small * small)) - small
    above = np.log(_BESSEL(12.0 / large)) - 0.5 * np.log(large)
    return np.where(x < 12.0, below, above)


def deviance(a, x):
    """The deviance a log(a / x) + x - a of positive numbers, which is 0 where they are equal."""
    v = (x - a) / (x + a)
    q = v * v
    series = 1.0 / 19.0
    for k in range(17, 1, -2):  # of the inverse hyperbolic tangent
        series = series * q + 1.0 / k
    near = (x - a) * v - 2.0 * a * v * q * series
    return np.where(np.abs(v) < 0.1, near, x - a - a * np.log(x / a))


def log_gamma_part(shape, x):
    """The logarithm of x^shape exp(-x) / gamma(shape)."""
    return 0.5 * np.log(shape) - 0.5 * LOG_2PI - stirling_excess(shape) - deviance(shape, x)


def log_beta_part(a, b, p, q):
    """The logarithm of p^a q^b / B(a, b), where p + q = 1."""
    n = a + b
    deviances = deviance(a, n * p) + deviance(b, n * q)
    return (
        stirling_excess(n)
        - stirling_excess(a)
        - stirling_excess(b)
        - deviances
        + 0.5 * (np.log(a / n * b) - LOG_2PI)
    )
