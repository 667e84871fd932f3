"""Check what a model's author may write in a formula, and what the author is told otherwise."""

import importlib
import inspect
import math
import operator
import re
from itertools import count
from math import cos as math_cos
from types import ModuleType

import numpy as np
import pytest
from numba import njit
from numpy import cos

import pfdist.kernels
from pfdist import clip, where
from pfdist.errors import CompileError, ModelError
from pfdist.kernels.formulas import checks_indices, compiled_formulas, formula
from pfdist.kernels.overloads import ELEMENTARY

FACTOR = 0.25
PAIR = (2.0, 3.0)
TABLE = np.array([1.0, 2.0, 3.0])
SQUARE = np.arange(6.0).reshape(2, 3)
NAMES = {"a": 1.0}
helpers = ModuleType("helpers")
helpers.OFFSET = 0.5


def helper(x):
    return np.cos(x)


def helper_of_helper(x):
    return helper(x)


def closure():
    numpy, function, nested = np, math.cos, helper
    return [lambda x: -numpy.cos(x), lambda x: -function(x), lambda x: -nested(x)]


def with_a_function_inside(x):
    def inside(y):
        return np.cos(y)

    return -inside(x)


@njit
def ours(x):
    return COSINE(x)


COSINE = ELEMENTARY["cos"]


@pytest.mark.parametrize(
    "function",
    [
        lambda x: -np.cos(x),
        lambda x: -math.cos(x),
        lambda x: -cos(x),
        lambda x: -math_cos(x),
        *closure(),
        lambda x: -helper(x),
        lambda x: -helper_of_helper(x),
        with_a_function_inside,
    ],
    ids=[
        *("np.", "math.", "from numpy", "from math"),
        *("closure over np", "closure over a function", "closure over a helper"),
        *("helper", "helper of a helper", "function inside"),
    ],
)
def test_a_formula_has_our_elementary_functions_however_it_names_them(function):
    # An argument at which ours is a last bit from NumPy's and the standard library's shows which.
    arguments = (0.1 * i for i in count(1))
    x = next(x for x in arguments if ours(x) not in {float(np.cos(x)), math.cos(x)})
    assert formula(function)(x) == -ours(x)
    assert ours(x) == pytest.approx(math.cos(x), rel=1e-15)


def test_as_it_stands_a_formula_has_numpys_functions():
    x = np.linspace(0, 100, 1000)
    compiled_before = formula(helper)
    assert compiled_before(1.0) == ours(1.0)
    assert helper(x).tobytes() == np.cos(x).tobytes()


def branching(x, t):
    if x > FACTOR:
        y = x - 1
    elif t == 2:
        return PAIR[1]
    else:
        y = -x
    for _ in range(t):
        y = y / 2
    return y if y > 0 else math.pi * y


@pytest.mark.parametrize("t", [0, 2])
@pytest.mark.parametrize("x", [-2.0, 0.125, 0.5, 3.0])
def test_branches_and_loops_are_kept(x, t):
    assert formula(branching)(x, t) == branching(x, t)


@pytest.mark.parametrize(
    "function",
    [
        lambda t: FACTOR * PAIR[t] + TABLE[t],
        lambda t: helpers.OFFSET + math.pi + np.e,
        lambda t: where(t > 0, FACTOR, 1.0) + clip(t, 0.5, 0.75),
        lambda t, k=FACTOR: k + abs(t) + np.sqrt(t) + np.maximum(t, 1) + math.floor(1.5 * t),
    ],
    ids=["module constants", "attributes of modules", "where and clip", "default and others"],
)
def test_a_formula_gives_what_it_gives_uncompiled(function):
    assert [formula(function)(t) for t in (0, 1)] == [function(t) for t in (0, 1)]


@pytest.mark.parametrize(("numerator", "quotient"), [(1.0, np.inf), (-1.0, -np.inf), (0.0, np.nan)])
def test_a_formula_divides_by_zero_as_numpy_does(numerator, quotient):
    np.testing.assert_equal(formula(lambda a, b: a / b)(numerator, 0.0), quotient)
    np.testing.assert_equal(formula(lambda a, b: -divided(-a, b))(numerator, 0.0), quotient)


def divided(a, b):
    return a / b


