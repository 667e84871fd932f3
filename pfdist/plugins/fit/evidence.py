"""The log evidence of many replicates at once: for a fit, which computes it again and again.

With particles it is an estimate by common random numbers: the same noise for all values of the
parameters. Particles are resampled systematically in the order of their first component that
differs, so a small change of a parameter moves few ancestors (smoother than in the order of the
particles, but not continuous).

Source: Malik, Pitt, "Particle filters for continuous likelihood evaluation and maximisation",
Journal of Econometrics 165, 2011 (which also interpolates between the sorted particles).
"""

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from pfdist.common.stopping import check
from pfdist.filters import kalman
from pfdist.filters.draws import Draws, noise_of
from pfdist.filters.particle_filter import filter_checked_draws
from pfdist.filters.work import Estimation
from pfdist.kernels.estimators import EVIDENCE
from pfdist.kernels.schemes import SYSTEMATIC
from pfdist.kernels.variates import FILTER_INITIAL, FILTER_PROCESS, TRUTH_MEASUREMENT, variates
from pfdist.models import StateSpaceModel
from pfdist.models.twin import twin_of

Array = NDArray[np.float64]


def log_evidence(
    model: StateSpaceModel, y: Array, particles: int, stream: int, first: int = 0
) -> Array:
    """The estimated log evidence of each replicate, (R,); -inf if no particle explains one.

    Parameters
    ----------
    model : StateSpaceModel
        Its log-likelihood is normalised.
    y : array of float64, (R, T+1, m)
        Measurements of R replicates; NaN marks a component that was not measured.
    particles : int
    stream, first : int
        Key of the noise, and number of the first replicate in it.
    """
    count, instants, _ = y.shape
    twin, draws = twin_of(model, range(instants)), range(first, first + count)
    evidence, order = np.zeros(count), np.arange(count)[:, None]
    with np.errstate(all="ignore"):
        w = noise_of(model.initial_noise, particles, stream, draws, 0, FILTER_INITIAL)
        x = twin.initial(tuple(each.ravel() for each in w), model.p)
        for t in range(instants):
            check()
            for number, way in enumerate(twin.ways):
                seen = y[:, t, way.y]
                measured = np.logical_not(np.isnan(seen).all(axis=1))
                if not measured.any():
                    continue
                given = tuple(np.repeat(values, particles) for values in seen.T)
                log = way.model.log_likelihood(given, x, t, model.p)
                log = np.broadcast_to(log, count * particles).reshape(count, particles)
                log = np.where(measured[:, None], np.where(np.isnan(log), -np.inf, log), 0.0)
                total = logsumexp(log, axis=1)
                evidence += total - np.log(particles)
                key = t * len(twin.ways) + number
                differs = next((each for each in x if np.ptp(each) > 0.0), x[0])
                ancestors = _ancestors(differs, log - total[:, None], stream, key, draws)
                kept = np.arange(particles)
                rows = np.where(measured[:, None], ancestors, kept) + order * particles
                x = tuple(np.broadcast_to(each, rows.size)[rows.ravel()] for each in x)
            if t + 1 < instants:
                w = noise_of(model.process_noise, particles, stream, draws, t, FILTER_PROCESS)
                x = twin.transition(x, t, tuple(each.ravel() for each in w), model.p)
    return np.where(np.isfinite(evidence), evidence, -np.inf)


def moved_log_evidence(
    model: StateSpaceModel, y: Array, particles: int, stream: int, first: int, proposal: str
) -> Array:
    """The same by particles that move, as a proposal of this name does, and so learn constants.

    Adaptive exponents bias the mean evidence by some per cent, and the mean log evidence by more.
    """
    count, instants, _ = y.shape
    evidence = np.full(count, -np.inf)
    measured = [~np.isnan(y[:, :, way.y]).all(axis=2) for way in model.ways]
    points = np.stack(measured, axis=2).reshape(count, -1)
    settings = Estimation(particles, SYSTEMATIC.name, EVIDENCE.name, proposal=proposal)
    x, z = np.empty((1, 0, 0)), np.zeros((1, instants, model.components[2]))
    for row in range(count):  # each has its own times
        check()
        system = Draws(model, range(first + row, first + row + 1), x, y[row : row + 1], z)
        times = tuple(np.flatnonzero(points[row]).tolist())
        found = filter_checked_draws(model, system, times, stream, settings)
        evidence[row] = found.mse[0] * instants
    return np.where(np.isfinite(evidence), evidence, -np.inf)


def _ancestors(
    component: Array, log_share: Array, stream: int, key: int, draws: range
) -> NDArray[np.intp]:
    """Systematic resampling in the order of a component: ancestors, (R, P)."""
    count, particles = log_share.shape
    values = np.broadcast_to(component, log_share.size).reshape(log_share.shape)
    order = np.argsort(values, axis=1, kind="stable")
    share = np.nan_to_num(np.exp(np.take_along_axis(log_share, order, axis=1)))
    reached = np.cumsum(share, axis=1)
    reached /= np.maximum(reached[:, -1:], np.finfo(np.float64).tiny)
    start = variates("uniform", 1, stream, np.array(draws), key, TRUTH_MEASUREMENT, 0)
    wanted = (np.arange(particles) + start) / particles
    row = np.arange(count)[:, None]  # one search for all rows, which lie one after another
    places = np.searchsorted((reached + row).ravel(), (wanted + row).ravel()) % particles
    chosen: NDArray[np.intp] = np.take_along_axis(order, places.reshape(wanted.shape), axis=1)
    return chosen


def exact_log_evidence(model: StateSpaceModel, y: Array) -> Array:
    """The exact log evidence of each replicate, (R,), by the Kalman filter.

    Parameters are as of `log_evidence`. Raises `ModelError` if the model is not linear-Gaussian.
    """
    if len(y) == 1:
        return kalman.log_evidence(model, y)
    evidence = np.empty(len(y))
    patterns, which = np.unique(np.isnan(y), axis=0, return_inverse=True)
    for number in range(len(patterns)):  # replicates with the same gaps have the same covariances
        here = which.ravel() == number
        evidence[here] = kalman.log_evidence(model, y[here])
    return evidence
