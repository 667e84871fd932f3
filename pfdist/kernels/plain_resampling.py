"""Plain twins of the resampling schemes, with NumPy's search in the cumulative weights."""

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
    """Plain twin of `pfdist.kernels.resampling.RESAMPLE`: the ancestors, shaped as the weights.

    Weights are (P,) with an integer draw, or (D, P) with a range of D draws.
    """
    ancestors = _PLAIN[scheme]
    if isinstance(draw, int):
        return ancestors(weight, stream, draw, t)
    rows = [ancestors(row, stream, index, t) for row, index in zip(weight, draw, strict=True)]
    return np.array(rows, np.intp).reshape(weight.shape)


def _ancestors(weight: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.intp]:
    """Ancestors of points in (0, 1); arbitrary if all weights are 0."""
    cumulative = np.cumsum(weight)
    shares = np.floor(cumulative * (SHARES / max(cumulative[-1], LEAST_TOTAL)))
    places = np.searchsorted(shares, np.floor(points * SHARES), side="right")
    return np.minimum(places, weight.size - 1)


def _exact_ancestors(weight: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.intp]:
    cumulative = np.cumsum(weight)
    places = np.searchsorted(cumulative, points * cumulative[-1], side="right")
    return np.minimum(places, weight.size - 1)


def _plain_ascending(count: int, stream: int, draw: int, t: int) -> NDArray[np.float64]:
    sums = np.cumsum(variates("exponential", count + 1, stream, draw, t, RESAMPLING, 0))
    return sums[:-1] / sums[-1]


def _plain_multinomial(weight, stream, draw, t):
    return _ancestors(weight, _plain_ascending(weight.size, stream, draw, t))


def _plain_conditional(weight, stream, draw, t):
    others = _ancestors(weight, _plain_ascending(weight.size - 1, stream, draw, t))
    return np.concatenate([[0], others])


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
    "sorted_systematic": _plain_systematic,
    "conditional": _plain_conditional,
}
