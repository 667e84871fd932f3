"""Functions of float32: 4 units in the last place, and NumPy's special values."""

import numpy as np
import pytest

from oracles.computed import called_elsewhere, computed
from pfdist.kernels.functions import FUNCTIONS
from pfdist.kernels.lowering import Half, Precision
from pfdist.models.program import TAKES, Operation

SPECIAL = np.array(
    [
        *(0.0, -0.0, 1.0, -1.0, 0.5, -0.5, 2.0, -3.0, 1e38, -1e38, 1e-45, -1e-45, 2.0**-126),
        *(np.inf, -np.inf, np.nan, 1e-9, 88.7, -103.9, 3.7, 2.0**127, np.pi, 2.0**23 + 1),
    ],
    np.float32,
)
NUMBERS = [name for name in FUNCTIONS if set(TAKES[name]) == {"f"}]
BINARY = [name for name in NUMBERS if len(TAKES[name]) == 2]


def arguments(name, count):
    """Float32 numbers of all signs and exponents, and as many between -100 and 100."""
    rng, both = np.random.default_rng(1), []
    for _ in TAKES[name]:
        bits = rng.integers(0, 2**32, count // 2, np.uint32).view(np.float32)
        usual = rng.uniform(-100.0, 100.0, count - count // 2).astype(np.float32)
        both.append(np.concatenate([SPECIAL, bits, usual]))
    for each in both[1:]:
        rng.shuffle(each)
    return both


def numpys(name, values):
    """NumPy's values in float64, rounded to float32, which are nearly exact."""
    with np.errstate(all="ignore"):
        exact = getattr(np, name)(*(each.astype(np.float64) for each in values))
        return np.asarray(exact, np.float64), np.asarray(exact, np.float32)


@pytest.mark.parametrize("name", NUMBERS)
def test_a_million_values_are_within_four_units_in_the_last_place(name):
    """Also where NumPy's are NaN, infinite or subnormal."""
    values = arguments(name, 1_000_000)
    got, (exact, rounded) = computed(name, *values, dtype=np.float32), numpys(name, values)
    same = (got == rounded) | (np.isnan(got) & np.isnan(rounded))
    with np.errstate(all="ignore"):
        apart = np.abs(got.astype(np.float64) - exact) / np.spacing(np.abs(rounded))
    apart = np.where(same, 0.0, np.where(np.isnan(apart), np.inf, apart))
    assert apart.max() <= 4.0, [each[apart.argmax()] for each in values]


@pytest.mark.parametrize("name", NUMBERS)
def test_special_values_are_those_of_numpy(name):
    """Signed zeros, infinities, NaN, subnormal numbers, and arguments out of the domain."""
    values = [SPECIAL]
    if name in BINARY:
        values = [each.ravel() for each in np.meshgrid(SPECIAL, SPECIAL)]
    got, (_, rounded) = computed(name, *values, dtype=np.float32), numpys(name, values)
    ends = np.isin(rounded, (0.0, np.inf, -np.inf)) | np.isnan(rounded)
    np.testing.assert_array_equal(got[ends], rounded[ends])
    zeros = rounded == 0.0
    np.testing.assert_array_equal(np.signbit(got[zeros]), np.signbit(rounded[zeros]))


@pytest.mark.parametrize("name", ["sin", "cos"])
def test_angles_near_quarter_turns_keep_their_digits(name):
    """All numbers next to a multiple of pi/2 up to 2^20, where most digits cancel."""
    near = (np.arange(1.0, 600_000.0) * (np.pi / 2)).astype(np.float32)
    values = np.concatenate([near, np.nextafter(near, np.float32(np.inf)), -near])
    got, (exact, rounded) = computed(name, values, dtype=np.float32), numpys(name, [values])
    assert np.max(np.abs(got - exact) / np.spacing(np.abs(rounded))) <= 4.0


@pytest.mark.parametrize(("triple", "processor"), [("aarch64-linux-gnu", "generic")])
def test_no_function_calls_a_library(triple, processor):
    halves = []
    for name in NUMBERS:
        leaves = [Operation("slots", (), row) for row in range(len(TAKES[name]))]
        whole = [*leaves, Operation(name, tuple(range(len(leaves))))]
        halves.append(Half(tuple(whole), (len(leaves),), (), Precision("f4", "f4")))
    assert called_elsewhere(halves, triple, processor) == set()
