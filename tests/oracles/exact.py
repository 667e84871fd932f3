"""Exact values of the functions of formulas, by mpmath, and arguments that reach their limits."""

import math
from collections.abc import Callable
from fractions import Fraction

import mpmath
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_BITS = 200
_LARGEST = 2.0**1023 * (2.0 - 2.0**-52)


# --- values ---------------------------------------------------------------------------------------


def _power(x: float, y: float) -> mpmath.mpf:
    if x == 0.0 or y == 0.0:
        return mpmath.mpf(np.power(x, y))
    logarithm = mpmath.mpf(y) * mpmath.log(abs(mpmath.mpf(x)))
    size = mpmath.exp(max(min(logarithm, mpmath.mpf(1000)), mpmath.mpf(-1000)))
    return -size if x < 0.0 and y % 2.0 == 1.0 else size


def _logaddexp(x: float, y: float) -> mpmath.mpf:
    low, high = sorted((x, y))
    apart = mpmath.mpf(low) - mpmath.mpf(high)
    return mpmath.mpf(high) + mpmath.log1p(mpmath.exp(max(apart, mpmath.mpf(-2000))))


def _quotient(x: float, y: float) -> int:
    return math.floor(Fraction(x) / Fraction(y))


def _rational(value: Fraction | int) -> mpmath.mpf:
    value = Fraction(value)
    return mpmath.mpf(value.numerator) / mpmath.mpf(value.denominator)


def _root(x: mpmath.mpf) -> mpmath.mpf:
    return mpmath.sign(x) * mpmath.cbrt(abs(x))


def _limited(function: Callable[[mpmath.mpf], mpmath.mpf]) -> Callable[[float], mpmath.mpf]:
    """Beyond 2,000 the results do not change in floating point."""
    return lambda x: function(mpmath.mpf(max(min(x, 2000.0), -2000.0)))


VALUES: dict[str, Callable[..., mpmath.mpf]] = {
    "sqrt": mpmath.sqrt, "cbrt": lambda x: _root(mpmath.mpf(x)),
    "exp": _limited(mpmath.exp), "exp2": _limited(lambda x: mpmath.power(2, x)),
    "expm1": _limited(mpmath.expm1), "sinh": _limited(mpmath.sinh), "cosh": _limited(mpmath.cosh),
    "tanh": _limited(mpmath.tanh),
    "log": mpmath.log, "log2": lambda x: mpmath.log(x) / mpmath.ln2,
    "log10": lambda x: mpmath.log(x) / mpmath.ln10, "log1p": mpmath.log1p,
    "sin": mpmath.sin, "cos": mpmath.cos, "tan": mpmath.tan,
    "arcsin": mpmath.asin, "arccos": mpmath.acos, "arctan": mpmath.atan,
    "arcsinh": mpmath.asinh, "arccosh": mpmath.acosh, "arctanh": mpmath.atanh,
    "power": _power, "arctan2": mpmath.atan2, "hypot": mpmath.hypot, "logaddexp": _logaddexp,
    "fmod": lambda x, y: mpmath.mpf(math.fmod(x, y)),
    "remainder": lambda x, y: _rational(Fraction(x) - Fraction(y) * _quotient(x, y)),
    "floor_divide": lambda x, y: _rational(_quotient(x, y)),
    "add": lambda x, y: mpmath.mpf(x) + y, "subtract": lambda x, y: mpmath.mpf(x) - y,
    "multiply": lambda x, y: mpmath.mpf(x) * y, "divide": lambda x, y: mpmath.mpf(x) / y,
    "square": lambda x: mpmath.mpf(x) ** 2, "reciprocal": lambda x: 1 / mpmath.mpf(x),
    "deg2rad": lambda x: mpmath.mpf(x) * mpmath.pi / 180,
    "rad2deg": lambda x: mpmath.mpf(x) * 180 / mpmath.pi,
}  # fmt: skip
"""The exact value of finite numbers in the domain, for each function that rounds."""

PAIRS = frozenset(
    {
        *("power", "arctan2", "hypot", "logaddexp", "fmod", "remainder", "floor_divide"),
        *("add", "subtract", "multiply", "divide"),
    }
)
"""Functions of two numbers."""


def units_apart(name: str, got: float, *values: float) -> float:
    """The distance from the exact value, in units in the last place of this value."""
    with mpmath.workprec(_BITS):
        exact = mpmath.mpf(VALUES[name](*values))
        _, exponent = mpmath.frexp(exact)
        unit = mpmath.ldexp(1, min(max(int(exponent), -1021), 1024) - 53)
        largest = mpmath.ldexp(1, 1024)  # infinity is the number after the largest
        a, b = (max(min(each, largest), -largest) for each in (mpmath.mpf(float(got)), exact))
        return float(abs(a - b) / unit)


