"""Ten thousand million variates have the distribution that they must have.

The streams were not used while the generator was written. Each test fails for one right generator
in a million.
"""

import math
from typing import NamedTuple

import numpy as np
import pytest
from numba import njit
from scipy import stats

from pfdist.kernels.variates import (
    FILTER_PROCESS,
    KINDS,
    SPARE,
    Key,
    VariateRow,
    fill,
    number_of_words,
)
from pfdist.kernels.vectors import LANES

pytestmark = pytest.mark.statistics
STREAM = np.uint64(0x5EED_0F_7E57_1005)
WIDTH, ROWS = 2**16, 152_588  # 1.00000e10 variates
BINS, STEPS = 18_000, 2000  # bins of 1 / 2000 each
LOW = {"normal": -4.5, "exponential": 0.0}
MOST_ERRORS, LEAST_P = 4.9, 1e-6
TAILS = np.arange(4.0, 6.5, 0.5)


class Counts(NamedTuple):
    bins: np.ndarray  # the last two count variates below and above the bins
    powers: np.ndarray  # sums of the first six powers
    products: np.ndarray  # with the neighbour, with the other of a pair, and of their squares
    tails: np.ndarray


@njit(nogil=True)
def count(counts, values, low):
    powers, products = np.zeros(6), np.zeros(3)
    for i in range(WIDTH):
        value = np.float64(values[i])
        place = np.floor((value - low) * STEPS)
        inside = 0 <= place < BINS
        counts.bins[np.int64(place) if inside else BINS + (place > 0)] += 1
        power = 1.0
        for k in range(6):
            power *= value
            powers[k] += power
        if i + 1 < WIDTH:
            products[0] += value * values[i + 1]
        if (i // LANES) % 2 == 0:
            other = np.float64(values[i + LANES])
            products[1] += value * other
            products[2] += (value * value - 1.0) * (other * other - 1.0)
        if abs(value) > 4.0:
            for k in range(TAILS.size):
                counts.tails[k] += abs(value) > TAILS[k]
    counts.powers[:] += powers
    counts.products[:] += products


def counted(kind: str) -> Counts:
    bins, tails = np.zeros(BINS + 2, np.int64), np.zeros(TAILS.size, np.int64)
    counts = Counts(bins, np.zeros(6), np.zeros(3), tails)
    values, words = (
        np.zeros(WIDTH + SPARE, np.float32),
        np.zeros(number_of_words(1, WIDTH), np.uint32),
    )
    key = Key(STREAM, 7, int(FILTER_PROCESS), 0)
    for row in range(ROWS):
        fill(VariateRow(words, values, WIDTH, KINDS.index(kind), key, row, 1))
        count(counts, values, LOW[kind])
    return counts


def rounded_edges(low: float) -> np.ndarray:
    """Edges of the bins for numbers that are rounded to float32: between the last and the first."""
    edges = low + np.arange(BINS + 1) / STEPS
    first = edges.astype(np.float32)
    first = np.where(first < edges, np.nextafter(first, np.float32(np.inf)), first)
    before = np.nextafter(first, np.float32(-np.inf))
    return (first.astype(float) + before.astype(float)) / 2


def moment(kind: str, k: int) -> int:
    if kind == "exponential":
        return math.factorial(k)
    return 0 if k % 2 else math.prod(range(1, k, 2))


@pytest.mark.parametrize("kind", LOW)
def test_ten_thousand_million_variates_have_their_distribution(kind):
    exact = {"normal": stats.norm(), "exponential": stats.expon()}[kind]
    counts, n = counted(kind), ROWS * WIDTH
    assert counts.bins.sum() == n

    edges = rounded_edges(LOW[kind])
    below, above = exact.cdf(edges[0]), exact.sf(edges[-1])
    expected = n * np.array([*np.diff(exact.cdf(edges)), below, above])
    used = expected > 50
    square = np.sum((counts.bins - expected)[used] ** 2 / expected[used])
    assert stats.chi2.sf(square, used.sum() - 1) > LEAST_P

    cumulative = (counts.bins[-2] + np.cumsum(counts.bins[:BINS])) / n
    distance = np.abs(cumulative - exact.cdf(edges[1:])).max()
    assert stats.kstwobign.sf(distance * np.sqrt(n)) > LEAST_P

    moments = np.array([moment(kind, k) for k in range(1, 13)], float)
    errors = np.sqrt((moments[1::2] - moments[:6] ** 2) / n)
    apart = np.abs(counts.powers / n - moments[:6])
    np.testing.assert_array_less(apart / errors, MOST_ERRORS)

    for threshold, found in zip(TAILS, counts.tails, strict=True):
        probability = exact.sf(threshold) * (2 if kind == "normal" else 1)
        assert abs(found - n * probability) < MOST_ERRORS * np.sqrt(n * probability) + 1

    if kind == "normal":  # the two of a pair share a radius and an angle
        pairs = np.array([n * (1 - 1 / WIDTH), n / 2, n / 2])
        variances = np.array([1.0, 1.0, 4.0])
        np.testing.assert_array_less(
            np.abs(counts.products) / np.sqrt(pairs * variances), MOST_ERRORS
        )
