"""Functions of float32 vectors, within 4 units in the last place; special values are NumPy's.

Other functions are computed in float64 and rounded. See `pfdist.kernels.functions`.
"""

import math
from collections.abc import Callable

from pfdist.kernels.functions import FUNCTIONS, absolute
from pfdist.kernels.vectors import Vector, polynomial, where_some
from pfdist.models.program import MASKS

_SHIFT = 12582912.0  # 2^23 + 2^22: the low bits of x + _SHIFT are the nearest integer
_LN2, _LN2_REST = 0.6931471824645996, -1.904654299957768e-09
_PI_2, _PI_2_REST, _PI_2_LAST = 1.5707963705062866, -4.371139000186241e-08, -1.7151245100058819e-15
_LARGEST_ANGLE = 2.0**20
_SMALLEST_NORMAL = 2.0**-126


def function_of(name: str, kind: str) -> Callable[..., Vector]:
    """The vector function that computes an operation for a type of numbers."""
    if kind == "f8" or name in _OF_ANY_KIND:
        return FUNCTIONS[name]
    return _FUNCTIONS.get(name) or _by_doubles(name)


def _by_doubles(name: str) -> Callable[..., Vector]:
    def function(*given: Vector) -> Vector:
        value = FUNCTIONS[name](*(each.to("f8") for each in given))
        return value.to("f4") if value.is_float else value

    return function


def _sine_of_more_turns(more: int) -> Callable[[Vector], Vector]:
    """The sine of an angle and of so many more quarter turns."""

    def usual(x: Vector) -> Vector:
        shifted = x.fma(0.6366197466850281, _SHIFT)
        turns, k = shifted.bits("i4") + more, shifted - _SHIFT
        r = (-k).fma(_PI_2_LAST, (-k).fma(_PI_2_REST, (-k).fma(_PI_2, x)))
        q = r * r
        sine = polynomial(q, -0.00019582855848012662, 0.008332724682986736, -0.166666641831398)
        cosine = polynomial(q, 2.4542896426282823e-05, -0.0013888279208913445, 0.0416666641831398)
        sine, cosine = (r * q).fma(sine, r), (q * q).fma(cosine, q.fma(-0.5, 1.0))
        value = (turns & 1).differs(0).select(cosine, sine)
        return (value.bits("i4") ^ ((turns & 2) << 30)).bits("f4")

    def function(x: Vector) -> Vector:
        value = usual(x) if more else x.equals(0.0).select(x, usual(x))  # keeps the sign of -0
        large = ~(absolute(x) < _LARGEST_ANGLE)
        return where_some(large, lambda: _by_doubles("cos" if more else "sin")(x), value)

    return function


def _exp(x: Vector) -> Vector:
    limited = (x < 89.0).select(x, x.number(89.0))
    limited = (limited > -105.0).select(limited, x.number(-105.0))
    shifted = limited.fma(1.4426950216293335, _SHIFT)
    k = shifted - _SHIFT
    r = (-k).fma(_LN2_REST, (-k).fma(_LN2, limited))
    part = polynomial(
        r, 0.001392648438923061, 0.008363419212400913, 0.04166655242443085, 0.16666576266288757,
        0.5,
    )  # fmt: skip
    whole = shifted.bits("i4") - 0x4B400000
    half = whole >> 1  # in two steps, because 2^k itself may be infinite or 0
    scale, rest = (((each + 127) << 23).bits("f4") for each in (half, whole - half))
    return x.differs(x).select(x, (part.fma(r * r, r) + 1.0) * scale * rest)


def _log(x: Vector) -> Vector:
    tiny = x < _SMALLEST_NORMAL  # without a full mantissa
    bits = tiny.select(x * 2.0**25, x).bits("i4")
    exponent = (bits - 0x3F3504F3) >> 23
    f = (bits - (exponent << 23)).bits("f4") - 1.0
    e = (exponent - tiny.select(exponent.number(25), exponent.number(0))).to("f4")
    part = polynomial(
        f, 0.06973070651292801, -0.11481477320194244, 0.11685719341039658, -0.12425486743450165,
        0.14249008893966675, -0.16667808592319489, 0.20000717043876648, -0.2499999701976768,
        0.3333333134651184,
    )  # fmt: skip
    q = f * f
    value = e.fma(_LN2, f + e.fma(_LN2_REST, (q * f).fma(part, q * -0.5)))
    value = x.equals(math.inf).select(x, value)
    value = x.equals(0.0).select(-math.inf, value)
    return (x >= 0.0).select(value, x.number(math.nan))


def _arctan2(y: Vector, x: Vector) -> Vector:
    a, b = absolute(x), absolute(y)
    swap, left = a < b, x.bits("i4") < 0
    low, high = swap.select(a, b), swap.select(b, a)
    high = high.equals(0.0).select(1.0, high)
    both = low.equals(math.inf)
    r = both.select(1.0, low) / both.select(1.0, high)
    q = r * r
    part = polynomial(
        q, -0.002386418404057622, 0.01350557804107666, -0.035868171602487564, 0.06249900907278061,
        -0.08656762540340424, 0.11033736169338226, -0.14278565347194672, 0.19999739527702332,
        -0.3333333134651184,
    )  # fmt: skip
    r = (r * q).fma(part, r)
    zero = x.number(0.0)
    start = swap.select(_PI_2, left.select(2.0 * _PI_2, zero))
    rest = swap.select(_PI_2_REST, left.select(2.0 * _PI_2_REST, zero))
    value = start + ((swap ^ left).select(-r, r) + rest)
    value = ((value.bits("i4") & (2**31 - 1)) | (y.bits("i4") & -(2**31))).bits("f4")
    return (x.differs(x) | y.differs(y)).select(math.nan, value)


_FUNCTIONS: dict[str, Callable[..., Vector]] = {
    "sin": _sine_of_more_turns(0),
    "cos": _sine_of_more_turns(1),
    "exp": _exp,
    "log": _log,
    "arctan2": _arctan2,
    "arctan": lambda x: _arctan2(x, x.number(1.0)),
}

_OF_ANY_KIND = {
    *("add", "subtract", "multiply", "divide", "negative", "absolute", "sqrt"),
    *("floor", "ceil", "trunc", "rint", "maximum", "minimum", "fmax", "fmin", "where"),
    *(MASKS - {"signbit"}),
}
