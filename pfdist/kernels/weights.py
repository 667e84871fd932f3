"""From log-weights to weights, cumulative weights and weighted moments."""

import numpy as np
from numba import njit

from pfdist.kernels.threefry import inlined

_CHAINS = 4
_LEAST = -700.0  # e to the less is 0 here; in float64 it is so below -745
_IMPOSSIBLE = -np.finfo(np.float64).max


@inlined
def _exp(x):
    """E to the x for x <= 0, 1e-15 of the value; 0 below -700.

    Written out because libm's takes one number at a time, 3 ns, and differs between machines.
    """
    # 2^52 + 2^51 pushes the fraction out: the low bits of the sum are the nearest integer, k.
    shifted = np.float64(x * 1.4426950408889634 + 6755399441055744.0)
    k = shifted - 6755399441055744.0
    r = (x - k * 0.6931471803691238) - k * 1.9082149292705877e-10  # ln 2 in two parts
    p = 2.08767569878681e-09  # Taylor's coefficients 1/12!, 1/11!, ...: |r| < 0.347
    p = p * r + 2.505210838544172e-08
    p = p * r + 2.755731922398589e-07
    p = p * r + 2.7557319223985893e-06
    p = p * r + 2.48015873015873e-05
    p = p * r + 0.0001984126984126984
    p = p * r + 0.001388888888888889
    p = p * r + 0.008333333333333333
    p = p * r + 0.041666666666666664
    p = p * r + 0.16666666666666666
    p = p * r + 0.5
    p = p * r + 1.0
    p = p * r + 1.0
    two_to_k = np.int64((shifted.view(np.int64) + 1023) << 52).view(np.float64)
    return p * two_to_k


@njit(nogil=True, fastmath={"nnan", "ninf", "nsz", "reassoc"})
def _highest(values):
    # With the right to assume finite numbers it is vectorised, 10 times faster.
    highest = values[0]
    for i in range(values.size):
        highest = values[i] if values[i] > highest else highest
    return highest


@njit(nogil=True)
def weigh(log_weight, weight):
    """Weights from log-weights, the largest of them 1.

    A log-weight that is not finite is impossible: its weight is 0. All weights are 0 where none
    is finite. The log-weights are changed.
    """
    for i in range(log_weight.size):
        finite = abs(log_weight[i]) < np.inf
        log_weight[i] = log_weight[i] if finite else _IMPOSSIBLE
    highest = _highest(log_weight)
    for i in range(log_weight.size):
        excess = log_weight[i] - highest
        possible = excess > _LEAST and log_weight[i] > _IMPOSSIBLE
        weight[i] = _exp(excess if possible else 0.0) * (1.0 if possible else 0.0)


@njit(nogil=True)
def cumulate(weight, cumulative):
    """Cumulative weights; their total is given back.

    A sum waits for the one before it, 1.3 ns each: so four stretches are summed side by side.
    """
    stretch = weight.size // _CHAINS
    a = b = c = d = 0.0
    for i in range(stretch):
        a += weight[i]
        b += weight[stretch + i]
        c += weight[2 * stretch + i]
        d += weight[3 * stretch + i]
        cumulative[i] = a
        cumulative[stretch + i] = b
        cumulative[2 * stretch + i] = c
        cumulative[3 * stretch + i] = d
    before = a
    for chain, total in ((1, b), (2, c), (3, d)):
        for i in range(chain * stretch, (chain + 1) * stretch):
            cumulative[i] += before
        before += total
    for i in range(_CHAINS * stretch, weight.size):
        before += weight[i]
        cumulative[i] = before
    return before


# Free to reorder their sums, so that they are vectorised.


@njit(nogil=True, error_model="numpy", fastmath={"reassoc", "nsz"})
def weighted_mean(values, weight, total):
    """Mean of values, their weights summing to total."""
    mean = 0.0
    for i in range(weight.size):
        mean += weight[i] * values[i]
    return mean / total


@njit(nogil=True, error_model="numpy", fastmath={"reassoc", "nsz"})
def weighted_variance(values, weight, total, mean):
    """Variance of values around their mean, their weights summing to total."""
    variance = 0.0
    for i in range(weight.size):
        variance += weight[i] * (values[i] - mean) ** 2
    return variance / total
