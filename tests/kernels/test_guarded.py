"""A formula's mistakes are errors with a line: nothing is read or computed that is not there."""

import inspect
import math
import operator
import re

import numpy as np
import pytest
from numba import njit

from pfdist.errors import CompileError, ModelError
from pfdist.kernels.formulas import formula, formulas_of

TABLE = np.array([1.0, 2.0, 3.0])
SQUARE = np.arange(6.0).reshape(2, 3)
PLACES = np.array([0, 2, 5])
PAIR = (1.0, 2.0)
MANY = np.arange(100.0, 120.0)
LEAST, LARGEST = -(2**63), 2**63 - 1
FIT = "an integer must fit 64 bits .*"


def look_up(k):
    return TABLE[k]


@njit
def compiled_look_up(k):
    return TABLE[k]


def written(t):
    values = np.zeros(3)
    values[t] = 1.0
    return values[0]


def caught(t):
    try:
        return TABLE[t]
    except Exception:  # Numba knows no other
        return -1.0


def factorial(n):
    return 1 if n < 2 else n * factorial(n - 1)


def even(n):
    return n == 0 or odd(n - 1)


def odd(n):
    return n != 0 and even(n - 1)


def added(t):
    t += t
    return t


def narrow(t):
    values = np.zeros(3, np.int8)
    values[0] = t
    return values[0]


def np_int8(t):
    return np.int8(t)


def np_uint8(t):
    return np.uint8(t)


def np_int32(t):
    return np.int32(t)


def added_in_place(t):
    values = np.zeros(16)
    part = values[:3]
    part += MANY[:t]
    return part[0]


