"""From log-weights to weights and cumulative weights.

Weights are float32, and the largest weight is 1. All sums are float64. Arrays have the length
`width(particles)`. Entries behind the last particle have the log-weight `IMPOSSIBLE`, and so the
weight 0.
"""

import numpy as np
from numpy.typing import NDArray

from pfdist.kernels.arithmetic import LANES, fma, larger
from pfdist.kernels.melting import inlined, melted

IMPOSSIBLE = -np.finfo(np.float64).max

_CHAINS = 4
_LEAST = -87.0  # below, the exponential counts as 0: below -87.3 float32 has no normal number


@inlined
def width(particles):
    """Length of an array with a value for each particle: the next multiple of a vector's length.

    So a loop over whole vectors leaves no remainder.
    """
    return -(-particles // LANES) * LANES


@inlined
def _exp(x):
    """E to the x for x in -87..0, in float32; error 1.2e-7 of the value."""
    # 2^23 + 2^22 pushes the fraction out: the low bits of the sum are the nearest integer, k.
    shifted = fma(x, np.float32(1.4426950), np.float32(12582912.0))
    k = np.float32(shifted - np.float32(12582912.0))
    r = fma(k, np.float32(-0.693359375), x)  # ln 2 in two parts
    r = fma(k, np.float32(2.12194440e-4), r)
    p = np.float32(1.9875691e-4)
    p = fma(p, r, np.float32(1.3981999e-3))
    p = fma(p, r, np.float32(8.3334519e-3))
    p = fma(p, r, np.float32(4.1665796e-2))
    p = fma(p, r, np.float32(1.6666666e-1))
    p = fma(p, r, np.float32(5.0e-1))
    p = fma(p, r, np.float32(1.0))
    p = fma(p, r, np.float32(1.0))
    two_to_k = np.int32((np.float32(shifted).view(np.int32) + np.int32(127)) << np.int32(23))
    return np.float32(p * np.int32(two_to_k).view(np.float32))


@melted
def weigh(log_weight, weight, row):
    """Compute a row of weights from finite log-weights, and return whether one is possible.

    If all log-weights are `IMPOSSIBLE`, the row is left as it is.
    """
    highest = log_weight[0]
    for i in range(log_weight.size):
        highest = larger(highest, log_weight[i])
    if not highest > IMPOSSIBLE:
        return False
    for i in range(log_weight.size):
        excess = log_weight[i] - highest
        possible = excess > _LEAST and log_weight[i] > IMPOSSIBLE
        value = _exp(np.float32(excess if possible else 0.0))
        weight[row, i] = value if possible else np.float32(0.0)
    return True


def plain_weights(log_likelihood: NDArray[np.float64]) -> NDArray[np.float64]:
    """Plain twin of `weigh`, along the last axis; a log-likelihood must be finite to count."""
    finite = np.where(np.isfinite(log_likelihood), log_likelihood, IMPOSSIBLE)
    excess = finite - finite.max(axis=-1, keepdims=True)
    possible = (excess > _LEAST) & (finite > IMPOSSIBLE)
    weight = _exp(np.where(possible, excess, 0.0).astype(np.float32))
    return np.where(possible, weight, 0.0).astype(np.float64)


@melted
def cumulate(values, row, count, cumulative):
    """Compute the cumulative sums of the first values of a row, and return their total.

    The number of values is a multiple of 4. Each sum waits 1.3 ns for the sum before it, so four
    stretches are summed side by side.
    """
    stretch = count // _CHAINS
    a = b = c = d = 0.0
    for i in range(stretch):
        a += values[row, i]
        b += values[row, stretch + i]
        c += values[row, 2 * stretch + i]
        d += values[row, 3 * stretch + i]
        cumulative[i] = a
        cumulative[stretch + i] = b
        cumulative[2 * stretch + i] = c
        cumulative[3 * stretch + i] = d
    before = a
    for chain, total in ((1, b), (2, c), (3, d)):
        for i in range(chain * stretch, (chain + 1) * stretch):
            cumulative[i] += before
        before += total
    return before
