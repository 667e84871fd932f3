"""Resampling: points in (0, 1) by scheme, then one merge that turns them into ancestors.

Every scheme is a way to place P sorted points; the ancestor of point u is the first particle
whose cumulative weight exceeds u. Each has its plain twin beside it.

References
----------
Douc, Cappe, Moulines, "Comparison of resampling schemes for particle filtering", 2005.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pfdist.kernels.noise import FILL, RESAMPLING, TILE, variates

_fill_exponentials = FILL["exponential"]
_fill_uniforms = FILL["uniform"]


@njit(nogil=True)
def _multinomial(points, buffer, stream, draw, t):
    # Sorted uniforms without sorting: the partial sums of P+1 exponentials over their total.
    _fill_exponentials(buffer, stream, draw, t, RESAMPLING, 0)
    total = 0.0
    for i in range(points.size):
        total += np.float64(buffer[i])
        points[i] = total
    scale = 1.0 / (total + np.float64(buffer[points.size]))
    for i in range(points.size):
        points[i] *= scale


@njit(nogil=True)
def _systematic(points, buffer, stream, draw, t):
    _fill_uniforms(buffer[:TILE], stream, draw, t, RESAMPLING, 0)
    shift = np.float64(buffer[0])
    scale = 1.0 / points.size
    for i in range(points.size):
        points[i] = (i + shift) * scale


POINTS: dict[str, Callable[..., Any]] = {"multinomial": _multinomial, "systematic": _systematic}
"""Compiled ``points(out, buffer, stream, draw, t)`` by scheme; buffer is float32, padded(P+1)."""


@njit(nogil=True)
def ancestors(cumulative, points, out):
    """Merge sorted points into cumulative weights.

    Parameters
    ----------
    cumulative : array of float64, (P,)
        Cumulative weights; they need not sum to 1.
    points : array of float64, (P,)
        Sorted, in (0, 1).
    out : array of int64, (P,)
        Receives, for each point, the first index whose cumulative weight exceeds it.
    """
    last = cumulative.size - 1
    total = cumulative[last]
    j = 0
    for i in range(points.size):
        u = points[i] * total
        while j < last and cumulative[j] <= u:
            j += 1
        out[i] = j


def plain_points(
    scheme: str, particles: int, stream: int, draw: int, t: int
) -> NDArray[np.float64]:
    """Plain twin of `POINTS`, (P,)."""
    if scheme == "multinomial":
        partial = np.cumsum(variates("exponential", particles + 1, stream, draw, t, RESAMPLING, 0))
        return partial[:-1] * (1.0 / partial[-1])
    shift = variates("uniform", 1, stream, draw, t, RESAMPLING, 0)[0]
    return (np.arange(particles) + shift) * (1.0 / particles)


def plain_ancestors(
    cumulative: NDArray[np.float64], points: NDArray[np.float64]
) -> NDArray[np.intp]:
    """Plain twin of `ancestors`, (P,)."""
    found = np.searchsorted(cumulative, points * cumulative[-1], side="right")
    return np.minimum(found, cumulative.size - 1)
