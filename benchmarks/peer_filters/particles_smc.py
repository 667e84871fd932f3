"""Chopin's `particles`: its `SMC` class on a Feynman-Kac model of our own, stepped by hand.

A potential of 1 where nothing is measured, and `time_to_resample`, which a model may override, say
when: at the step that follows a measurement. A `FeynmanKac` in plain formulas is faster than the
package's distributions, and a mean at each step than its collectors.
"""

from typing import Any

import numpy as np
import particles as particles_package
from numpy.typing import NDArray

Array = NDArray[np.float64]


class _Growth(particles_package.FeynmanKac):  # type: ignore[misc]
    """The paper's model and the measurements of one draw."""

    def __init__(self, y: Array, measured: NDArray[np.bool_], rng: np.random.Generator) -> None:
        super().__init__(y.size)
        self._y, self._measured, self._rng = y, measured, rng

    def M0(self, N: int) -> Array:  # noqa: N802, N803  its names
        x: Array = 5 * self._rng.standard_normal(N)
        return x

    def M(self, t: int, xp: Array) -> Array:  # noqa: N802
        drift = xp / 2 + 25 * xp / (1 + xp**2) + 8 * np.cos(1.2 * (t - 1))
        x: Array = drift + self._rng.standard_normal(xp.size)
        return x

    def logG(self, t: int, xp: Array, x: Array) -> Array:  # noqa: N802
        if not self._measured[t]:
            return np.zeros(x.size)
        sd = np.sin(0.25 * t) + 2
        log_weight: Array = -0.5 * ((self._y[t] - x**2 / 20) / sd) ** 2
        return log_weight

    def time_to_resample(self, smc: Any) -> bool:
        return bool(self._measured[smc.t - 1])


def filter_draws(
    y: Array, z: Array, measured: NDArray[np.bool_], particles: int, resampling: str, seed: int
) -> Array:
    """Filter draws one by one; see `benchmarks.peer_filters`."""
    rng = np.random.default_rng(seed)
    np.random.seed(seed % 2**32)  # noqa: NPY002  the package resamples from the global state
    mse = np.empty(len(y))
    for d in range(len(y)):
        smc = particles_package.SMC(
            fk=_Growth(y[d], measured, rng), N=particles, resampling=resampling, collect="off"
        )
        errors = [(smc.W @ smc.X - z[d, smc.t - 1]) ** 2 for _ in smc]
        mse[d] = np.mean(errors)
    return mse
