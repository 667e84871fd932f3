"""Elementary functions of vectors: polynomials without branches or library calls.

Each function writes the instructions that compute it for all lanes. Results are within 2 units in
the last place of the exact values, and special values are NumPy's.

Each polynomial interpolates at the Chebyshev nodes of its interval, with an error of less than half
a unit.

References
----------
Muller, "Elementary Functions: Algorithms and Implementation", 2016 (reductions). Goldberg, "What
every computer scientist should know about floating-point arithmetic", 1991 (theorem 4: log1p).
Dekker, "A floating-point technique for extending the available precision", Numerische Mathematik
18, 1971 (sums of two numbers). Payne, Hanek, "Radian reduction for trigonometric functions", ACM
SIGNUM Newsletter 18, 1983 (huge angles). Ogita, Rump, Oishi, "Accurate sum and dot product", SIAM
Journal on Scientific Computing 26, 2005 (sums of many numbers).
"""

import math
from collections.abc import Callable
from fractions import Fraction
from functools import lru_cache, partial

from pfdist.kernels.vectors import Vector, each_lane, entries, outlined, polynomial, where_some

LARGEST_ANGLE = 2.0**51
"""Angles above this are reduced in another way, which takes longer."""

_LN2, _LN2_REST = 0.6931471805599453, 2.3190468138462996e-17
_SHIFT = 6755399441055744.0  # 2^52 + 2^51: the low bits of x + _SHIFT are the nearest integer
_SMALLEST_NORMAL = 2.2250738585072014e-308
_ROOT = 2.0**500  # squares of larger numbers may be infinite

DoubleDouble = tuple[Vector, Vector]  # a sum of two numbers, the second far below the first


def _bits_of_sign(x: Vector) -> Vector:
    return x.bits("i8") & -(2**63)


def absolute(x: Vector) -> Vector:
    """The absolute value."""
    return x.call("fabs")


def copysign(x: Vector, y: Vector) -> Vector:
    """The absolute value of x with the sign of y."""
    return ((x.bits("i8") & (2**63 - 1)) | _bits_of_sign(y)).bits("f8")


def signbit(x: Vector) -> Vector:
    """A mask of negative signs, including that of -0."""
    return x.bits("i8") < 0


def _is_nan(x: Vector) -> Vector:
    return x.differs(x)


def _nan_where(mask: Vector, x: Vector) -> Vector:
    return mask.select(math.nan, x)


def _difference(a: Vector, b: Vector) -> DoubleDouble:
    """A difference, and what it loses by rounding."""
    rest = a - b
    part = rest - a
    return rest, (a - (rest - part)) - (b + part)


def _plus(x: Vector, rest: Vector, number: float) -> DoubleDouble:
    """A number more than x + rest."""
    total, lost = _difference(x, x.number(-number))
    return total, lost + rest


def _quotient(above: DoubleDouble, below: DoubleDouble) -> DoubleDouble:
    ratio = above[0] / below[0]
    lost = (-ratio).fma(below[0], above[0]) + (above[1] - ratio * below[1])
    return ratio, lost / below[0]


# --- sine, cosine, tangent ----------------------------------------------------------------------


_FIRST_EXPONENT = 51  # that of LARGEST_ANGLE


