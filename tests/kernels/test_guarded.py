"""A formula's mistakes are errors with a line: nothing is read or computed that is not there."""

import inspect
import math
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


RIGHT = [
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
    (lambda t: TABLE[np.array([0, t])][0], 3, "IndexError: index is out of bounds"),
    (lambda x: TABLE[np.int64(x)], math.nan, "IndexError: index -9223372036854775808 is .*"),
    (lambda x: TABLE[np.int64(x)], 1e300, "IndexError: index -9223372036854775808 is .*"),
    (lambda x: TABLE[np.uint8(x)], -5.0, "ValueError: NaN, infinity or .*"),
    (lambda t: PAIR[t], 2, "IndexError: tuple index out of range"),
    (lambda t: [1.0, 2.0][t], 2, "IndexError: .* out of range"),
    (look_up, 3, "IndexError: index 3 .*"),
    (written, 3, "IndexError: index is out of bounds"),
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
        r"model mine: transition failed: IndexError: index 3 .*:(\d+)\)$", str(error.value)
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
