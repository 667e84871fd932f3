"""Plain twins of the resampling schemes, with NumPy's search in the cumulative weights.

Like the compiled schemes, the systematic schemes compare points and weights as 64-bit numbers, and
all others as 32-bit numbers. The schemes themselves are described in `pfdist.kernels.resampling`
and `pfdist.kernels.schemes`.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from pfdist.kernels.noise import RESAMPLING, variates
from pfdist.kernels.resampling import LEAST_TOTAL, SHARES


def plain_ancestors(
    scheme: str,
    weight: NDArray[np.float64],
    stream: int,
    draw: int | range,
    t: int,
) -> NDArray[np.intp]:
    """Ancestors of the particles; the plain twin of `pfdist.kernels.resampling.RESAMPLE`.

    Parameters
    ----------
    scheme : str
        Name of one of `pfdist.kernels.schemes.ALL_SCHEMES`.
    weight : array of float64, (P,) or (D, P)
        Weights of the particles in one draw, or in D draws, in any unit. A scheme that sorts gets
        the weights of sorted particles.
    stream : int
        Key of the filter's noise, 64 bits.
    draw : int or range
        Index of the draw, or indices of the D draws.
    t : int
        Instant at which the particles are resampled.

    Returns
    -------
    array of intp, shaped as the weights
        Index of the ancestor of each particle. It is arbitrary where all weights of a draw are 0.
    """
    ancestors = _PLAIN[scheme]
    if isinstance(draw, int):
        return ancestors(weight, stream, draw, t)
    rows = [ancestors(row, stream, index, t) for row, index in zip(weight, draw, strict=True)]
    return np.array(rows, np.intp).reshape(weight.shape)


def _ancestors(weight: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.intp]:
    """Ancestors of points in (0, 1), which are compared with the weights as 32-bit integers."""
    cumulative = np.cumsum(weight)
    shares = np.floor(cumulative * (SHARES / max(cumulative[-1], LEAST_TOTAL)))
    places = np.searchsorted(shares, np.floor(points * SHARES), side="right")
    return np.minimum(places, weight.size - 1)


def _exact_ancestors(weight: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.intp]:
    """Ancestors of points in (0, 1), which are compared with the weights as 64-bit numbers."""
    cumulative = np.cumsum(weight)
    places = np.searchsorted(cumulative, points * cumulative[-1], side="right")
    return np.minimum(places, weight.size - 1)


def _plain_ascending(count: int, stream: int, draw: int, t: int) -> NDArray[np.float64]:
    """Independent uniform points in ascending order: sums of exponentials over the last sum."""
    sums = np.cumsum(variates("exponential", count + 1, stream, draw, t, RESAMPLING, 0))
    return sums[:-1] / sums[-1]


def _plain_multinomial(weight, stream, draw, t):
    return _ancestors(weight, _plain_ascending(weight.size, stream, draw, t))


def _plain_conditional(weight, stream, draw, t):
    others = _ancestors(weight, _plain_ascending(weight.size - 1, stream, draw, t))
    return np.concatenate([[0], others])  # particle 0 is the true state, and its own ancestor


def _plain_stratified(weight, stream, draw, t):
    places = variates("uniform", weight.size, stream, draw, t, RESAMPLING, 0)
    return _ancestors(weight, (np.arange(weight.size) + places) / weight.size)


def _plain_systematic(weight, stream, draw, t):
    place = variates("uniform", 1, stream, draw, t, RESAMPLING, 0)
    return _exact_ancestors(weight, (np.arange(weight.size) + place) / weight.size)


def _plain_residual(weight, stream, draw, t):
    expected = weight.size * weight / max(np.sum(weight), np.finfo(np.float64).tiny)
    children = np.floor(expected).astype(np.intp)
    sure = np.repeat(np.arange(weight.size), children)
    rest = _plain_ascending(weight.size - sure.size, stream, draw, t)
    return np.concatenate([sure, _ancestors(expected - children, rest)])


_PLAIN: dict[str, Callable[..., NDArray[np.intp]]] = {
    "multinomial": _plain_multinomial,
    "stratified": _plain_stratified,
    "systematic": _plain_systematic,
    "residual": _plain_residual,
    "sorted_systematic": _plain_systematic,  # the filter has sorted the particles
    "conditional": _plain_conditional,
}
