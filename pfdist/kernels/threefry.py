"""The cipher Threefry-4x32 with 13 rounds, of Random123.

Source: Salmon, Moraes, Dror, Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC 2011.
"""

import numpy as np

from pfdist.kernels.melting import inlined


@inlined
def _rotate(x, bits):
    return np.uint32((x << np.uint32(bits)) | (x >> np.uint32(32 - bits)))


@inlined
def _round(bits_01, bits_23, x0, x1, x2, x3):
    # Words 1 and 3 leave swapped: that is Threefry's permutation between two rounds.
    x0 = np.uint32(x0 + x1)
    x2 = np.uint32(x2 + x3)
    return x0, np.uint32(_rotate(x3, bits_23) ^ x2), x2, np.uint32(_rotate(x1, bits_01) ^ x0)


@inlined
def _add_key(k0, k1, k2, k3, times, x0, x1, x2, x3):
    return (
        np.uint32(x0 + k0),
        np.uint32(x1 + k1),
        np.uint32(x2 + k2),
        np.uint32(x3 + k3 + np.uint32(times)),
    )


@inlined
def threefry4x32(k0, k1, k2, k3, c0, c1, c2, c3):
    """Four words of the cipher from four words of a key and four of a counter.

    Each word is uint32 or an array of uint32.
    """
    k4 = np.uint32(np.uint32(0x1BD11BDA) ^ k0 ^ k1 ^ k2 ^ k3)
    x = _add_key(k0, k1, k2, k3, 0, c0, c1, c2, c3)
    x = _round(23, 5, *_round(13, 27, *_round(11, 21, *_round(10, 26, *x))))
    x = _add_key(k1, k2, k3, k4, 1, *x)
    x = _round(18, 20, *_round(25, 10, *_round(17, 11, *_round(6, 20, *x))))
    x = _add_key(k2, k3, k4, k0, 2, *x)
    x = _round(23, 5, *_round(13, 27, *_round(11, 21, *_round(10, 26, *x))))
    x = _add_key(k3, k4, k0, k1, 3, *x)
    x0, x3, x2, x1 = _round(6, 20, *x)
    return x0, x1, x2, x3
