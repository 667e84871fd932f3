"""Sort particles by their states, so that resampling is smooth under common random numbers.

Systematic resampling depends on the order of the particles. If they are sorted by their states,
clouds that differ a little have children that differ a little. In any other order, a change of one
weight moves the children of all particles behind it.

States are sorted by levels: `LEVELS` equal steps from the least to the largest state that has a
weight. Particles of one level keep their order. So a radix sort of two digits is enough.

Sources: Malik, Pitt, "Particle filters for continuous likelihood evaluation and maximisation",
Journal of Econometrics 165, 2011. Gerber, Chopin, "Sequential quasi Monte Carlo", Journal of the
Royal Statistical Society B 77, 2015.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.kernels.arithmetic import larger
from pfdist.kernels.melting import melted

_BITS = 7
LEVELS = 2 ** (2 * _BITS)
DIGITS = 2**_BITS

_NONE = -np.finfo(np.float64).max
_LOW, _HIGH = np.uintp(0), np.uintp(1)


class SortingScratch(NamedTuple):
    """Arrays that the sort works in; W is width(particles)."""

    weight: NDArray[np.float64]  # (W,)
    counts: NDArray[np.uint32]  # (2, DIGITS)
    keys: NDArray[np.uint32]  # (W or more,)
    half_sorted: NDArray[np.uint32]  # (W or more,)
    # (W or more,): receives the index of the particle that comes to each position
    order: NDArray[np.uint32]


@melted
def sort_by_state(cloud, here, particles, weight, row, scratch):
    """Sort a cloud (2, 1, W) and its row of `weight` (rows, W) by the states; return its new half.

    The cloud is in the half `here`; W is width(particles).
    """
    keys, order = scratch.keys, scratch.order
    high, depth = _NONE, _NONE  # the maxima of x and of -x
    for i in range(cloud.shape[2]):
        x = np.float64(cloud[here, 0, i] if weight[row, i] > 0.0 else np.nan)
        # With abs(x), `and` or -inf LLVM does not vectorise this: 1 to 4 ns instead of 0.1 ns.
        high = larger(high, x if x < np.inf else _NONE)
        depth = larger(depth, -x if x > -np.inf else _NONE)
    low = -depth
    scale = (LEVELS - 1) / (high - low)
    for i in range(cloud.shape[2]):
        level = (np.float64(cloud[here, 0, i]) - low) * scale
        level = level if level > 0.0 else 0.0  # also what is not a number
        level = level if level < LEVELS - 1.0 else LEVELS - 1.0
        keys[i] = np.uint32(np.int64(level))
    _radix_sorted(keys, particles, scratch.counts, scratch.half_sorted, order)
    for i in range(particles, cloud.shape[2]):
        order[i] = 0
    for i in range(cloud.shape[2]):
        cloud[1 - here, 0, i] = cloud[here, 0, order[i]]
        scratch.weight[i] = weight[row, order[i]]
    for i in range(particles):
        weight[row, i] = np.float32(scratch.weight[i])
    return 1 - here


@melted
def _radix_sorted(keys, particles, counts, half_sorted, order):
    """Sort by the low digit, then by the high digit; equal keys keep their order."""
    mask, bits = np.uint32(DIGITS - 1), np.uint32(_BITS)
    for digit in range(DIGITS):
        counts[_LOW, digit] = 0
        counts[_HIGH, digit] = 0
    for i in range(particles):
        counts[_LOW, keys[i] & mask] += np.uint32(1)
        counts[_HIGH, keys[i] >> bits] += np.uint32(1)
    first_low, first_high = np.uint32(0), np.uint32(0)
    for digit in range(DIGITS):
        many_low, many_high = counts[_LOW, digit], counts[_HIGH, digit]
        counts[_LOW, digit], counts[_HIGH, digit] = first_low, first_high
        first_low, first_high = np.uint32(first_low + many_low), np.uint32(first_high + many_high)
    for i in range(particles):
        digit = keys[i] & mask
        half_sorted[counts[_LOW, digit]] = i
        counts[_LOW, digit] += np.uint32(1)
    for place in range(particles):
        i = half_sorted[place]
        digit = keys[i] >> bits
        order[counts[_HIGH, digit]] = i
        counts[_HIGH, digit] += np.uint32(1)


def plain_order(state: NDArray[np.float64], weight: NDArray[np.float64]) -> NDArray[np.intp]:
    """Plain twin of `sort_by_state`: the order of the particles, along the last axis."""
    counted = (weight > 0.0) & np.isfinite(state)
    low = np.where(counted, state, -_NONE).min(axis=-1, keepdims=True)
    high = np.where(counted, state, _NONE).max(axis=-1, keepdims=True)
    with np.errstate(all="ignore"):
        level = (state - low) * ((LEVELS - 1) / (high - low))
        level = np.where(level > 0.0, np.minimum(level, LEVELS - 1.0), 0.0)
    return np.argsort(level.astype(np.int64), axis=-1, kind="stable")
