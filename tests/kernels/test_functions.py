"""Elementary functions of vectors: 2 units in the last place, and NumPy's special values."""

import numpy as np
import pytest

from oracles.computed import called_elsewhere, computed
from pfdist.kernels.lowering import Half
from pfdist.models.program import Operation

SPECIAL = np.array(
    [
        *(0.0, -0.0, 1.0, -1.0, 0.5, -0.5, 2.0, -3.0, 1e300, -1e300, 5e-324, -5e-324),
        *(2.0**-1022, np.inf, -np.inf, np.nan, 1e-17, 710.0, -745.2, 3.7),
    ]
)
TOLERANCE = 2.0  # units in the last place
ONE = (
    *("sqrt", "exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "sin", "cos", "tan"),
    *("arcsin", "arccos", "arctan", "sinh", "cosh", "tanh", "arcsinh", "arccosh", "arctanh"),
    *("cbrt", "floor", "ceil", "trunc", "rint", "sign", "negative", "absolute"),
    *("isnan", "isinf", "isfinite", "signbit"),
)
TWO = (
    *("add", "subtract", "multiply", "divide", "power", "arctan2", "hypot", "copysign"),
    *("fmod", "remainder", "floor_divide", "maximum", "minimum", "fmax", "fmin"),
    *("less", "less_equal", "greater", "greater_equal", "equal", "not_equal"),
)
RANGES = {  # of the decimal exponent; beyond, results are 0, infinite or NaN
    "exp": (-20, 2.85),
    "exp2": (-20, 3.01),
    "expm1": (-20, 2.85),
    "sinh": (-20, 2.85),
    "cosh": (-20, 2.85),
    "tanh": (-300, 3),
    "sin": (-307, 308),
    "cos": (-307, 308),
    "tan": (-307, 308),
    "arcsin": (-300, 0),
    "arccos": (-300, 0),
    "arctanh": (-300, 0),
    "power": (-2, 2),
    "fmod": (-10, 10),
    "remainder": (-10, 10),
    "floor_divide": (-10, 10),
}


def arguments(name, count, rng):
    """Numbers of both signs whose exponents are spread over the function's whole range."""
    low, high = RANGES.get(name, (-307, 307))
    return rng.choice([-1.0, 1.0], count) * 10.0 ** rng.uniform(low, high, count)


def exact(name, *values):
    """The value with 64 bits of mantissa, or more."""
    with np.errstate(all="ignore"):
        return getattr(np, name)(*(np.asarray(each, np.longdouble) for each in values))


def units(got, expected):
    """The distance in units in the last place of the expected value; 0 where both are the same."""
    with np.errstate(over="ignore"):
        rounded = expected.astype(np.float64)
    same = (got == rounded) | (np.isnan(got) & np.isnan(rounded))
    with np.errstate(all="ignore"):
        apart = np.abs(got - expected) / np.spacing(np.abs(rounded))
    return np.where(same, 0.0, np.where(np.isnan(apart), np.inf, apart)).astype(np.float64)


@pytest.mark.parametrize("name", [*ONE, *TWO])
def test_values_are_within_two_units_in_the_last_place(name):
    """At 20,000 arguments of the whole range, against 80-bit arithmetic of the C library."""
    rng = np.random.default_rng(1)
    values = [arguments(name, 20_000, rng) for _ in range(1 + (name in TWO))]
    if name == "power":
        values[0] = np.abs(values[0])
    apart = units(computed(name, *values), exact(name, *values))
    worst = int(np.argmax(apart))
    assert apart[worst] <= TOLERANCE, (apart[worst], [each[worst] for each in values])


@pytest.mark.parametrize("name", [*ONE, *TWO])
def test_special_values_are_those_of_numpy(name):
    """Signed zeros, infinities, NaN, subnormal numbers, and arguments out of the domain."""
    values = [SPECIAL]
    if name in TWO:
        values = [each.ravel() for each in np.meshgrid(SPECIAL, SPECIAL)]
    got = computed(name, *values)
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
    [("aarch64-unknown-linux-gnu", "neoverse-n1"), ("x86_64-unknown-linux-gnu", "haswell")],
)
def test_no_function_calls_a_library(triple, processor):
    halves = []
    for name in (*ONE, *TWO):
        leaves = [Operation("slots", (), row) for row in range(1 + (name in TWO))]
        operations = [*leaves, Operation(name, tuple(range(len(leaves))))]
        halves.append(Half(tuple(operations), (len(leaves),), ()))
    assert not called_elsewhere(halves, triple, processor)
