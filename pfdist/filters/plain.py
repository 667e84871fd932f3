"""Simulation and filter in plain NumPy: easy to read, and the reference of the compiled functions.

They compute on arrays (draws, particles), with the noise, the weights and the resampling of the
compiled filter, which other tests check. They are the engine ``numpy``: formulas run their
programs, and functions of batched models are called directly.
"""

import math
from functools import partial
from itertools import pairwise
from typing import Any, SupportsIndex

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Lag, Times, first_smoothed, last_used
from pfdist.filters.carried import continuing
from pfdist.filters.cloud import Cloud
from pfdist.filters.draws import Draws, begun, check_finite, noise_of
from pfdist.filters.interface import checking, one_by_one, weighed
from pfdist.filters.proposals import PROPOSALS
from pfdist.filters.work import Estimation
from pfdist.kernels.ancestors import ancestors_of, weights_of
from pfdist.kernels.batch import FilterArrays
from pfdist.kernels.estimators import ESTIMATORS
from pfdist.kernels.log_evidence import log_likelihoods_of
from pfdist.kernels.schemes import ALL_SCHEMES
from pfdist.kernels.variates import (
    FILTER_INITIAL,
    FILTER_PROCESS,
    TRUTH_INITIAL,
    TRUTH_MEASUREMENT,
    TRUTH_PROCESS,
)
from pfdist.models import StateSpaceModel
from pfdist.models.base import angular_error
from pfdist.models.twin import twin_of

Array = NDArray[np.float64]

_AT_ONCE = 2**16  # particles of all draws that are filtered together; they fit into a cache


def simulate(
    model: StateSpaceModel, horizon: int, index: range, stream: int, prior: Cloud | None = None
) -> Draws:
    """Plain twin of `pfdist.filters.simulation.simulate`."""
    draws = begun(model, horizon, index, stream, prior)
    user, model = model, twin_of(model, draws.instants)

    def noise(kinds: tuple[str, ...], t: int, role: SupportsIndex) -> tuple[Array, ...]:
        return tuple(w[:, 0] for w in noise_of(kinds, 1, stream, index, t, role))

    with np.errstate(all="ignore"):
        if prior is None:
            state = model.initial(noise(model.initial_noise, 0, TRUTH_INITIAL), model.p)
        else:
            state = tuple(draws.x[:, 0].T)
        for k, t in enumerate(draws.instants):
            v = noise(model.noise_of_measurements, t, TRUTH_MEASUREMENT)
            _put(draws.x, k, state)
            y = [way.model.measurement(state, t, v[way.v], model.p) for way in model.ways]
            _put(draws.y, k, sum(y, ()))
            _put(draws.z, k, model.quantity_of_interest(state, t, model.p))
            if t == horizon:
                break
            w = noise(model.process_noise, t, TRUTH_PROCESS)
            state = model.transition(state, t, w, model.p)
    check_finite(user, draws, stream)
    return draws


