"""The step of a filter that adds the log evidence of each measurement, and its plain twin."""

import numpy as np
from numpy.typing import NDArray

from pfdist.kernels.ancestors import weighted_sum
from pfdist.kernels.batch import LOGARITHM, Instant, add_error
from pfdist.kernels.blocks import call_block
from pfdist.kernels.cached import compiled, entry
from pfdist.kernels.memory import read

Array = NDArray[np.float64]


@entry(Instant)
def add_log_evidence(instant):
    """Add the log evidence of a sensor's measurement, and the particles' mean log-likelihood.

    The filter is resampled before each measurement.
    """
    at, s, t, _, _ = read(instant)
    request, batch = at.work.request, at.work.batch
    fill_logarithms(at)
    for d in range(at.draws):
        origin = d * batch.width
        highest = -np.inf
        for i in range(origin, origin + request.particles):
            if highest < batch.log_weight[i] < np.inf:
                highest = batch.log_weight[i]
        evidence = batch.distance[d] - request.log_particles
        information = request.weights.evidence * (evidence + highest)
        if request.weights.explained != 0.0:
            mean = weighted_sum(batch.weight, batch.log_weight, origin, batch.width)
            information += request.weights.explained * mean / batch.total[d]
        if batch.weighs[d] == 0:  # no particle explains the measurement
            information = request.weights.evidence * -np.inf
        add_error(at, s, t, d, information, request.instant_weights[t])


@compiled
def fill_logarithms(at):
    """Fill `distance` with the logarithm of the sum of each draw's weights."""
    request, batch = at.work.request, at.work.batch
    for d in range(at.draws):
        batch.noise[d] = np.float32(batch.total[d])
    call_block(
        at.work.blocks,
        LOGARITHM * request.instants,
        (batch.distance, batch.row),
        (batch.cloud, 0),
        (batch.noise, 0),
        (batch.means, 0, 0),
        (1, batch.row),
    )
    for d in range(at.draws):
        rounded = np.float64(batch.noise[d])  # log(r + e) = log(r) + e / r, for a small e
        batch.distance[d] += (batch.total[d] - rounded) / rounded


def log_likelihoods_of(log_likelihood: Array, weight: Array) -> Array:
    """The log evidence of a measurement, and the mean log-likelihood of weighted particles: (2, D).

    The particles had equal weights before.
    """
    counted = np.where(weight > 0.0, log_likelihood, 0.0)
    highest = np.where(np.isfinite(log_likelihood), log_likelihood, -np.inf).max(axis=1)
    evidence = highest + np.log(np.mean(weight, axis=1))
    mean = np.sum(weight * counted, axis=1) / weight.sum(axis=1)
    return np.where(np.any(weight > 0.0, axis=1), np.stack([evidence, mean]), [[-np.inf], [0.0]])
