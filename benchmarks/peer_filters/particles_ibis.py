"""Chopin's `particles`: its SMC sampler of a static model, IBIS."""

from typing import Any
from unittest.mock import patch

import numpy as np
import particles as particles_package
from numpy.typing import NDArray
from particles import distributions, smc_samplers

Array = NDArray[np.float64]
_MOVES = 8  # of each particle, which all count


class _Constants(smc_samplers.StaticModel):  # type: ignore[misc]
    """Constants with standard normal priors, of which each reading sees another sum."""

    def __init__(self, y: Array, factors: Array, sensor: float) -> None:
        names = [f"x{c}" for c in range(factors.shape[1])]
        prior = distributions.StructDist({name: distributions.Normal() for name in names})
        super().__init__(data=y, prior=prior)
        self.names, self._factors, self._sensor = names, factors, sensor

    def logpyt(self, theta: Any, t: int) -> Any:
        """The log-density of a reading."""
        pairs = zip(self._factors[t], self.names, strict=True)
        predicted = sum(factor * theta[name] for factor, name in pairs)
        return distributions.Normal(loc=predicted, scale=self._sensor).logpdf(self.data[t])


def posterior_mean(y: Array, factors: Array, sensor: float, particles: int) -> Array:
    """The mean of constants, (c,), given readings, (T,), of sums of them with factors, (T, c)."""
    model = _Constants(y, factors, sensor)
    moves = smc_samplers.IBIS(model=model, len_chain=_MOVES)
    sampler = particles_package.SMC(fk=moves, N=particles // _MOVES)
    with patch.object(np, "float", float, create=True):  # which NumPy no longer has
        sampler.run()
    theta, weight = sampler.X.theta, sampler.W
    return np.array([np.sum(weight * theta[name]) for name in model.names])
