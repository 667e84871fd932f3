"""A scalar system with unknown parameters, and its exact filter: a Kalman filter of each value."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pfdist import StateSpaceModel

Array = NDArray[np.float64]
SD, NOISE = 0.5, 0.5

WALK = StateSpaceModel(
    name="walk with a drift",
    initial=lambda w, p: (w[0],),
    transition=lambda x, t, w, p: (x[0] + p.drift + SD * w[0],),
    measurement=lambda x, t, v, p: (p.gain * x[0] + NOISE * v[0],),
    log_likelihood=lambda y, x, t, p: -0.5 * ((y[0] - p.gain * x[0]) / NOISE) ** 2,
    quantity_of_interest=lambda x, t, p: (x[0], p.drift),
    initial_noise=("normal",),
    process_noise=("normal",),
    measurement_noise=("normal",),
    parameters={"drift": 0.0, "gain": 1.0},
)


@dataclass(frozen=True)
class Mixture:
    """The exact filter of `WALK` for values of drift and gain with these probabilities."""

    shares: Array
    drifts: Array
    gains: Array

    def estimates(self, y: Array, times: Sequence[int]) -> Array:
        """Means of z, (D, T+1, 2), from measurements y, (D, T+1)."""
        draws, instants = y.shape
        mean = np.zeros((draws, self.shares.size))
        variance, log = np.ones(self.shares.size), np.log(self.shares) + np.zeros_like(mean)
        estimates = np.empty((draws, instants, 2))
        for t in range(instants):
            if t:
                mean, variance = mean + self.drifts, variance + SD**2
            if t in times:
                total = self.gains**2 * variance + NOISE**2
                left = y[:, t, None] - self.gains * mean
                log = log - 0.5 * left**2 / total - 0.5 * np.log(total)
                mean = mean + self.gains * variance / total * left
                variance = variance * NOISE**2 / total
            weight = np.exp(log - log.max(axis=1, keepdims=True))
            weight /= weight.sum(axis=1, keepdims=True)
            estimates[:, t, 0] = (weight * mean).sum(axis=1)
            estimates[:, t, 1] = (weight * self.drifts).sum(axis=1)
        return estimates
