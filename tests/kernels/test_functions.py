"""Functions of formulas: 2 units in the last place, and NumPy's special values."""

import numpy as np
import pytest

from oracles.computed import called_elsewhere, computed, formula
from oracles.exact import VALUES, arguments, nearest_to_quarter_turns, units_apart
from oracles.in_turn import in_turn
from pfdist.kernels.functions import FUNCTIONS
from pfdist.kernels.lowering import Half
from pfdist.models.program import Operation
from pfdist.models.symbols import UFUNCS

SPECIAL = np.array(
    [
        *(0.0, -0.0, 1.0, -1.0, 0.5, -0.5, 2.0, -3.0, 1e300, -1e300, 5e-324, -5e-324),
        *(2.0**-1022, np.inf, -np.inf, np.nan, 1e-17, 710.0, -745.2, 3.7),
        *(2.0**1023, -np.finfo(float).max),
    ]
)
TOLERANCE = 2.0  # units in the last place
ONE = (
    *("sqrt", "exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "sin", "cos", "tan"),
    *("arcsin", "arccos", "arctan", "sinh", "cosh", "tanh", "arcsinh", "arccosh", "arctanh"),
    *(
        "cbrt",
        "square",
        "reciprocal",
        "deg2rad",
        "rad2deg",
        "floor",
        "ceil",
        "trunc",
        "rint",
        "sign",
        "negative",
        "absolute",
    ),
    *("isnan", "isinf", "isfinite", "signbit"),
)
TWO = (
    *("add", "subtract", "multiply", "divide", "power", "arctan2", "hypot", "copysign"),
    *("fmod", "remainder", "floor_divide", "logaddexp", "maximum", "minimum", "fmax", "fmin"),
    *("less", "less_equal", "greater", "greater_equal", "equal", "not_equal"),
)
ROUND = tuple(VALUES)
SAME = {  # universal functions that record what another does
    "true_divide": "divide", "float_power": "power", "radians": "deg2rad", "degrees": "rad2deg",
    "fabs": "absolute", "divmod": "floor_divide", "invert": "logical_not",
    "bitwise_and": "logical_and", "bitwise_or": "logical_or", "bitwise_xor": "logical_xor",
}  # fmt: skip
OTHER = {"logical_and", "logical_or", "logical_xor", "logical_not", "positive", "heaviside"}


def values_of(name, *values):
    """The values of a function, whether it is an operation or a formula of several."""
    if name in FUNCTIONS:
        return computed(name, *values)
    return formula(getattr(np, name))(*values)


def units(got, expected):
    """The distance in units in the last place of the expected value; 0 where both are the same."""
    with np.errstate(over="ignore"):
        rounded = expected.astype(np.float64)
    same = (got == rounded) | (np.isnan(got) & np.isnan(rounded))
    with np.errstate(all="ignore"):
        apart = np.abs(got - expected) / np.spacing(np.abs(rounded))
    return np.where(same, 0.0, np.where(np.isnan(apart), np.inf, apart)).astype(np.float64)


def worst(name, values, got):
    """The largest distance from the exact value, and its arguments."""
    rows = [tuple(map(float, row)) for row in zip(got, *values, strict=True)]
    return max(((units_apart(name, *row), row[1:]) for row in rows), default=(0.0, ()))


def where_finite(name, values, got):
    """Where the value is a finite number; elsewhere it is asserted that it is NumPy's."""
    with np.errstate(all="ignore"):
        expected = getattr(np, name)(*values)
    other = np.isnan(expected) | (np.isinf(expected) & (got == expected))
    np.testing.assert_array_equal(got[other], expected[other])
    assert not np.isnan(got[~other]).any()
    return ~other


def test_each_universal_function_that_is_recorded_is_tested():
    assert {SAME.get(each, each) for each in UFUNCS} <= {*ROUND, *ONE, *TWO, *OTHER}


@pytest.mark.parametrize("name", ROUND)
def test_values_are_within_two_units_in_the_last_place(name):
    """Against mpmath, at 400 arguments of the whole range: subnormal, negative and huge, too."""
    values = arguments(name, 400, np.random.default_rng(1))
    got = values_of(name, *values)
    finite = where_finite(name, values, got)
    apart, where = worst(name, [each[finite] for each in values], got[finite])
    assert apart <= TOLERANCE, where


@pytest.mark.slow
@pytest.mark.parametrize("name", ROUND)
def test_a_million_values_are_within_two_units_in_the_last_place(name):
    """Against 80-bit arithmetic of the C library first, whose error is below a unit.

    So a value within a unit of it is within two of the exact value. For all others, and for
    20,000 anyway, mpmath decides.
    """
    values = arguments(name, 1_000_000, np.random.default_rng(2))
    got = values_of(name, *values)
    finite = where_finite(name, values, got)
    with np.errstate(all="ignore"):
        expected = getattr(np, name)(*(each.astype(np.longdouble) for each in values))
        is_open = ~(units(got, expected) <= 1.0)
    is_open[:20_000] = True
    is_open &= finite
    apart, where = worst(name, [each[is_open] for each in values], got[is_open])
    assert apart <= TOLERANCE, where


@pytest.mark.parametrize("name", ["sin", "cos", "tan"])
def test_the_angles_nearest_to_quarter_turns_are_exact_too(name):
    """Where most digits cancel: the two nearest of each exponent."""
    values = nearest_to_quarter_turns()
    assert np.abs(np.cos(values)).min() < 1e-18
    apart, where = worst(name, [values], computed(name, values))
    assert apart <= TOLERANCE, where


@in_turn("name", [*ONE, *TWO])
def test_special_values_are_those_of_numpy(name):
    """Signed zeros, infinities, NaN, subnormal numbers, and arguments out of the domain."""
    values = [SPECIAL]
    if name in TWO:
        values = [each.ravel() for each in np.meshgrid(SPECIAL, SPECIAL)]
    got = values_of(name, *values)
    with np.errstate(all="ignore"):
        expected = getattr(np, name)(*values).astype(np.float64)
    apart = units(got, expected.astype(np.longdouble))
    signs = (got == 0.0) & (expected == 0.0) & (np.signbit(got) != np.signbit(expected))
    if name in ("maximum", "minimum", "fmax", "fmin"):
        signs[:] = False  # NumPy's choice between 0 and -0 depends on the processor
    wrong = (apart > TOLERANCE) | signs
    shown = [(got[i], expected[i], *(each[i] for each in values)) for i in np.flatnonzero(wrong)]
    assert not shown, shown[:10]


@pytest.mark.parametrize(
    ("triple", "processor"),
    [
        ("x86_64-unknown-linux-gnu", "haswell"),
        pytest.param("aarch64-unknown-linux-gnu", "neoverse-n1", marks=pytest.mark.slow),
    ],
)
def test_no_function_calls_a_library(triple, processor):
    halves = []
    for name in FUNCTIONS.keys() & {*ONE, *TWO}:
        leaves = [Operation("slots", (), row) for row in range(1 + (name in TWO))]
        operations = [*leaves, Operation(name, tuple(range(len(leaves))))]
        halves.append(Half(tuple(operations), (len(leaves),), ()))
    assert not called_elsewhere(halves, triple, processor)
