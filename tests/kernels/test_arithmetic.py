"""The few operations that LLVM is told of, against exact rational arithmetic."""

from fractions import Fraction

import numpy as np
import pytest
from numba import njit

from pfdist.kernels.arithmetic import LANES, fma, larger, row_sum

KINDS = {"float32": np.float32, "float64": np.float64}
BITS = {"float32": 24, "float64": 53}
kinds = pytest.mark.parametrize("kind", KINDS)


@njit
def compiled_fma(a, b, c, out):
    for i in range(out.size):
        out[i] = fma(a[i], b[i], c[i])


@njit
def compiled_larger(a, b, out):
    for i in range(out.size):
        out[i] = larger(a[i], b[i])


def fused(a, b, c):
    out = np.empty_like(a)
    compiled_fma(a, b, c, out)
    return out


def rounded_once(exact, kind):
    """The nearest float to a fraction, of two equally near the one whose last bit is 0."""
    guess = KINDS[kind](float(exact))  # float() rounds correctly, but may be the first of two times
    nearby = (np.nextafter(guess, KINDS[kind](end)) for end in (-np.inf, np.inf))
    integer = f"i{guess.itemsize}"
    return min(
        (guess, *nearby),
        key=lambda x: (abs(Fraction(float(x)) - exact), int(x.view(integer)) & 1),
    )


def assert_rounded_once(function, a, b, c, kind):
    exact = [
        Fraction(x) * Fraction(y) + Fraction(z)
        for x, y, z in zip(*(v.tolist() for v in (a, b, c)), strict=True)
    ]
    expected = [rounded_once(value, kind) for value in exact]
    np.testing.assert_array_equal(function(a, b, c), np.array(expected, kind))


def random_terms(kind, count, seed):
    """a, b and c, where the sum's two terms overlap; in a third of them they nearly cancel."""
    rng = np.random.default_rng(seed)
    a, b = (rng.uniform(1, 2, count) * rng.choice([-1, 1], count) for _ in range(2))
    a, b = a.astype(kind), b.astype(kind)
    c = rng.uniform(1, 2, count) * 2.0 ** rng.integers(-2 * BITS[kind], 2 * BITS[kind], count)
    c = np.where(
        np.arange(count) % 3, c, -np.float64(a) * b * (1 + 2.0**-20 * rng.normal(size=count))
    )
    return a, b, c.astype(kind)


def halfway(kind):
    """a b is halfway between two floats, and c says by how little it is not.

    (1 + 2^-m)(1 + 2^-n), with m + n the number of bits, ends with half a unit in the last place.
    """
    half = BITS[kind] // 2
    a, b = 1 + 2.0**-half, 1 + 2.0 ** (half - BITS[kind])
    c = [2.0**-100, -(2.0**-100), 0.0]
    return np.full(3, a, kind), np.full(3, b, kind), np.array(c, kind)


@kinds
def test_compiled_fma_is_the_exact_value_rounded_once(kind):
    assert_rounded_once(fused, *random_terms(kind, 2000, 1), kind)
    assert_rounded_once(fused, *halfway(kind), kind)


def test_the_cases_tell_one_rounding_from_two():
    for kind in KINDS:
        a, b, c = random_terms(kind, 2000, 1)
        assert np.count_nonzero(a * b + c != fused(a, b, c)) > 200


def test_plain_fma_is_the_exact_value_rounded_once():
    assert_rounded_once(fma, *random_terms("float32", 2000, 2), "float32")


def test_plain_and_compiled_fma_agree_to_the_last_bit():
    a, b, c = random_terms("float32", 2**20, 3)
    assert fma(a, b, c).tobytes() == fused(a, b, c).tobytes()


@kinds
def test_larger_is_the_maximum_compiled_and_plain(kind):
    special = np.array([-np.inf, -2.5, -1e-40, 0.0, 1e-40, 2.5, np.inf], kind)
    a, b = (grid.ravel() for grid in np.meshgrid(special, special))
    out = np.empty_like(a)
    compiled_larger(a, b, out)
    np.testing.assert_array_equal(out, np.maximum(a, b))
    np.testing.assert_array_equal(larger(a, b), np.maximum(a, b))


@kinds
def test_fma_and_larger_keep_the_kind(kind):
    # A float64 slipping in would halve a vector's lanes.
    unit = KINDS[kind](1.0)
    kept = njit(lambda x: (np.array([fma(x, x, x)]), np.array([larger(x, x)])))(unit)
    assert [array.dtype for array in kept] == [np.dtype(kind)] * 2


@njit
def compiled_sum(values, row):
    return row_sum(values, np.uintp(row))


@pytest.mark.parametrize("blocks", range(1, 11))
def test_a_row_is_added_in_64_partial_sums(blocks):
    rng = np.random.default_rng(blocks)
    values = rng.normal(size=(2, blocks * LANES)) * 10.0 ** rng.integers(-8, 8, blocks * LANES)
    for row in (0, 1):
        assert compiled_sum(values, row) == in_64_partial_sums(values[row])


def in_64_partial_sums(values):
    whole = values.size // 64 * 64
    sums = np.zeros(64)
    for begin in range(0, whole, 64):
        sums += values[begin : begin + 64]
    for begin in range(whole, values.size, LANES):
        sums[:LANES] += values[begin : begin + LANES]
    while sums.size > 1:
        half = sums.size // 2
        sums = sums[:half] + sums[half:]
    return sums[0]