def nearest_to_quarter_turns() -> Array:
    """For each exponent, the numbers nearest to multiples of pi/2.

    Such a number is k 2^exponent, where k is a denominator of a convergent of 2^exponent 2/pi.
    """
    found = list[float]()
    with mpmath.workprec(3000):
        quarters = int(mpmath.floor(mpmath.ldexp(2 / mpmath.pi, 2500)))
    for exponent in range(-52, 972):
        above, below = quarters << max(exponent, 0), 1 << 2500 + max(-exponent, 0)
        previous, k, denominators = 1, 0, list[int]()
        while k < 2**53:
            denominators.append(k)
            whole, rest = divmod(above, below)
            above, below = below, rest
            previous, k = k, whole * k + previous
        found += [math.ldexp(each, exponent) for each in denominators[-2:]]
    return np.array(found)


# --- arguments ------------------------------------------------------------------------------------

_SPAN = {  # beyond, results are 0, infinite, NaN or do not change
    "exp": 750.0, "expm1": 750.0, "sinh": 720.0, "cosh": 720.0, "exp2": 1080.0, "tanh": 25.0,
    "arcsin": 1.0, "arccos": 1.0, "arctanh": 1.0,
}  # fmt: skip
_POSITIVE = ("sqrt", "log", "log2", "log10", "arccosh")
_POINTS = (  # where functions change their way, or results are near 0 or the limits of the range
    *(0.25, 0.5, 1.0, 2.0, 3.0, 10.0, 100.0, 20.0, 40.0, 0.41421356237309503, 1.4142135623730951),
    *(0.6931471805599453, 1.5707963267948966, 0.7853981633974483, 3.141592653589793),
    *(709.782712893384, 708.3964185322641, 745.1332191019411, 1024.0, 1022.0, 1074.0, 710.4758),
    *(1e-8, 1e-17, 1e9, 2.0**51, 2.0**52, 2.0**53, 2.0**-1022, 2.0**-1074, _LARGEST, 1e-154, 1e154),
)


def _signs(count: int, rng: np.random.Generator) -> Array:
    return rng.choice([-1.0, 1.0], count)


def _any(count: int, rng: np.random.Generator) -> Array:
    """Any finite numbers: each exponent is as likely as another, subnormal numbers more so."""
    bits = rng.integers(0, 0x7FF0000000000000, count)
    few = rng.integers(0, 0x0010000000000000, count) >> rng.integers(0, 52, count)
    return np.where(rng.random(count) < 0.05, few, bits).view(np.float64) * _signs(count, rng)


def _near(points: Array, rng: np.random.Generator) -> Array:
    """Numbers at distances of all sizes from some points."""
    bits = points.view(np.int64)
    steps = np.floor(2.0 ** rng.uniform(0.0, 50.0, points.size)).astype(np.int64) - 1
    moved = bits + np.where(rng.random(points.size) < 0.5, steps, -steps)
    inside = (moved >= 0) & (moved < 0x7FF0000000000000)
    return np.where(inside, moved, bits).view(np.float64)


def _single(name: str, count: int, rng: np.random.Generator) -> Array:
    """Numbers of all sizes, of the usual ones, of those that matter, and near points; not 0."""
    span = _SPAN.get(name, 1000.0)
    kinds = [
        _any(count, rng),
        _signs(count, rng) * 10.0 ** rng.uniform(-20.0, math.log10(span), count),
        rng.uniform(-span, span, count),
        rng.uniform(-4.0, 4.0, count) * min(span, 1.0),
        _signs(count, rng) * _near(rng.choice(_POINTS, count), rng),
    ]
    values = np.choose(rng.integers(0, len(kinds), count), kinds)
    values = np.where(values == 0.0, 2.0**-1074, values)
    return np.abs(values) if name in _POSITIVE else values


def arguments(name: str, count: int, rng: np.random.Generator) -> tuple[Array, ...]:
    """Arguments of the whole range of a function: subnormal, negative and huge ones, too."""
    x = _single(name, count, rng)
    if name not in PAIRS:
        return (x,)
    y = _single(name, count, rng)
    related, kind = _related(name, x, rng), rng.random(count)
    y = np.where((kind < 0.5) & np.isfinite(related) & (related != 0.0), related, y)
    if name == "power":
        y = np.where(kind > 0.8, np.rint(y), y)
        x = np.where(y == np.rint(y), x, np.abs(x))
    return (x, y)


def _related(name: str, x: Array, rng: np.random.Generator) -> Array:
    """Second numbers for which the result is neither trivial nor out of range."""
    count = x.size
    with np.errstate(all="ignore"):
        if name == "power":
            return rng.uniform(-1080.0, 1030.0, count) / np.log2(np.abs(x))
        if name == "logaddexp":  # the result is nearly 0: up to 44 bits of x cancel
            cancels = np.log(-np.expm1(x)) * (
                1.0 + _signs(count, rng) * 2.0 ** rng.uniform(-44, 0, count)
            )
            return np.where(x < 0.0, cancels, x + rng.uniform(-40.0, 40.0, count))
        return np.where(
            rng.random(count) < 0.5,
            _near(np.abs(x), rng) * _signs(count, rng),
            x * 2.0 ** rng.uniform(-60.0, 60.0, count),
        )
