"""Resampling: from cumulative weights to the ancestor of each particle.

The ancestor that belongs to a point u of (0, 1) is the first particle whose cumulative weight
exceeds u times their total. A scheme says where the P points lie: ``multinomial`` draws them
independently, ``systematic`` takes a regular grid with one random shift. Each has its plain twin.

References
----------
Douc, Cappe, Moulines, "Comparison of resampling schemes for particle filtering", 2005.
Chen and Asau, "On generating random variates from an empirical distribution", 1974 (the guide).
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pfdist.kernels.noise import FILL, RESAMPLING, TILE, variates

WIDE = 16  # ancestors written at once: one vector store

_fill_points = FILL["point"]


@njit(nogil=True, error_model="numpy")
def grid_ancestors(cumulative, shift, ends, ancestor):
    """Ancestors of the points (i + shift)/P of a regular grid.

    Parameters
    ----------
    cumulative : array of float64, (P,)
        Cumulative weights; they need not sum to 1.
    shift : float
        In 0..1.
    ends : array of int64, (P,)
        Scratch.
    ancestor : array of int64, (P + WIDE,)
        Receives the ancestors; what lies behind the P-th is scratch.
    """
    count = cumulative.size
    scale = count / cumulative[count - 1]
    for j in range(count):  # how many points lie below each cumulative weight
        ends[j] = np.int64(min(math.ceil(cumulative[j] * scale - shift), count))
    # Unsigned, or each index is checked for being negative, and nothing is vectorised.
    begin = np.uintp(0)
    for j in range(np.uintp(count)):
        end = np.uintp(ends[j])
        # One store serves most particles; what it writes too far, the next one writes over.
        for k in range(np.uintp(WIDE)):
            ancestor[begin + np.uintp(k)] = j
        begin += np.uintp(WIDE)
        while begin < end:
            for k in range(np.uintp(WIDE)):
                ancestor[begin + np.uintp(k)] = j
            begin += np.uintp(WIDE)
        begin = end


@njit(nogil=True, error_model="numpy")
def _multinomial(cumulative, stream, draw, t, points, ends, guide, ancestor):
    _fill_points(points, stream, draw, t, RESAMPLING, 0)
    # Where a point's ancestor lies at the earliest: that of the grid point below it.
    grid_ancestors(cumulative, 0.0, ends, guide)
    count = cumulative.size
    total = cumulative[count - 1]
    for i in range(count):
        j = np.uintp(guide[np.uintp(points[i] * count)])
        point = points[i] * total
        j += np.uintp(cumulative[j] <= point)  # a step without a branch, none to be guessed wrong
        while cumulative[j] <= point:
            j += np.uintp(1)
        ancestor[i] = j


@njit(nogil=True)
def _systematic(cumulative, stream, draw, t, points, ends, guide, ancestor):
    _fill_points(points[:TILE], stream, draw, t, RESAMPLING, 0)
    grid_ancestors(cumulative, points[0], ends, ancestor)


RESAMPLE: dict[str, Callable[..., Any]] = {"multinomial": _multinomial, "systematic": _systematic}
"""By scheme, compiled ``resample(cumulative, stream, draw, t, points, ends, guide, ancestor)``.

points (float64, padded(P)), ends (int64, P) and guide (int64, P + WIDE) are scratch; ancestor
(int64, P + WIDE) receives the ancestors.
"""


def plain_ancestors(
    scheme: str, cumulative: NDArray[np.float64], stream: int, draw: int, t: int
) -> NDArray[np.intp]:
    """Plain twin of `RESAMPLE`, (P,)."""
    count = cumulative.size
    points = variates("point", count, stream, draw, t, RESAMPLING, 0)
    if scheme == "systematic":
        points = (np.arange(count) + points[0]) / count
    return np.searchsorted(cumulative, points * cumulative[-1], side="right")