def test_infinity_and_nan_are_numbers_to_a_formula():
    # The compiler may not assume that these do not occur.
    finite = formula(lambda x: where(abs(x) < math.inf, 1.0, 0.0))
    assert [finite(x) for x in (1.0, math.inf, -math.inf, math.nan)] == [1, 0, 0, 0]
    assert formula(lambda x: x != x)(math.nan)  # noqa: PLR0124


# --- what goes wrong ---


def reshaped(x):
    return np.reshape(x, np.shape(x))


def looked_up(x):
    return NAMES["a"] * x


def misspelt(x):
    return np.cosinus(x)


def in_a_helper(x):
    return 1.0 + reshaped(x)


def asserting(x):
    if x > 0:
        raise AssertionError("x must not be positive")
    return x


@pytest.mark.parametrize(
    ("function", "at_fault", "reason"),
    [
        (reshaped, reshaped, "reshape"),
        (looked_up, looked_up, "NAMES"),
        (in_a_helper, reshaped, "reshape"),
    ],
    ids=["a function Numba lacks", "a dict", "in a helper"],
)
def test_what_numba_lacks_is_told_in_one_line_with_its_place(function, at_fault, reason):
    with pytest.raises(CompileError) as error, compiled_formulas("mine", lambda: "it"):
        formula(function)(0.5)
    line = inspect.getsourcelines(at_fault)[1] + 1
    told = rf"model mine cannot be compiled by Numba: .*{reason}.* \(\S*test_formulas\.py:{line}\);"
    assert re.match(told, str(error.value))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("function", [misspelt, asserting])
def test_a_misspelt_name_and_a_failed_assertion_are_the_models_fault(function):
    with pytest.raises(ModelError), compiled_formulas("mine", lambda: "it"):
        formula(function)(0.5)


@njit
def compiled_look_up(k):
    return TABLE[k]


def written(k):
    values = np.zeros(3)
    values[k] = 1.0
    return values[0]


@pytest.mark.parametrize(
    ("function", "index"),
    [
        (lambda k: TABLE[k], 3),
        (lambda k: TABLE[k], -4),
        (lambda k: TABLE[k], 2**62),
        (lambda k: TABLE[5] + k, 0),
        (lambda k: TABLE[np.int64(k)], math.nan),
        (lambda k: SQUARE[k, 0], 2),
        (lambda k: SQUARE[k][0], 2),
        (lambda k: SQUARE[k, :][0], 2),
        (lambda k: TABLE[:k][2], 1),
        (lambda k: TABLE[np.array([0, k])][0], 3),
        (lambda k: PAIR[k], 2),
        (lambda k: [1.0, 2.0][k], 2),
        (lambda k: compiled_look_up(k), 3),  # noqa: PLW0108
        (written, 3),
    ],
)
def test_an_index_outside_is_an_error_and_reads_no_foreign_memory(function, index):
    with pytest.raises(IndexError):
        formula(function)(index)


def applied(function, k):
    return function(k)


@pytest.mark.parametrize(
    "function",
    [
        lambda k: applied(lambda i: TABLE[i], k),
        lambda k: sum(map(lambda i: TABLE[i], (k, k))),  # noqa: C417
        lambda k: TABLE.flat[k],
        lambda k: operator.getitem(TABLE, k),
        lambda k: np.take(SQUARE, k, axis=0)[0],
        lambda k: np.take_along_axis(TABLE, np.array([k]), 0)[0],
    ],
    ids=["lambda", "map", "flat", "getitem", "take of an axis", "take_along_axis"],
)
def test_an_index_that_numba_does_not_check_is_not_compiled(function):
    message = r"unsupported .*test_formulas\.py:\d+"
    with pytest.raises(CompileError, match=message), compiled_formulas("mine", lambda: "it"):
        formula(function)(0)


def in_time(x, t, w, p):
    return (p.rate[t] * x[0] + w[0],)


def in_time_by_another_name(x, instant, w, p):
    return (p.rate[instant] * x[0] + w[0],)


def later(x, t, w, p):
    t += 1
    return (p.rate[t] * x[0] + w[0],)


def matched(x, t, w, p):
    match t + 1:
        case t:
            pass
    return (p.rate[t] * x[0] + w[0],)