@lru_cache(maxsize=1)
def _quarters() -> tuple[float, ...]:
    """2^(16 j) 2/pi modulo 8, for j = 0, 1, ..., each as the sum of four numbers.

    Pi has 1,280 bits, by Machin's formula.
    """
    unit = 1 << 1280

    def arctangent(n: int) -> int:
        total, power, k = 0, unit // n, 1
        while power:
            total, power, k = total + power // k, -power // (n * n), k + 2
        return total

    pi, parts = 4 * (4 * arctangent(5) - arctangent(239)), list[float]()
    for exponent in range(0, 1024 - _FIRST_EXPONENT, 16):
        rest = ((unit * unit << 1 + exponent) // pi) % (8 * unit)
        for _ in range(4):
            parts.append(rest / unit)
            whole, below = parts[-1].as_integer_ratio()
            rest -= whole * unit // below
    return (*parts,)


def _huge_quarter_turns(x: Vector) -> tuple[Vector, ...]:
    """The nearest multiple of pi/2 modulo 4, and the remainder and what it loses by rounding.

    A huge angle is m 2^(16 j), where m is a multiple of 1/2. So multiples of 8 in 2^(16 j) 2/pi do
    not matter. The product with the rest of it has an error of 2^-140; no huge angle is nearer to a
    multiple of pi/2 than 2^-62.
    """
    bits = x.bits("i8")
    row = (((bits >> 52) & 0x7FF) - (1023 + _FIRST_EXPONENT)) >> 4
    m = (bits - (row << 56)).bits("f8")
    terms = list[Vector]()
    for k in range(4):
        factor = entries("quarter_turns", _quarters(), (row << 2) + k)
        product = m * factor
        terms += [product, m.fma(factor, -product)]
    terms = [(each * 0.25).call("rint").fma(-4.0, each) for each in terms[:3]] + terms[3:-1]
    _distil(terms)
    turns = terms[0].call("rint")
    terms[0] = terms[0] - turns
    _distil(terms)
    low = terms[-1]
    for each in terms[-2:0:-1]:
        low = low + each
    high, low = _difference(terms[0], -low)
    first = high * 1.5707963267948966
    second = high.fma(1.5707963267948966, -first) + high * 6.123233995736766e-17
    return turns.to("i8"), *_difference(first, -low.fma(1.5707963267948966, second))


def _distil(terms: list[Vector]) -> None:
    """Replace numbers by their rounded sum, and what each addition lost."""
    for k in range(len(terms) - 1, 0, -1):
        terms[k - 1], terms[k] = _difference(terms[k - 1], -terms[k])


def _with_huge(value: Vector, function: Callable[..., Vector], x: Vector, *more: Vector) -> Vector:
    """The value; that of a function of single numbers where x is huge; NaN where x is infinite."""
    size = absolute(x)

    def beyond() -> Vector:
        huge = (size >= LARGEST_ANGLE) & (size < math.inf)
        angles = huge.select(x, x.number(math.nan))
        return outlined(f"vector{function.__name__}", partial(each_lane, function), [angles, *more])

    return where_some(~(size < LARGEST_ANGLE), beyond, value)


def _quarter_turns(x: Vector) -> DoubleDouble:
    """The nearest multiple of pi/2, as an integer, and the remainder in -pi/4..pi/4."""
    shifted = x.fma(0.6366197723675814, _SHIFT)
    turns = shifted - _SHIFT
    rest = (-turns).fma(1.5707963267948966, x)  # pi/2 in three parts
    rest = (-turns).fma(6.123233995736766e-17, rest)
    rest = (-turns).fma(-1.4973849048591698e-33, rest)
    return shifted.bits("i8"), rest


def _sine_rest(r: Vector) -> Vector:
    """(sin r - r) / r^3."""
    return polynomial(
        r * r, -7.586094789672621e-13, 1.6058521349954986e-10, -2.5052106167335705e-08,
        2.7557319219150783e-06, -0.00019841269841264821, 0.008333333333333331, -0.16666666666666666,
    )  # fmt: skip


def _cosine_rest(r: Vector) -> Vector:
    """(cos r - 1 + r^2 / 2) / r^4."""
    return polynomial(
        r * r, 4.745537017319258e-14, -1.1470455178216906e-11, 2.0876755754879594e-09,
        -2.755731922129809e-07, 2.480158730158451e-05, -0.0013888888888888887, 0.041666666666666664,
    )  # fmt: skip


def _sine(turns: Vector, r: Vector) -> Vector:
    """The sine of r and of so many quarter turns."""
    q = r * r
    sine = (r * q).fma(_sine_rest(r), r)
    cosine = (q * q).fma(_cosine_rest(r), q.fma(-0.5, 1.0))
    value = (turns & 1).differs(0).select(cosine, sine)
    return (value.bits("i8") ^ ((turns & 2) << 62)).bits("f8")


def _huge_sine(x: Vector, more: Vector) -> Vector:
    """The sine of a huge angle and of so many more quarter turns."""
    turns, r, _ = _huge_quarter_turns(x)
    return _sine(turns + more.to("i8"), r)


def sin(x: Vector) -> Vector:
    """The sine."""
    value = x.equals(0.0).select(x, _sine(*_quarter_turns(x)))  # keeps the sign of -0
    return _with_huge(value, _huge_sine, x, x.number(0.0))


def cos(x: Vector) -> Vector:
    """The cosine."""
    turns, r = _quarter_turns(x)
    return _with_huge(_sine(turns + 1, r), _huge_sine, x, x.number(1.0))


def _tangent(turns: Vector, r: Vector, low: Vector) -> Vector:
    """The tangent of r + low and of so many quarter turns."""
    q = r * r
    part = (r * q).fma(_sine_rest(r), low)
    high = q.fma(-0.5, 1.0)
    more = (q * q).fma(_cosine_rest(r), (-r).fma(low, q.fma(-0.5, 1.0 - high)))
    sine, cosine = r + part, high + more
    sine_rest, cosine_rest = r - sine + part, high - cosine + more
    is_odd = (turns & 1).differs(0)
    above, above_rest = is_odd.select(-cosine, sine), is_odd.select(-cosine_rest, sine_rest)
    below, below_rest = is_odd.select(sine, cosine), is_odd.select(sine_rest, cosine_rest)
    ratio, rest = _quotient((above, above_rest), (below, below_rest))
    return ratio + rest


def _huge_tangent(x: Vector) -> Vector:
    return _tangent(*_huge_quarter_turns(x))


def tan(x: Vector) -> Vector:
    """The tangent."""
    shifted = x.fma(0.6366197723675814, _SHIFT)
    turns, k = shifted.bits("i8"), shifted - _SHIFT
    first, second = (-k).fma(1.5707963267948966, x), k * 6.123233995736766e-17
    r, lost = _difference(first, second)  # the remainder, and what it loses by rounding
    low = lost - k.fma(6.123233995736766e-17, -second) - k * -1.4973849048591698e-33
    value = x.equals(0.0).select(x, _tangent(turns, r, low))
    return _with_huge(value, _huge_tangent, x)


# --- exponentials and logarithms ----------------------------------------------------------------


def _power_of_two(k: Vector) -> Vector:
    return ((k + 1023) << 52).bits("f8")


def _scaled(x: Vector, k: Vector) -> Vector:
    """X times 2^k, in two steps, because 2^k itself may be infinite or 0."""
    half = k >> 1
    return x * _power_of_two(half) * _power_of_two(k - half)


def _limited(x: Vector, low: float, high: float) -> Vector:
    limited = (x < high).select(x, x.number(high))
    return (limited > low).select(limited, x.number(low))


def _exp_part(r: Vector) -> Vector:
    """(e^r - 1 - r) / r^2 for r in -0.35..0.35."""
    return polynomial(
        r, 2.510134692835034e-08, 2.7621338669142925e-07, 2.75572664186123e-06,
        2.4801518641395993e-05, 0.00019841269864380513, 0.0013888888918939168,
        0.008333333333329793, 0.04166666666662064, 0.16666666666666669, 0.5,
    )  # fmt: skip


def _exp_of_sum(x: Vector, more: Vector | float = 0.0, halvings: int = 0) -> Vector:
    """E to the x + more, where `more` is far below x, divided by 2 so many times."""
    limited = _limited(x, -746.0, 711.0)  # beyond, the result is infinite or 0 all the same
    shifted = limited.fma(1.4426950408889634, _SHIFT)
    k = shifted - _SHIFT
    r = (-k).fma(_LN2, limited)
    r = (-k).fma(_LN2_REST, r) + more
    value = _exp_part(r).fma(r * r, r) + 1.0
    return _scaled(value, shifted.bits("i8") - (0x4338000000000000 + halvings))


def exp(x: Vector) -> Vector:
    """E to the x."""
    return _is_nan(x).select(x, _exp_of_sum(x))


def exp2(x: Vector) -> Vector:
    """2 to the x."""
    limited = _limited(x, -1080.0, 1030.0)
    shifted = limited + _SHIFT
    rest = limited - (shifted - _SHIFT)
    r, low = rest * _LN2, rest * _LN2_REST
    low = low + rest.fma(_LN2, -r)
    value = (_exp_part(r).fma(r * r, low) + r) + 1.0
    value = _scaled(value, shifted.bits("i8") - 0x4338000000000000)
    return _is_nan(x).select(x, value)


def _mantissa(x: Vector) -> DoubleDouble:
    """The exponent e, and m - 1, for x = 2^e m with m in 0.707..1.414."""
    tiny = x < _SMALLEST_NORMAL  # without a full mantissa
    bits = tiny.select(x * 18014398509481984.0, x).bits("i8")  # times 2^54
    exponent = (bits - 0x3FE6A09E667F3BCD) >> 52
    f = (bits - (exponent << 52)).bits("f8") - 1.0
    return (exponent - tiny.select(exponent.number(54), exponent.number(0))).to("f8"), f


def _log_part(f: Vector) -> Vector:
    """log(1 + f) for f in -0.3..0.42."""
    s = f / (f + 2.0)
    q = s * s
    p = polynomial(
        q, 0.06550360691751746, 0.06633709298237442, 0.07693145267329496, 0.090908973504489,
        0.1111111120027388, 0.14285714285382226, 0.2000000000000047, 0.3333333333333333,
    )  # fmt: skip
    return f - s * (q * -2.0).fma(p, f)


def _logarithm(x: Vector, value: Vector) -> Vector:
    """The value, or infinity or NaN where the logarithm of x is not finite."""
    value = x.equals(math.inf).select(x, value)
    value = x.equals(0.0).select(-math.inf, value)
    return (x >= 0.0).select(value, x.number(math.nan))


def log(x: Vector) -> Vector:
    """The natural logarithm."""
    e, f = _mantissa(x)
    return _logarithm(x, e.fma(_LN2, e.fma(_LN2_REST, _log_part(f))))


def log2(x: Vector) -> Vector:
    """The logarithm to the base 2."""
    e, f = _mantissa(x)
    high, low = _log_pair(f)
    product = high * 1.4426950408889634
    rest = high.fma(1.4426950408889634, -product) + low * 1.4426950408889634
    rest = high.fma(2.0355273740931033e-17, rest)
    return _logarithm(x, e + product + rest)


def log10(x: Vector) -> Vector:
    """The logarithm to the base 10."""
    e, f = _mantissa(x)
    high, low = _log_pair(f)
    product = high * 0.4342944819032518
    rest = high.fma(0.4342944819032518, -product) + low * 0.4342944819032518
    rest = high.fma(1.098319650216765e-17, rest)
    whole = e * 0.3010299956639812
    rest = rest + e.fma(0.3010299956639812, -whole) + e * -2.8037281277851704e-18
    return _logarithm(x, _sum_of(whole, product, rest))


def _sum_of(large: Vector, small: Vector, rest: Vector) -> Vector:
    """The sum of three numbers, the first of which is the largest or 0."""
    total = large + small
    return total + ((large - total) + small + rest)


def log1p(x: Vector) -> Vector:
    """log(1 + x)."""
    u = x + 1.0
    large = absolute(x) > 1.0
    lost = large.select(1.0 - (u - x), x - (u - 1.0))
    value = log(u) + lost / u
    return (x.equals(0.0) | ~(u > 0.0) | u.equals(math.inf)).select(
        u.equals(0.0).select(-math.inf, _nan_where(u < 0.0, x)), value
    )


def _expm1_pair(x: Vector) -> DoubleDouble:
    """E to the x, minus 1, for x in 0..40."""
    shifted = x.fma(1.4426950408889634, _SHIFT)
    k = shifted - _SHIFT
    high = (-k).fma(_LN2, x)
    r = (-k).fma(_LN2_REST, high)
    low = (high - r) - k * _LN2_REST
    scale = _power_of_two(shifted.bits("i8") - 0x4338000000000000)
    total, lost = _difference(scale - 1.0, -(r * scale))
    part = _exp_part(r).fma(r * r, low)
    value, rest = _difference(total, -part * scale)
    return value, rest + lost


def expm1(x: Vector) -> Vector:
    """E to the x, minus 1."""
    limited = _limited(x, -40.0, 710.0)
    shifted = limited.fma(1.4426950408889634, _SHIFT)
    k = shifted - _SHIFT
    high = (-k).fma(_LN2, limited)
    r = (-k).fma(_LN2_REST, high)
    low = (high - r) - k * _LN2_REST
    part = _exp_part(r).fma(r * r, low)
    whole = shifted.bits("i8") - 0x4338000000000000
    half = whole >> 1
    scale, rest = _power_of_two(half), _power_of_two(whole - half)
    less = scale * rest  # 2^k, infinite for k = 1024 alone
    total, lost = _difference(less - 1.0, -(r * less))
    small = total + part.fma(less, lost)
    large = (((part + r) + 1.0) * scale - (1.0 / rest)) * rest
    value = whole.equals(0).select(r + part, (whole > 1000).select(large, small))
    value = (absolute(x) < 1e-17).select(x, value)
    return _is_nan(x).select(x, value)


# --- powers -------------------------------------------------------------------------------------


def _log_pair(f: Vector) -> DoubleDouble:
    """log(1 + f) for f in -0.3..0.42, to about 66 bits."""
    divisor = f + 2.0
    divisor_rest = f - (divisor - 2.0)
    s = f / divisor
    s_rest = ((-s).fma(divisor, f) - s * divisor_rest) / divisor
    q = s * s
    q_rest = s.fma(s, -q) + s * s_rest * 2.0
    p = q * polynomial(
        q, 0.1310072138350349, 0.13267418596474884, 0.15386290534658992, 0.181817947008978,
        0.2222222240054776, 0.2857142857076445, 0.4000000000000094,
    )  # fmt: skip
    third = p + 0.6666666666666666
    third_rest = p - (third - 0.6666666666666666) + 3.700743415417188e-17
    cube = s * q
    cube_rest = s.fma(q, -cube) + s * q_rest + s_rest * q
    term = cube * third
    term_rest = cube.fma(third, -term) + cube * third_rest + cube_rest * third
    double = s * 2.0
    high = double + term
    return high, (double - high) + term + (s_rest * 2.0 + term_rest)


def power(x: Vector, y: Vector) -> Vector:
    """X to the power y; a negative x needs a whole y."""
    size = absolute(x)
    e, f = _mantissa(size)
    part, part_rest = _log_pair(f)
    whole = e * _LN2
    high = whole + part
    low = (whole - high) + part + (e.fma(_LN2, -whole) + e * _LN2_REST + part_rest)
    factor = _limited(y, -1e300, 1e300)
    product = factor * high
    rest = factor.fma(high, -product) + factor * low
    is_safe = absolute(product) < 1000.0
    value = _exp_of_sum(product, is_safe.select(rest, rest.number(0.0)))
    is_one = size.equals(1.0)
    large, small = size > 1.0, size < 1.0
    up = (large & (y > 0.0)) | (small & (y < 0.0))
    infinite = size.equals(math.inf) | size.equals(0.0) | absolute(y).equals(math.inf)
    value = infinite.select(up.select(math.inf, x.number(0.0)), value)
    value = is_one.select(1.0, value)
    is_whole = y.call("trunc").equals(y)
    is_odd = is_whole & (y * 0.5).call("trunc").differs(y * 0.5)
    value = (is_odd & signbit(x)).select(-value, value)
    value = _nan_where((x < 0.0) & ~is_whole & size.differs(math.inf), value)
    value = _nan_where(_is_nan(x) | _is_nan(y), value)
    return (y.equals(0.0) | x.equals(1.0)).select(1.0, value)


def cbrt(x: Vector) -> Vector:
    """The cube root."""
    size = absolute(x)
    tiny = size < _SMALLEST_NORMAL
    size = tiny.select(size * 18014398509481984.0, size)  # times 2^54
    guess = power(size, x.number(1.0 / 3.0))
    guess = guess - (guess * guess * guess - size) / (guess * guess * 3.0)  # a step of Newton's
    value = copysign(tiny.select(guess * 2.0**-18, guess), x)
    return (x.equals(0.0) | ~(size < math.inf)).select(x, value)


# --- hyperbolic functions -----------------------------------------------------------------------


def _half_exponentials(a: Vector) -> DoubleDouble:
    """E^a / 2 and e^-a / 2, for a of 0 or more."""
    up = _exp_of_sum(a, halvings=1)
    return up, 0.25 / up


def sinh(x: Vector) -> Vector:
    """The hyperbolic sine."""
    a = absolute(x)
    up, down = _half_exponentials(a)
    e, e_rest = _expm1_pair(_limited(a, 0.0, 1.0))  # (e + e / (e + 1)) / 2
    ratio, ratio_rest = _quotient((e, e_rest), _plus(e, e_rest, 1.0))
    total, lost = _difference(e, -ratio)
    small = (total + (lost + (e_rest + ratio_rest))) * 0.5
    return copysign((a > 1.0).select(up - down, _is_nan(a).select(a, small)), x)


def cosh(x: Vector) -> Vector:
    """The hyperbolic cosine."""
    up, down = _half_exponentials(absolute(x))
    return _is_nan(x).select(x, up + down)


def tanh(x: Vector) -> Vector:
    """The hyperbolic tangent."""
    a = absolute(x)
    e, e_rest = _expm1_pair(_limited(a, 0.0, 20.0) * 2.0)
    ratio, rest = _quotient((e, e_rest), _plus(e, e_rest, 2.0))
    return copysign(_is_nan(a).select(a, ratio + rest), x)


def _log_of_sum(x: Vector, rest: Vector) -> DoubleDouble:
    """log(1 + x + rest), where `rest` is far below x, a number of 0 or more."""
    u, lost = _plus(x, rest, 1.0)
    e, f = _mantissa(u)
    high, low = _log_pair(f)
    whole = e * _LN2
    low = low + (e.fma(_LN2, -whole) + e * _LN2_REST) + lost / u
    total, lost = _difference(whole, -high)
    return _difference(total, -(lost + low))


def arcsinh(x: Vector) -> Vector:
    """The inverse hyperbolic sine."""
    a = absolute(x)
    root = (a.fma(a, 1.0)).call("sqrt")
    small, _ = _log_of_sum(*_difference(a, -(a * a / (root + 1.0))))
    value = (a > 1e9).select(log(a) + _LN2, small)
    return copysign(value, x)


def arccosh(x: Vector) -> Vector:
    """The inverse hyperbolic cosine."""
    less = x - 1.0
    square = less * less
    total, lost = _difference(less + less, -square)
    root = total.call("sqrt")
    rest = (-root).fma(root, total) + (lost + less.fma(less, -square))
    rest = rest * 0.5 / root.equals(0.0).select(1.0, root)
    high, low = _difference(root, -less)
    small, _ = _log_of_sum(high, low + rest)
    return (x > 1e9).select(log(x) + _LN2, _nan_where(~(x >= 1.0), small))


def arctanh(x: Vector) -> Vector:
    """The inverse hyperbolic tangent."""
    a = absolute(x)
    double = a + a
    ratio = (a < 0.5).select((double * a / (1.0 - a)) + double, double / (1.0 - a))
    return copysign(log1p(ratio) * 0.5, x)


# --- the logarithm of a sum of exponentials -------------------------------------------------------


def _exp_pair(x: Vector, rest: Vector) -> DoubleDouble:
    """E to the x + rest, to about 57 bits, for an x of 0 or less."""
    limited = _limited(x, -746.0, 0.0)
    shifted = limited.fma(1.4426950408889634, _SHIFT)
    k = shifted - _SHIFT
    r, low = _difference((-k).fma(_LN2, limited), k * _LN2_REST - rest)
    part = _exp_part(r).fma(r * r, low)
    value, lost = _difference(x.number(1.0), -r)
    value, lost = _difference(value, -(lost + part))
    whole = shifted.bits("i8") - 0x4338000000000000
    return _scaled(value, whole), _scaled(lost, whole)


def _sum_of_pairs(a: DoubleDouble, b: DoubleDouble) -> DoubleDouble:
    total, lost = _difference(a[0], -b[0])
    return _difference(total, -(lost + (a[1] + b[1])))


def _product_of_pairs(a: DoubleDouble, b: DoubleDouble) -> DoubleDouble:
    product = a[0] * b[0]
    lost = a[0].fma(b[0], -product) + (a[0] * b[1] + a[1] * b[0])
    return _difference(product, -lost)


def _long_expm1(x: Vector, rest: Vector) -> tuple[DoubleDouble, Vector]:
    """E to the r, minus 1, to about 104 bits, and the integer k, where x + rest = r + k log 2."""
    shifted = x.fma(1.4426950408889634, _SHIFT)
    k = shifted - _SHIFT
    product = k * _LN2_REST
    product_rest = k.fma(_LN2_REST, -product) + k * 5.707708438416212e-34
    r = _sum_of_pairs(((-k).fma(_LN2, x), rest), (-product, -product_rest))
    series = [Fraction(1, math.factorial(n)) for n in range(25, 0, -1)]
    value = polynomial(r[0], *map(float, series[:13])), x.number(0.0)
    for term in series[13:]:
        number = float(term)
        pair = x.number(number), x.number(float(term - Fraction(number)))
        value = _sum_of_pairs(_product_of_pairs(value, r), pair)
    return _product_of_pairs(value, r), shifted.bits("i8") - 0x4338000000000000


def _cancelled(high: Vector, distance: Vector, lost: Vector, logarithm: Vector) -> Vector:
    """High + log(1 + e^(distance + lost)), the logarithm nearly -high: a step of Newton's."""
    part, k = _long_expm1(distance, lost)
    value, rest = _sum_of_pairs((high.number(1.0), high.number(0.0)), part)
    part, more = _long_expm1(logarithm, high.number(0.0))
    scale = _power_of_two(more)
    found = _sum_of_pairs((scale - 1.0, high.number(0.0)), (part[0] * scale, part[1] * scale))
    distance, _ = _sum_of_pairs((_scaled(value, k), _scaled(rest, k)), (-found[0], -found[1]))
    total, lost = _difference(high, -logarithm)
    return total + (lost + distance / (found[0] + 1.0))


def logaddexp(x: Vector, y: Vector) -> Vector:
    """log(e^x + e^y); the 50 first bits of the larger number may cancel."""
    is_larger = x > y
    high, low = is_larger.select(x, y), is_larger.select(y, x)
    distance, lost = _difference(low, high)
    lost = (distance > -746.0).select(lost, x.number(0.0))
    logarithm, rest = _log_of_sum(*_exp_pair(distance, lost))
    total, more = _difference(high, -logarithm)
    value = total + (more + rest)
    limit = (logarithm > 1e-15).select(logarithm * 0.2, logarithm)
    near = absolute(value) < limit
    given = [near.select(high, x.number(math.nan)), distance, lost, logarithm]
    long = partial(each_lane, _cancelled)
    value = where_some(near, lambda: outlined("vector_cancelled", long, given), value)
    value = (absolute(high) < math.inf).select(value, high)
    return _nan_where(_is_nan(x) | _is_nan(y), value)


# --- inverse trigonometric functions ------------------------------------------------------------


def _arctan_rest(r: Vector) -> Vector:
    """(arctan r - r) / r^3 for r in -0.4143..0.4143."""
    return polynomial(
        r * r, -0.019029290809743138, 0.03911053674347613, -0.05081236164642543,
        0.058573396761385246, -0.06664417824186955, 0.07692176510795928, -0.09090904289128517,
        0.11111111008107874, -0.14285714284577217, 0.1999999999999509, -0.3333333333333333,
    )  # fmt: skip


def arctan2(y: Vector, x: Vector) -> Vector:
    """The angle of the point (x, y), in -pi..pi."""
    a, b = absolute(x), absolute(y)
    swap = a < b
    low, high = swap.select(a, b), swap.select(b, a)
    high = high.equals(0.0).select(1.0, high)
    both = low.equals(math.inf)
    low, high = both.select(1.0, low), both.select(1.0, high)
    scale = (high > _ROOT).select(0.25, (high < 1.0 / _ROOT).select(_ROOT, x.number(1.0)))
    low, high = low * scale, high * scale
    # Beyond tan(pi/8), pi/4 + arctan((low - high) / (low + high))
    large = low > high * 0.41421356237309503
    rise, rise_rest = _difference(low, high)
    run, run_rest = _difference(high, -low)
    rise, rise_rest = large.select(rise, low), large.select(rise_rest, x.number(0.0))
    run, run_rest = large.select(run, high), large.select(run_rest, x.number(0.0))
    r, rest = _quotient((rise, rise_rest), (run, run_rest))
    rest = (high < math.inf).select(rest, x.number(0.0))
    q = r * r
    rest = (r * q).fma(_arctan_rest(r), rest - rest * q)
    # Now the angle is r + rest from a multiple of pi/4, upwards or downwards.
    left = signbit(x)
    down = (swap ^ left).select(-1.0, x.number(1.0))
    quarter = left.select(2.356194490192345, x.number(0.7853981633974483))
    quarter_rest = left.select(9.184850993605148e-17, x.number(3.061616997868383e-17))
    whole = swap.select(1.5707963267948966, left.select(3.141592653589793, x.number(0.0)))
    start = large.select(quarter, whole)
    start_rest = large.select(quarter_rest, whole * 3.8981718325193755e-17)
    r, rest = r * down, rest * down
    value = start + r
    value = value + (start - value + r + (rest + start_rest))
    return _nan_where(_is_nan(x) | _is_nan(y), copysign(value, y))


def arctan(x: Vector) -> Vector:
    """The arctangent."""
    return arctan2(x, x.number(1.0))


def arcsin(x: Vector) -> Vector:
    """The arcsine."""
    return arctan2(x, (-x).fma(x, 1.0).call("sqrt"))


def arccos(x: Vector) -> Vector:
    """The arccosine."""
    return arctan2((-x).fma(x, 1.0).call("sqrt"), x)


def hypot(x: Vector, y: Vector) -> Vector:
    """The length of the vector (x, y)."""
    a, b = absolute(x), absolute(y)
    swap = a < b
    low, high = swap.select(a, b), swap.select(b, a)
    large, small = high > _ROOT, high < 1.0 / _ROOT
    scale = large.select(2.0**-600, small.select(2.0**600, x.number(1.0)))
    low, high = low * scale, high * scale
    root = low.fma(low, high * high).call("sqrt") / scale
    infinite = a.equals(math.inf) | b.equals(math.inf)
    return infinite.select(math.inf, root)


# --- division with a remainder, and rounding --------------------------------------------------


def _exponent(x: Vector) -> Vector:
    tiny = x < _SMALLEST_NORMAL
    bits = tiny.select(x * 18014398509481984.0, x).bits("i8") >> 52  # times 2^54
    return bits - tiny.select(bits.number(54), bits.number(0))


def _reduced(a: Vector, b: Vector) -> Vector:
    """The remainder of a / b, for a of 0 or more and b above 0: exact in a few steps.

    A step takes off multiples of b, or of b times a power of two, of which a holds less than 2^52.
    """
    builder, before = a.builder, a.builder.block
    step, behind = builder.append_basic_block("step"), builder.append_basic_block("behind")
    builder.branch(step)
    builder.position_at_end(step)
    rest = Vector(builder, builder.phi(a.value.type), "f8")
    rest.value.add_incoming(a.value, before)
    gap = _exponent(rest) - _exponent(b) - 51
    multiple = _scaled(b, (gap > 0).select(gap, gap.number(0)))
    following = (-(rest / multiple).call("trunc")).fma(multiple, rest)
    following = (following < 0.0).select(following + multiple, following)
    following = (following >= multiple).select(following - multiple, following)
    following = (rest < b).select(rest, following)
    rest.value.add_incoming(following.value, builder.block)
    builder.cbranch((following >= b).count().differs(0).value, step, behind)
    builder.position_at_end(behind)
    return following


def fmod(x: Vector, y: Vector) -> Vector:
    """The remainder of x / y, with the sign of x."""
    a, b = absolute(x), absolute(y)
    usual = (a < math.inf) & (b > 0.0) & (b < math.inf)
    rest = _reduced(usual.select(a, a.number(0.0)), usual.select(b, b.number(1.0)))
    rest = usual.select(rest, b.equals(math.inf).select(a, a.number(math.nan)))
    return copysign(_nan_where(~(a < math.inf) | _is_nan(y), rest), x)


def remainder(x: Vector, y: Vector) -> Vector:
    """The remainder of x / y, with the sign of y."""
    rest = fmod(x, y)
    turned = rest.differs(0.0) & (signbit(rest) ^ signbit(y))
    value = turned.select(rest + y, rest)
    return value.equals(0.0).select(copysign(value, y), value)


def floor_divide(x: Vector, y: Vector) -> Vector:
    """The largest whole number up to x / y."""
    rest = fmod(x, y)
    whole = (x - rest) / y
    turned = rest.differs(0.0) & (signbit(rest) ^ signbit(y))
    whole = turned.select(whole - 1.0, whole)
    floor = whole.call("floor")
    floor = (whole - floor > 0.5).select(floor + 1.0, floor)
    floor = whole.equals(0.0).select(copysign(whole * 0.0, x / y), floor)
    return y.equals(0.0).select(x / y, floor)


def sign(x: Vector) -> Vector:
    """-1, 0 or 1; NaN where the number is not a number."""
    value = copysign(x.number(1.0), x)
    return x.equals(0.0).select(x.number(0.0), _is_nan(x).select(x, value))


def maximum(x: Vector, y: Vector) -> Vector:
    """The larger number; NaN where one is not a number."""
    return _nan_where(_is_nan(x) | _is_nan(y), (x > y).select(x, y))


def minimum(x: Vector, y: Vector) -> Vector:
    """The smaller number; NaN where one is not a number."""
    return _nan_where(_is_nan(x) | _is_nan(y), (x < y).select(x, y))


def _of_llvm(name: str) -> Callable[[Vector], Vector]:
    return lambda x: x.call(name)


FUNCTIONS: dict[str, Callable[..., Vector]] = {
    "add": lambda x, y: x + y, "subtract": lambda x, y: x - y, "multiply": lambda x, y: x * y,
    "divide": lambda x, y: x / y, "negative": lambda x: -x, "absolute": absolute,
    "sqrt": _of_llvm("sqrt"),
    "floor": _of_llvm("floor"), "ceil": _of_llvm("ceil"), "trunc": _of_llvm("trunc"),
    "rint": _of_llvm("rint"), "sign": sign, "copysign": copysign,
    "maximum": maximum, "minimum": minimum,
    "fmax": lambda x, y: _is_nan(x).select(y, _is_nan(y).select(x, (x > y).select(x, y))),
    "fmin": lambda x, y: _is_nan(x).select(y, _is_nan(y).select(x, (x < y).select(x, y))),
    "fmod": fmod, "remainder": remainder, "floor_divide": floor_divide,
    **{function.__name__: function for function in (
        power, cbrt, exp, exp2, expm1, log, log2, log10, log1p, sin, cos, tan, arcsin, arccos,
        arctan, arctan2, hypot, logaddexp, sinh, cosh, tanh, arcsinh, arccosh, arctanh, signbit,
    )},
    "less": lambda x, y: x < y, "less_equal": lambda x, y: x <= y, "greater": lambda x, y: x > y,
    "greater_equal": lambda x, y: x >= y, "equal": lambda x, y: x.equals(y),
    "not_equal": lambda x, y: x.differs(y), "logical_and": lambda x, y: x & y,
    "logical_or": lambda x, y: x | y, "logical_xor": lambda x, y: x ^ y,
    "logical_not": lambda x: ~x, "isnan": _is_nan,
    "isinf": lambda x: absolute(x).equals(math.inf), "isfinite": lambda x: absolute(x) < math.inf,
    "where": lambda mask, x, y: mask.select(x, y), "float": lambda mask: mask.to("f8"),
}  # fmt: skip
"""The function of vectors for each operation of a program, but for "take"."""
