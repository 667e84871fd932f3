"""Simulation and filter in plain NumPy: for reading, and to hold the compiled ones against.

The same keys and the same formulas, on arrays; no compiled code of ours.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.draws import Draws, check_finite
from pfdist.kernels.noise import (
    FILTER_INITIAL,
    FILTER_PROCESS,
    TRUTH_INITIAL,
    TRUTH_MEASUREMENT,
    TRUTH_PROCESS,
    variates,
)
from pfdist.kernels.resampling import plain_ancestors
from pfdist.measurement_times import Times, validated
from pfdist.models import StateSpaceModel
from pfdist.particle_filter import Filtered

Components = tuple[NDArray[np.float64], ...]


def simulate(model: StateSpaceModel, horizon: int, index: range, stream: int) -> Draws:
    """Plain twin of `pfdist.draws.simulate`."""
    shape = (len(index), horizon + 1)
    x, y, z = (np.empty((*shape, count)) for count in model.components)
    for d, draw in enumerate(index):
        w0 = _noise(model.initial_noise, 1, stream, draw, 0, TRUTH_INITIAL)
        state = model.initial(w0, model.p)
        for t in range(horizon + 1):
            v = _noise(model.measurement_noise, 1, stream, draw, t, TRUTH_MEASUREMENT)
            x[d, t] = _stacked(state, 1)[:, 0]
            y[d, t] = _stacked(model.measurement(state, t, v, model.p), 1)[:, 0]
            z[d, t] = _stacked(model.quantity_of_interest(state, t, model.p), 1)[:, 0]
            w = _noise(model.process_noise, 1, stream, draw, t, TRUTH_PROCESS)
            state = model.transition(state, t, w, model.p)
    check_finite(model, x, y, z)
    return Draws(index, x, y, z)


def filter_draws(
    model: StateSpaceModel,
    draws: Draws,
    measurement_times: Times,
    particles: int,
    stream: int,
    resampling: str = "multinomial",
) -> Filtered:
    """Plain twin of `pfdist.particle_filter.filter_draws`; estimate and variance always come."""
    horizon = draws.z.shape[1] - 1
    times = set(validated(measurement_times, horizon))
    estimate, variance = np.full_like(draws.z, np.nan), np.full_like(draws.z, np.nan)
    mse = np.empty(len(draws.index))
    for d, draw in enumerate(draws.index):
        means, variances = _filter_one(
            model, draws.y[d], times, particles, stream, draw, resampling
        )
        estimate[d, : len(means)], variance[d, : len(means)] = means, variances
        # nan where the draw is degenerate
        mse[d] = np.mean(np.sum((draws.z[d] - estimate[d]) ** 2, axis=1))
    return Filtered(mse, estimate, variance)


def _filter_one(
    model: StateSpaceModel,
    y: NDArray[np.float64],
    times: set[int],
    particles: int,
    stream: int,
    draw: int,
    resampling: str,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Means and variances of z, (T+1, q) each; fewer of a draw that becomes degenerate."""
    means, variances = [], []
    x = model.initial(
        _noise(model.initial_noise, particles, stream, draw, 0, FILTER_INITIAL), model.p
    )
    for t in range(len(y)):
        if t > 0:
            w = _noise(model.process_noise, particles, stream, draw, t - 1, FILTER_PROCESS)
            x = model.transition(x, t - 1, w, model.p)
        weight = np.ones(particles)
        if t in times:
            (log_weight,) = _stacked((model.log_likelihood(tuple(y[t]), x, t, model.p),), particles)
            log_weight = np.where(np.isfinite(log_weight), log_weight, -np.inf)
            if log_weight.max() == -np.inf:
                break
            weight = np.exp(log_weight - log_weight.max())
        z = _stacked(model.quantity_of_interest(x, t, model.p), particles)
        mean = np.sum(weight * z, axis=1) / np.sum(weight)
        means.append(mean)
        variances.append(np.sum(weight * (z - mean[:, None]) ** 2, axis=1) / np.sum(weight))
        if t in times:
            chosen = plain_ancestors(resampling, np.cumsum(weight), stream, draw, t)
            x = tuple(_stacked(x, particles)[:, chosen])
    shape = (len(means), model.components[2])
    return np.reshape(means, shape), np.reshape(variances, shape)


def _stacked(components: tuple[Any, ...], particles: int) -> NDArray[np.float64]:
    """Components as an array (components, particles); a formula may give a constant."""
    return np.stack([np.broadcast_to(component, particles) for component in components])


def _noise(
    kinds: tuple[str, ...], particles: int, stream: int, draw: int, t: int, role: int
) -> Components:
    return tuple(
        variates(kind, particles, stream, draw, t, role, component)
        for component, kind in enumerate(kinds)
    )