@continuing
def filter_checked_draws(
    model: StateSpaceModel,
    draws: Draws,
    measurement_times: Times,
    stream: int,
    settings: Estimation,
    trajectories: bool = False,
    lines: bool = False,
) -> FilterArrays:
    """Plain twin of `pfdist.filters.particle_filter.filter_checked_draws`.

    With a lag, `lines` says whether z along the lines of all particles is wanted, too.
    """
    count = max(1, _AT_ONCE // settings.particles)
    filter_block = PROPOSALS[settings.proposal].twin or _filter
    model = twin_of(model, draws.instants)
    arguments = measurement_times, stream, settings, lines
    with np.errstate(all="ignore"):
        blocks = [
            filter_block(model, draws[first : first + count], *arguments)
            for first in range(0, len(draws.index), count)
        ]
    return FilterArrays(
        *(
            np.concatenate(parts, axis=1 if name in ("ranks", "log_likelihoods") else 0)
            for name, parts in zip(FilterArrays._fields, zip(*blocks, strict=True), strict=True)
        )
    )


def _filter(
    model: StateSpaceModel,
    draws: Draws,
    times: Times,
    stream: int,
    settings: Estimation,
    keeps_lines: bool,
) -> FilterArrays:
    particles, scheme = settings.particles, ALL_SCHEMES[settings.resampling]
    count, instants, _ = draws.z.shape
    cloud = (count, particles)
    mean, variance = np.full_like(draws.z, np.nan), np.full_like(draws.z, np.nan)
    ranks = np.full((2, *draws.z.shape), np.nan)
    sizes, lines = np.full((2, count, instants), np.nan)
    log_likelihoods = np.zeros((2, count, instants))
    fails = np.zeros((count, instants), np.bool_)
    first_kept = first_smoothed(settings.lag, draws.instants)
    estimates = estimated(model, draws.instants, times, settings.lag)
    x, carried = first(model, draws, stream, settings)
    kept = particles if keeps_lines else 0
    line_weight, line_z = np.ones((count, instants, kept)), np.empty((*draws.z.shape, kept))
    # z at the last instants, along the particles' lines, and which particles these go through
    past = list[tuple[NDArray[Any], ...]]()
    for k, t in enumerate(draws.instants):
        if k > 0:
            x = states(step(model, flat(x), t - 1, particles, stream, draws.index), cloud)
        if scheme.holds_truth:
            for component, true in zip(x, draws.x[:, k].T, strict=True):
                component[:, 0] = true
        x, weight, fails[:, k], weighs = _weighed(
            model, draws, k, x, past, carried, times, stream, settings, log_likelihoods[:, :, k]
        )
        share = weight / weight.sum(axis=1, keepdims=True)
        measured = t in model.points.instants(times)
        quantities = model.quantity_of_interest(flat(x), t, model.p)
        each = np.tile(np.arange(particles), (count, 1))
        past.append((*(of_cloud(values, cloud) for values in quantities), each))
        del past[: first_kept[k] - k - 1]
        if scheme.holds_truth and measured:
            ranks[:, :, k] = np.stack([_shares_below(z, share) for z in past[-1][:-1]], axis=-1)
        # The lines of a measurement give a better estimate of the instants before it.
        for at in estimates[k]:
            *components, through = past[at - k - 1]
            if settings.lag:
                of_lines, z_of_lines = _by_particle(through, weight, components)
                lines[:, at] = np.sum(of_lines > 0, axis=1) if measured else np.nan
                line_weight[:, at], line_z[:, at] = of_lines[:, :kept], z_of_lines[..., :kept]
            for c, z in enumerate(components):
                counted, is_angle = np.where(weight > 0, z, 0.0), draws.model.is_angle[c]
                mean[:, at, c], variance[:, at, c] = moments(counted, share, is_angle)
            if ESTIMATORS[settings.estimator].by_error:
                variance[:, at] = mean_error(draws, at, flat(tuple(components)), mean[:, at], share)
        sizes[weighs, k] = _effective_sizes(weight)[weighs]
        key = model.points.at(t)[-1]
        x, carried = _resampled(x, past, weight, settings, stream, draws.index, key, weighs)
    return finished(draws, settings, fails, FilterArrays(
        np.empty(0), np.empty(0, np.bool_), mean, variance, sizes, np.empty((0, 0)), ranks,
        np.stack(x, axis=1), carried, lines, line_z, line_weight, log_likelihoods,
        np.empty((count, 0), np.uint8),
    ))  # fmt: skip


def finished(
    draws: Draws, settings: Estimation, fails: NDArray[np.bool_], found: FilterArrays
) -> FilterArrays:
    """The results with MSE and degenerate draws, and without what follows an infinite error.

    `fails` are the instants of each draw at which no particle explains a measurement, (D, T+1).
    """
    mse, ends = _mse(draws, found.estimate)
    after = np.arange(fails.shape[1]) > ends[:, None]
    for array in (found.estimate, found.variance, found.sizes):
        array[after] = np.nan
    found.cloud[ends < fails.shape[1]] = np.nan
    degenerate = np.any(fails & ~after, axis=1)
    mse[degenerate & ALL_SCHEMES[settings.resampling].holds_truth] = np.nan
    return found._replace(mse=mse, degenerate=degenerate)


def _mse(draws: Draws, mean: Array) -> tuple[Array, NDArray[np.int64]]:
    """The MSE of each draw, and the instant at which it becomes infinite, or T + 1."""
    count, instants, _ = mean.shape
    total, ends = np.zeros(count), np.full(count, instants)
    true_error = twin_of(draws.model, draws.instants).error
    for k, t in enumerate(draws.instants):
        error = true_error(tuple(draws.z[:, k].T), tuple(mean[:, k].T), t, draws.model.p)
        total += weighed(_like(error, (count,)), draws.instant_weights[k])
        infinite = ~(total < np.inf)
        total[infinite], ends[infinite] = np.inf, np.minimum(ends[infinite], k)
    return total / instants, ends


def estimated(model: StateSpaceModel, instants: range, times: Times, lag: Lag) -> list[range]:
    """The instants that each instant estimates, unless a later measurement estimates them again.

    All count from the first. An instant without a measurement estimates itself.
    """
    final, own = last_used(lag, instants), {*model.points.instants(times)}
    measured = [k for k, t in enumerate(instants) if t in own]
    found = [range(k, k + 1) for k in range(len(instants))]
    for k, following in pairwise([*measured, len(instants)]):
        first, ready = np.searchsorted(final, [k, following]).tolist()
        found[k] = range(first, min(k + 1, ready))
    return found


def _by_particle(
    through: NDArray[np.intp], weight: Array, components: list[Array]
) -> tuple[Array, Array]:
    """Weights of the lines through each particle of an instant, and its z; NaN without a line."""
    particles, z = weight.shape[1], np.stack(components, axis=1)
    of_particles = np.full(z.shape, np.nan)
    np.put_along_axis(of_particles, through[:, None], z, axis=2)
    pairs = zip(through, weight, strict=True)
    return np.stack([np.bincount(*pair, particles) for pair in pairs]), of_particles


def _shares_below(z: Array, share: Array) -> Array:
    """The share of particles below the truth, which is particle 0, and of those like it, (2, D)."""
    below: Array = np.sum(share * np.stack([z < z[:, :1], z == z[:, :1]]), axis=2)
    return below


def first(
    model: StateSpaceModel, draws: Draws, stream: int, settings: Estimation
) -> tuple[tuple[Array, ...], Array]:
    """States and weights, each (D, particles), with which the filters begin."""
    prior, particles = settings.prior, settings.particles
    cloud = (len(draws.index), particles)
    if not isinstance(prior, Cloud):
        noise = noise_of(model.initial_noise, particles, stream, draws.index, 0, FILTER_INITIAL)
        return states(model.initial(flat(noise), model.p), cloud), np.ones(cloud)
    weight = prior.weight_of_filters(particles) if settings.carries else None
    if weight is not None:
        return states(tuple(np.tile(prior.x, cloud[0])), cloud), np.tile(weight, (cloud[0], 1))
    chosen = prior.chosen_for_filters(particles, draws.index, stream)
    return states(flat(tuple(prior.x[:, chosen])), cloud), np.ones(cloud)


def step(
    model: StateSpaceModel,
    x: tuple[Array, ...],
    t: int,
    particles: int,
    stream: int,
    draws: range,
) -> tuple[Any, ...]:
    """x(t+1) from x(t); the particles of all draws lie along one axis."""
    w = noise_of(model.process_noise, particles, stream, draws, t, FILTER_PROCESS)
    result: tuple[Any, ...] = model.transition(x, t, flat(w), model.p)
    return result


def _weighed(
    model: StateSpaceModel,
    draws: Draws,
    k: int,
    x: tuple[Array, ...],
    past: list[tuple[NDArray[Any], ...]],
    weight: Array,
    times: Times,
    stream: int,
    settings: Estimation,
    log_likelihoods: Array,
) -> tuple[tuple[Array, ...], Array, NDArray[np.bool_], NDArray[np.bool_]]:
    """Particles and weights after the measurements at an instant, and which draws degenerate.

    A measurement that no particle of a draw explains is left out there. The last array says which
    draws the last measurement has weighed. The sensors weigh in their order. The particles are
    resampled in between, but not propagated. `weight` has the carried weights, and `past` the
    earlier z along the particles' lines. The log evidence of each sensor's measurement, and the
    particles' mean log-likelihood, are added to `log_likelihoods`, (2, D).
    """
    count, particles = cloud = x[0].shape
    degenerate, weighs = np.zeros(count, np.bool_), np.zeros(count, np.bool_)
    for point, way in zip(model.points.at(draws.instants[k]), model.ways, strict=True):
        if point not in times:
            continue
        x, weight = _resampled(x, past, weight, settings, stream, draws.index, point - 1, weighs)
        y = tuple(np.repeat(values, particles) for values in draws.y[:, k, way.y].T)
        log_likelihood = way.model.log_likelihood(y, flat(x), draws.instants[k], model.p)
        log_likelihood = of_cloud(log_likelihood, cloud)
        new = weights_of(log_likelihood + np.log(weight))
        weighs = np.any(new > 0.0, axis=1)
        if ESTIMATORS[settings.estimator].weights.evidence:
            log_likelihoods += log_likelihoods_of(log_likelihood, new)
        weight = np.where(weighs[:, None], new, weight)
        degenerate |= ~weighs
    return x, weight, degenerate, weighs


def _resampled(
    x: tuple[Array, ...],
    past: list[tuple[NDArray[Any], ...]],
    weight: Array,
    settings: Estimation,
    stream: int,
    index: range,
    key: int,
    weighs: NDArray[np.bool_],
) -> tuple[tuple[Array, ...], Array]:
    """Particles and weights after resampling; draws with even weights are left as they are.

    So are draws that no measurement weighs. The largest weight is 1.
    """
    particles = settings.particles
    if not weighs.any():
        return x, weight
    ancestors = ancestors_of(settings.resampling, weight, stream, index, key)
    uneven = _effective_sizes(weight) < settings.threshold * particles
    uneven = (weighs & uneven & (weight.sum(axis=1) < particles))[:, None]
    ancestors = np.where(uneven, ancestors, np.arange(particles))
    return _taken(x, past, ancestors), np.where(uneven, 1.0, weight)


def _taken(
    x: tuple[Array, ...], past: list[tuple[NDArray[Any], ...]], ancestors: NDArray[np.intp]
) -> tuple[Array, ...]:
    """The states of ancestors; their past is taken in place."""

    def of_ancestors(components: tuple[Array, ...]) -> tuple[Array, ...]:
        return tuple(np.take_along_axis(each, ancestors, axis=1) for each in components)

    past[:] = map(of_ancestors, past)
    return of_ancestors(x)


def _effective_sizes(weight: Array) -> Array:
    """Effective sample size of each draw (Kong, Liu, Wong 1994)."""
    sizes: Array = weight.sum(axis=1) ** 2 / np.sum(weight**2, axis=1)
    return sizes


def moments(values: Array, share: Array, is_angle: bool) -> tuple[Array, Array]:
    """Mean and variance of weighted particles, (D,); for an angle its direction, and 1 - R."""
    if is_angle:
        sine, cosine = (np.sum(share * each(values), axis=1) for each in (np.sin, np.cos))
        mean: Array = np.arctan2(sine, cosine)
        return mean, np.sum(share * angular_error(values, mean[:, None]), axis=1)
    mean = np.sum(share * values, axis=1)
    return mean, np.sum(share * (values - mean[:, None]) ** 2, axis=1)


def mean_error(draws: Draws, k: int, z: tuple[Any, ...], mean: Array, share: Array) -> Array:
    """The truth's mean error of weighted particles against their mean; then zeros: (D, q)."""
    model, estimate = draws.model, tuple(np.repeat(each, share.shape[1]) for each in mean.T)
    error = twin_of(model, draws.instants).error(z, estimate, draws.instants[k], model.p)
    means = np.zeros_like(mean)
    means[:, 0] = np.sum(share * np.where(share > 0, of_cloud(error, share.shape), 0.0), axis=1)
    return means


def _like(value: Any, shape: tuple[int, ...]) -> Array:
    """A formula's value, which may be a constant, as an array of this shape."""
    return np.broadcast_to(np.asarray(value, np.float64), shape)


def flat(components: tuple[Array, ...]) -> tuple[Array, ...]:
    """Components with the particles of all draws along one axis, as formulas take them."""
    return tuple(component.reshape(-1) for component in components)


def of_cloud(value: Any, cloud: tuple[int, ...]) -> Array:
    """A formula's value for particles along one axis, as an array (D, particles)."""
    return _like(value, (math.prod(cloud),)).reshape(cloud)


def states(x: tuple[Any, ...], cloud: tuple[int, ...]) -> tuple[Array, ...]:
    """States, each (D, particles): copies, because some schemes set one particle to the truth."""
    return tuple(of_cloud(component, cloud).copy() for component in x)


def _put(array: Array, t: int, components: tuple[Any, ...]) -> None:
    for k, component in enumerate(components):
        array[:, t, k] = component


filter_draws = checking(filter_checked_draws)
filter_checked_sets = partial(one_by_one, filter_checked_draws)
