"""Exact filter of an angle that turns at random, on equidistant points of the circle.

The angle turns by a known drift and by normal noise, which is wrapped around the circle. Sums over
equidistant points are integrals of smooth periodic functions, so their error falls faster than any
power of the step.

Source: Mardia, Jupp, "Directional statistics", 2000, section 3.5.7 (wrapped normal distribution).
"""

from collections.abc import Collection
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def circle_filter(
    model: Any, y: Array, measurement_times: Collection[int], points: int = 180
) -> tuple[Array, Array]:
    """Mean direction (D, T+1) and circular variance 1 - R (D, T+1), given y (D, T+1).

    The first angle is uniform. The log-likelihood of an angle is concentration cos(y - angle). The
    parameters of the model are drift, turn_sd and concentration, which may be an array (D, T+1).
    """
    p = model.p
    at = 2 * np.pi * np.arange(points) / points
    apart = (at[:, None] - at[None, :] - p.drift)[..., None] + 2 * np.pi * np.arange(-6, 7)
    moved = np.exp(-0.5 * (apart / p.turn_sd) ** 2).sum(axis=-1)
    weights = np.full((len(y), points), 1.0)
    means, variances = np.empty((2, *y.shape))
    for t in range(y.shape[1]):
        if t in measurement_times:
            at_t = np.broadcast_to(p.concentration, y.shape)[:, t, None]
            weights = weights * np.exp(at_t * (np.cos(y[:, t, None] - at) - 1))
        weights /= weights.sum(axis=1, keepdims=True)
        direction = weights @ np.exp(1j * at)
        means[:, t], variances[:, t] = np.angle(direction), 1 - np.abs(direction)
        weights = weights @ moved.T
    return means, variances