def without_t(w, p):
    return (p.rate[t] + w[0],)  # noqa: F821  a global variable


def in_a_lambda(x, t, w, p):
    return (sum(p.rate[t] for t in (t + 1,)),)


@pytest.mark.parametrize(
    ("function", "checked"),
    [
        (in_time, False),
        (in_time_by_another_name, True),
        (later, True),
        (without_t, True),
        (matched, True),
        (in_a_lambda, True),
        (lambda x, t, w, p: (x[0] + TABLE[t],), True),
        (lambda x, t, w, p: (p.rate[t] + x[0],), False),
        (lambda y, t: y[0], False),
        (lambda y=TABLE: y[100], True),
    ],
)
def test_only_a_parameter_at_t_needs_no_check(function, checked):
    assert checks_indices(function) == checked


def test_what_fails_in_compiled_code_alone_is_told_with_what_was_computed():
    def again():
        return "draw 7"

    message = "^model mine: a compiled formula failed in draw 7: ValueError: no; it does not fail"
    with pytest.raises(ModelError, match=message), compiled_formulas("mine", again):
        raise ValueError("no")


def test_what_is_no_formulas_fault_passes():
    with pytest.raises(KeyboardInterrupt), compiled_formulas("mine", lambda: "it"):
        raise KeyboardInterrupt


@pytest.mark.parametrize("base", [10.0, 2, math.e])
def test_the_logarithm_of_the_standard_library_may_have_a_base(base):
    compiled = formula(lambda x: math.log(x, base))
    assert compiled(7.0) == pytest.approx(math.log(7.0, base), rel=1e-15)


# --- compiled arithmetic is NumPy's ---


@pytest.mark.parametrize(
    "function",
    [
        lambda a, b, c, d: a * b + c,
        lambda a, b, c, d: a * b - c * d,
        lambda a, b, c, d: a**2 - b**2,
        lambda a, b, c, d: (a + b) / 49.0 - c / d,
        lambda a, b, c, d: np.sqrt(np.abs(a * a - b * c)) + d / 3,
    ],
)
def test_each_operation_is_rounded_as_in_numpy(function):
    """IEEE 754: nothing is fused, reordered, or replaced by a reciprocal."""
    rng = np.random.default_rng(1)
    numbers = rng.normal(size=(4, 1000)) * 10.0 ** rng.integers(-3, 4, (4, 1000))
    compiled = formula(function)
    one_by_one = np.array([compiled(*column) for column in numbers.T.tolist()])
    assert one_by_one.tobytes() == function(*numbers).tobytes()


def test_equal_numbers_differ_by_zero():
    # Fused, x * x - p * p is the rounding error of 0.1 * 0.1; and 49 * (1 / 49) is less than 1.
    assert formula(lambda x, p: x * x - p * p)(0.1, 0.1) == 0.0
    assert formula(lambda x: x * x - 0.1 * 0.1)(0.1) == 0.0
    assert formula(lambda x, p: x / p)(49.0, 49.0) == 1.0
    assert formula(lambda x: x / 49.0 - 1.0)(49.0) == 0.0


@pytest.mark.parametrize(
    "function", [lambda a, b, c: a * b + c, lambda a, p: a / p, lambda x, p: x / 3 + p * x]
)
def test_llvm_is_given_no_liberty(function):
    compiled = formula(function)
    compiled(*(0.5,) * function.__code__.co_argcount)
    (module,) = compiled._standing.inspect_llvm().values()
    assert not re.search(r"\bf(add|sub|mul|div) (fast|reassoc|arcp|contract|afn)\b", module)


# --- without Numba's compiler there are no filters ---


@pytest.mark.parametrize("value", ["1", "yes", "x" * 10_000, "", "0"])
def test_a_compiler_that_is_switched_off_is_named(value, monkeypatch):
    monkeypatch.setenv("NUMBA_DISABLE_JIT", value)
    if value in ("", "0"):
        assert importlib.reload(pfdist.kernels) is pfdist.kernels
        return
    with pytest.raises(CompileError, match=r"NUMBA_DISABLE_JIT must be 0 .* got") as refused:
        importlib.reload(pfdist.kernels)
    assert len(str(refused.value)) < 400
