"""NumPy as one writes it first: a loop over draws, float64, ``np.searchsorted``."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def filter_draws(
    y: Array, z: Array, measured: NDArray[np.bool_], particles: int, resampling: str, seed: int
) -> Array:
    """Filter draws one by one; see `benchmarks.peer_filters`."""
    rng = np.random.default_rng(seed)
    mse = np.empty(len(y))
    for d in range(len(y)):
        x = 5 * rng.standard_normal(particles)
        total = 0.0
        for t in range(measured.size):
            if t > 0:
                drift = x / 2 + 25 * x / (1 + x**2) + 8 * np.cos(1.2 * (t - 1))
                x = drift + rng.standard_normal(particles)
            if measured[t]:
                sd = np.sin(0.25 * t) + 2
                log_weight = -0.5 * ((y[d, t] - x**2 / 20) / sd) ** 2
                weight = np.exp(log_weight - log_weight.max())
                weight /= weight.sum()
                total += (weight @ x - z[d, t]) ** 2
                x = x[_ancestors(weight, resampling, rng)]
            else:
                total += (x.mean() - z[d, t]) ** 2
        mse[d] = total / measured.size
    return mse


def _ancestors(weight: Array, resampling: str, rng: np.random.Generator) -> NDArray[np.intp]:
    count = weight.size
    if resampling == "systematic":
        points = (np.arange(count) + rng.random()) / count
    else:
        points = rng.random(count)
    found = np.searchsorted(np.cumsum(weight), points, side="right")
    return np.minimum(found, count - 1)  # rounding may leave the last sum below 1