RIGHT = [
    (lambda t: t + LARGEST - 1 + 0 * t, (0, -1)),
    (lambda t: pow(t, 3) + sum([t, 2]) + abs(-t) - (-t), (0, 5, -5)),
    (lambda t: np.int8(t) + np.uint8(abs(t)), (0, 127, -127)),
    (lambda t: np.left_shift(1, t) + np.right_shift(-9, t), (0, 3, 62, 64, 70, -1)),
    (lambda t: math.ldexp(1.5, t), (0, 3, -3, -(2**40))),
    (added_in_place, (1, 3)),
    (lambda t: TABLE[t], (0, 2, -1, -3)),
    (lambda t: SQUARE[t, t] + SQUARE[t][-1] + SQUARE.T[t, 0], (0, 1, -1, -2)),
    (lambda t: PAIR[t], (0, 1, -1, -2)),
    (lambda t: TABLE[PLACES[t]], (0, 1)),
    (lambda t: np.sum(TABLE[t:]) + TABLE[:t].size, (0, 2, 7, -1)),
    (lambda t: t // 3 + t % 3 + t / 4 + divmod(t, -3)[1], (0, 5, -5)),
    (lambda t: t * 10**18 + (t << 3) + (t >> 1) + t**2, (0, 9, -9)),
    (lambda t: t**20 + 2**t, (0, 3, 8)),
    (lambda x: TABLE[int(x)] + math.floor(x) + math.ceil(-x) + round(x), (0.0, 1.5, 2.75)),
    (lambda t: look_up(t) + compiled_look_up(t) + caught(t), (0, 2, -1)),
    (caught, (3, -4)),
]
WRONG = [
    (lambda t: TABLE[t], 3, "IndexError: index 3 is out of bounds for axis 0 with size 3 at t = 3"),
    (lambda t: TABLE[t], -4, "IndexError: index -4 is out of bounds for axis 0 with size 3 .*"),
    (lambda t: TABLE[5], 0, "IndexError: index 5 is out of bounds for axis 0 with size 3 .*"),
    (lambda t: TABLE[t], 2**62, "IndexError: index 4611686018427387904 is out of bounds .*"),
    (lambda t: TABLE[t], -(2**63), "IndexError: index -9223372036854775808 is out of bounds .*"),
    (lambda t: SQUARE[t, 0], 2, "IndexError: index 2 is out of bounds for axis 0 with size 2 .*"),
    (lambda t: SQUARE[0, t], 3, "IndexError: index 3 is out of bounds for axis 1 with size 3 .*"),
    (lambda t: SQUARE[t][0], 2, "IndexError: index 2 is out of bounds for axis 0 with size 2 .*"),
    (lambda t: TABLE[:t][2], 1, "IndexError: index 2 is out of bounds for axis 0 with size 1 .*"),
    (lambda t: TABLE[PLACES[t]], 2, "IndexError: index 5 is out of bounds .*"),
    (lambda t: TABLE[np.array([0, t])][0], 3, "IndexError: index is out of bounds at t = 3"),
    (lambda x: TABLE[np.int64(x)], math.nan, "IndexError: index -9223372036854775808 is .*"),
    (lambda x: TABLE[np.int64(x)], 1e300, "IndexError: index -9223372036854775808 is .*"),
    (lambda x: TABLE[np.uint8(x)], -5.0, "ValueError: NaN, infinity or .*"),
    (lambda t: PAIR[t], 2, "IndexError: tuple index out of range at t = 2"),
    (lambda t: [1.0, 2.0][t], 2, "IndexError: .* out of range at t = 2"),
    (look_up, 3, "IndexError: index 3 .*"),
    (written, 3, "IndexError: index is out of bounds at t = 3"),
    (lambda t: 1 // (t - 3), 3, "ZeroDivisionError: .* by zero at t = 3"),
    (lambda t: 1 % (t - 3), 3, "ZeroDivisionError: .* by zero at t = 3"),
    (lambda t: 1 / (t - 3), 3, "ZeroDivisionError: division by zero at t = 3"),
    (lambda t: divmod(1, t - 3)[0], 3, "ZeroDivisionError: .* by zero at t = 3"),
    (lambda t: t * 10**18, 10, "OverflowError: an integer must fit 64 bits .*"),
    (lambda t: t**20, 9, "OverflowError: an integer must fit 64 bits .*"),
    (lambda t: 1 << t, 63, "OverflowError: an integer must fit 64 bits .*"),
    (lambda t: 1 << t, 64, "ValueError: a shift must be by 0 to 63 bits, got 64 at t = 64"),
    (lambda t: 1 >> t, -1, "ValueError: a shift must be by 0 to 63 bits, got -1 at t = -1"),
    (lambda t: 2**t, -1, "ValueError: a negative power of an integer must be written .*"),
    (lambda t: np.power(2, t), -1, "ValueError: a negative power of an integer must be .*"),
    (lambda t: pow(10, t), 20, f"OverflowError: {FIT} at t = 20"),
    (lambda t: pow(2, t), -1, "ValueError: a negative power of an integer must be .*"),
    (lambda t: t + 2**62, 2**62, f"OverflowError: {FIT} at t = .*"),
    (lambda t: t - 2**62, -(2**62) - 5, f"OverflowError: {FIT} at t = .*"),
    (added, 2**62, f"OverflowError: {FIT} at t = .*"),
    (lambda t: operator.add(t, t), 2**62, f"OverflowError: {FIT} at t = .*"),
    (lambda t: -t, LEAST, f"OverflowError: {FIT} at t = .*"),
    (lambda t: abs(t), LEAST, f"OverflowError: {FIT} at t = .*"),  # noqa: PLW0108
    (lambda t: sum([t, t]), 2**62, f"OverflowError: {FIT} at t = .*"),
    (lambda t: sum((t, t), t), 2**62, f"OverflowError: {FIT} at t = .*"),
    (lambda t: t // -1, LEAST, f"OverflowError: {FIT} at t = .*"),
    (lambda t: divmod(t, -1)[0], LEAST, f"OverflowError: {FIT} at t = .*"),
    (np_int8, 300, "OverflowError: the integer 300 is out of bounds for int8 .*"),
    (np_uint8, -1, "OverflowError: the integer -1 is out of bounds for uint8 .*"),
    (np_int32, 2**40, "OverflowError: the integer 1099511627776 is out of .*"),
    (narrow, 300, "OverflowError: the integer 300 is out of bounds for int8 at t = 300"),
    (lambda t: math.ldexp(1.0, t), 2**40, "OverflowError: math range error at t = .*"),
    (lambda t: np.take(TABLE, t), 3, "IndexError: Index out of bounds at t = 3"),
    (lambda t: TABLE[..., t], 3, "IndexError: index is out of bounds at t = 3"),
    (lambda t: SQUARE[t, :][0], 2, "IndexError: index is out of bounds at t = 2"),
    (added_in_place, 5, "ValueError: an array of size 5 does not fit axis 0 with size 3 at t = 5"),
    (lambda t: np.add(MANY[:t], 1.0, np.zeros(3))[0], 5, "ValueError: an array of size 5 .*"),
    (lambda x: int(x), math.nan, "ValueError: NaN, infinity or .*"),  # noqa: PLW0108
    (lambda x: math.floor(x), math.inf, "ValueError: NaN, infinity or .*"),  # noqa: PLW0108
]


@pytest.mark.parametrize(("function", "arguments"), RIGHT)
def test_what_is_right_gives_what_python_gives(function, arguments):
    compiled = formula(function)
    for argument in arguments:
        assert compiled(argument) == function(argument)


@pytest.mark.parametrize(("function", "argument", "says"), WRONG)
def test_what_is_wrong_is_an_error_with_its_line(function, argument, says):
    lines, first = inspect.getsourcelines(function)
    with pytest.raises(ModelError) as error, formulas_of("mine", {"initial": function}):
        formula(function, "initial")(argument)
    found = re.fullmatch(
        rf"model mine: initial failed: {says} \(\S*test_guarded\.py:(\d+)\)", str(error.value)
    )
    assert found, error.value
    assert first <= int(found[1]) < first + len(lines)


@pytest.mark.parametrize("helper", [look_up, compiled_look_up])
def test_a_helpers_line_is_told_with_the_formulas_name(helper):
    def transition(t):
        return helper(t + 1)

    inside = getattr(helper, "py_func", helper).__code__.co_firstlineno
    with pytest.raises(ModelError) as error, formulas_of("mine", {"transition": transition}):
        formula(transition, "transition")(2)
    found = re.match(
        r"model mine: transition failed: IndexError: index 3 .* at t = 2 .*:(\d+)\)$",
        str(error.value),
    )
    assert found, error.value
    assert inside < int(found[1]) <= inside + 2


@pytest.mark.parametrize("function", [factorial, even, lambda t: TABLE.flat[t]])
def test_what_could_not_be_checked_is_not_compiled(function):
    # A formula that calls itself may exhaust the stack, and so end the process.
    with pytest.raises(CompileError), formulas_of("mine", {}):
        formula(function)(2)


@pytest.mark.parametrize(("x", "y"), [(0.0, math.inf), (math.nan, math.nan)])
def test_floats_are_divided_as_numpy_divides_them(x, y):
    np.testing.assert_equal(formula(lambda x: 1 / x)(x), y)
    np.testing.assert_equal(formula(lambda x: 1.0 // x)(x), y)
    np.testing.assert_equal(formula(lambda x: 1.0 % x)(x), math.nan)
