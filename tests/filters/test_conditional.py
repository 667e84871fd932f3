"""The filter of the lower bound, in which one particle follows the true states of the draw.

Given y and the cloud as a set, the truth is distributed as the weights. So the expected squared
error of the cloud's mean is the expected variance of the cloud, and this is at most the error of
the exact filter, for every number of particles (Andrieu, Doucet, Holenstein, "Particle Markov chain
Monte Carlo methods", 2010).
"""

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from oracles.systems import scalar
from pfdist.filters.kalman import expected_mse
from pfdist.filters.particle_filter import filter_checked_sets
from pfdist.filters.simulation import simulate
from pfdist.filters.work import Estimation
from pfdist.models import StateSpaceModel

HORIZON, TIMES = 12, (2, 5, 6, 10)
Array = NDArray[np.float64]


SHARP, SLOW = scalar("sharp", 0.95, 0.5, 0.003), scalar("slow", 1.0, 0.1, 3.0)
"""Particles stay near their ancestors, so that a wrong choice of ancestors shows."""


def settings(particles: int, estimator: str = "filter_variance") -> Estimation:
    return Estimation(particles, "conditional", estimator=estimator)


def standard_errors(difference: Array) -> float:
    """Mean over its standard error."""
    return float(difference.mean() / (difference.std(ddof=1) / math.sqrt(difference.size)))


@pytest.mark.parametrize(
    "model",
    [pytest.param(SLOW, id="slow"), pytest.param(SHARP, id="sharp", marks=pytest.mark.slow)],
)
@pytest.mark.parametrize("particles", [2, 16, 100, 2000])
def test_the_variance_is_the_squared_error_on_average_and_at_most_that_of_the_exact_filter(
    particles: int, model: StateSpaceModel
) -> None:
    count = max(1000, 100_000 // particles)
    draws = simulate(model, HORIZON, range(count), 1)
    variance, squared = (
        filter_checked_sets(model, draws, [TIMES], [HORIZON], 7, settings(particles, estimator))[0]
        for estimator in ("filter_variance", "squared_error")
    )
    assert abs(standard_errors(squared - variance)) < 4
    exact = expected_mse(model, HORIZON, [TIMES])[0]
    assert standard_errors(variance - exact) < 4


# --- versions that are wrong, and fail the identity -----------------------------------------------
