"""The intermittent particle filter (paper, section 2.1) by the traced formulas of a model.

Sampling importance resampling: particles are propagated by the model, and weighted and resampled
only at the measurement times. `pfdist.kernels.filter` computes it. `pfdist.filters.plain` holds the
same filter in plain NumPy, for reading.

Source: Arulampalam, Maskell, Gordon, Clapp, "A tutorial on particle filters", 2002, algorithm 4
(which resamples systematically; a job chooses the scheme).
"""

import math
from collections.abc import Sequence
from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times, first_smoothed
from pfdist.errors import PriorError
from pfdist.filters.applied_rules import applied
from pfdist.filters.carried import continuing
from pfdist.filters.cloud import Gaussian
from pfdist.filters.draws import Draws
from pfdist.filters.formulas import filter_blocks
from pfdist.filters.interface import SUMS, all_or_none, checking, weighed
from pfdist.filters.proposals import PROPOSALS
from pfdist.filters.work import Estimation, filter_streams
from pfdist.kernels import callbacks
from pfdist.kernels.batch import FilterArrays, FilterRequest
from pfdist.kernels.deciding import with_points
from pfdist.kernels.estimators import ESTIMATORS
from pfdist.kernels.filter import filter_all
from pfdist.kernels.prefixes import Plan, Planned, plan_prefixes
from pfdist.kernels.schemes import ALL_SCHEMES
from pfdist.kernels.variates import codes_of
from pfdist.models import StateSpaceModel

KERNEL_VERSION = 9
"""Version of the numbers that a key gives; part of a run's identity."""


@continuing
def filter_checked_draws(
    model: StateSpaceModel,
    draws: Draws,
    measurement_times: Times,
    stream: int,
    settings: Estimation,
    trajectories: bool = False,
) -> FilterArrays:
    """Filter draws as `filter_draws` does, with arguments that the caller has checked.

    The times are sorted instants of the draws. `check_filter_settings` has accepted the
    settings for this model and the draws' model.
    """
    planned = _planned(draws, (measurement_times,)).plan
    others, count, particles = {}, len(draws.index), settings.particles
    if trajectories:
        shapes = {
            "estimate": draws.z.shape,
            "variance": draws.z.shape,
            "sizes": draws.z.shape[:2],
            "lines": draws.z.shape[:2],
            "ranks": (2, *draws.z.shape),
            "cloud": (count, model.components[0], particles),
        }
        others = {name: np.full(shape, np.nan) for name, shape in shapes.items()}
        others["weight"] = np.ones((count, particles))
        if settings.moves and not draws.x.size:
            others |= _arrays_of_lines(model, draws, particles)
    found = _filter(model, draws, planned, stream, settings, **others)
    for array in (found.estimate, found.variance, found.cloud):
        array[np.isnan(array)] = np.nan  # which NaN an operation gives depends on the processor
    return found._replace(mse=found.mse[:, 0], degenerate=found.degenerate[:, 0])


def _arrays_of_lines(
    model: StateSpaceModel, draws: Draws, particles: int
) -> dict[str, NDArray[Any]]:
    """The arrays of the lines of particles that move, of a system whose truth is not known."""
    count, instants, _ = draws.z.shape
    components = codes_of(model.initial_noise, model.process_noise).shape[1]
    return {
        "noise": np.zeros((count, instants, components, particles), np.float32),
        "first_states": np.zeros((count, model.components[0], particles)),
        "counts": np.zeros((count, instants, len(model.ways)), np.uint8),
        "log_likelihoods": np.zeros((2, count, instants)),
    }


filter_draws = checking(filter_checked_draws)


@continuing
def filter_checked_sets(
    model: StateSpaceModel,
    draws: Draws,
    sets: Sequence[Times],
    ends: Sequence[int],
    stream: int,
    settings: Estimation,
    errors: str = "",
) -> FilterArrays:
    """Filter draws with several checked sets under the same noise: MSE, and which are degenerate.

    A prefix that two sets share is filtered once, which is faster than filtering the sets one by
    one and gives the same bits. `ends` are the last instants whose errors count; their sum is
    divided by the number of all instants. The times are sorted instants of the draws.
    `check_filter_settings` has accepted the settings for this model and the draws' model.

    With `SUMS`, the arrays have the sums of the weighted errors over the draws, too: NaN for a set
    if a draw is infinite with it, or degenerate although the truth is among the particles. Their
    memory does not grow with the draws. With `EACH_DRAW` they have the errors of each draw, all
    infinite or NaN if its MSE is. Errors after the end of a set are arbitrary.
    """
    planned, columns, givers = _planned(draws, sets, ends)
    shape: tuple[int, ...] = len(planned.measured), draws.z.shape[1] if errors else 0
    weights = ESTIMATORS[settings.estimator].weights
    # The kernel adds a term of all draws before the next one: then a sum would depend on the draws
    # that are filtered together, so each draw's terms are added up first. Each sensor that measures
    # gives a term of the evidence.
    has_terms = sum(map(bool, weights)) > 1 or bool(weights.distance or weights.evidence)
    by_draw = errors == SUMS and has_terms
    if errors != SUMS or by_draw:
        shape = (len(draws.index), *shape)
    found = _filter(model, draws, planned, stream, settings, errors=np.zeros(shape))
    mse, degenerate = found.mse[:, columns], found.degenerate[:, columns]
    shared = zip(givers, planned.begins, strict=True) if not settings.lag else ()
    for row, (giver, begin) in enumerate(shared):
        found.errors[..., row, :begin] = found.errors[..., giver, :begin]
    of_instants = found.errors[..., columns, :]
    if by_draw:
        nothing = np.zeros(of_instants.shape[1:])
        of_instants = reduce(np.add, weighed(of_instants, draws.instant_weights), nothing)
    if errors == SUMS:
        of_instants[~np.isfinite(mse).all(axis=0)] = np.nan
    else:
        of_instants = all_or_none(of_instants, mse)
    return found._replace(mse=mse, degenerate=degenerate, errors=of_instants)


def _filter(
    model: StateSpaceModel,
    draws: Draws,
    planned: Plan,
    stream: int,
    settings: Estimation,
    **others: NDArray[Any],
) -> FilterArrays:
    """The results with the sets of a plan; the other arrays that are given are filled, too."""
    truth, scheme = draws.model, ALL_SCHEMES[settings.resampling]
    planned, ruling, filled = applied(model, draws, planned, settings)
    mse = np.empty((len(draws.index), len(planned.measured)))
    written = {"work": np.zeros(1), **others, **filled}
    results = FilterArrays(mse, np.zeros(mse.shape, np.uint8), **written)
    prior, chosen, prior_weight = _prior(draws, stream, settings)
    extension = PROPOSALS[settings.proposal].extension(model, draws, settings)
    further = extension.blocks if extension else {}
    blocks, components = filter_blocks(model, truth, settings, draws.instants, further)
    streams = np.array(filter_streams(stream, settings.estimator), np.uint64)
    kinds = codes_of(model.initial_noise, model.process_noise)
    request = FilterRequest(
        draws=mse.shape[0],
        filters=streams.size,
        sets=mse.shape[1],
        instants=len(draws.instants),
        states=model.components[0],
        measurements=model.components[1],
        quantities=len(truth.is_angle),
        means=len(truth.is_angle) + 2 * sum(truth.is_angle),
        components_of_state=np.array(components, np.int64),
        is_state=bool(components) and not results.ranks.size,
        is_angle=np.array(truth.is_angle, np.uint8),
        sensors=len(model.ways),
        streams=streams,
        first_draw=draws.index.start,
        start=draws.start,
        has_prior=settings.prior is not None,
        has_weights=prior_weight.size > 0,
        columns=prior.shape[1],
        prior=prior,
        chosen=chosen,
        prior_weight=prior_weight,
        x=_array(draws.x),
        y=_array(draws.y),
        z=_array(draws.z),
        first_components=np.array([way.y.start for way in model.ways]),
        particles=settings.particles,
        log_particles=math.log(settings.particles),
        holds_truth=scheme.holds_truth,
        redrawn=np.array(extension.redrawn if extension else (), np.uint8),
        threshold=float(settings.threshold),
        weights=ESTIMATORS[settings.estimator].weights,
        instant_weights=_array(draws.instant_weights),
        components=kinds.shape[1],
        kinds=kinds,
        lag=int(np.max(settings.lag)),
        first_smoothed=first_smoothed(settings.lag, draws.instants),
    )
    filter_all(blocks, request, planned, results, scheme.name, ruling, extension)
    callbacks.raise_callback_error()
    if ESTIMATORS[settings.estimator].weights.distance:  # of an estimate that may be infinite
        mse[np.isnan(mse)] = np.inf
    degenerate = results.degenerate.view(np.bool_)
    if scheme.holds_truth:
        mse[degenerate] = np.nan  # the truth itself does not explain a measurement
    return with_points(results, len(model.ways))._replace(degenerate=degenerate)


def _planned(draws: Draws, sets: Sequence[Times], ends: Sequence[int] | None = None) -> Planned:
    """Plan the filter of several sets, with instants counted from the draws' first."""
    start, instants, sensors = draws.start, draws.z.shape[1], len(draws.model.ways)
    if start:
        sets = [tuple(time - start * sensors for time in times) for times in sets]
    stops = None if ends is None else tuple(end + 1 - start for end in ends)
    return plan_prefixes(sets, instants, stops, sensors)


def _prior(draws: Draws, stream: int, settings: Estimation) -> tuple[NDArray[Any], ...]:
    """States, choice and weights of the prior's particles; see `FilterRequest`."""
    if settings.prior is None:
        return np.empty((draws.x.shape[2], 0)), np.empty((0, 0, 0), np.int64), np.empty(0)
    if isinstance(settings.prior, Gaussian):
        raise PriorError("a particle filter must start from particles, got a normal distribution")
    prior, particles = settings.prior, settings.particles
    states = _array(prior.x)
    keys = filter_streams(stream, settings.estimator)
    weight = prior.weight_of_filters(particles) if settings.carries else None
    if weight is not None:
        as_it_is = np.broadcast_to(np.arange(particles), (len(keys), len(draws.index), particles))
        return states, _array(as_it_is, np.int64), _array(weight)
    chosen = [prior.chosen_for_filters(particles, draws.index, key) for key in keys]
    return states, _array(np.stack(chosen), np.int64), np.empty(0)


def _array(values: NDArray[Any], kind: Any = np.float64) -> NDArray[Any]:
    """The values as an array of the one type for which the filter is compiled.

    Numba would compile it once more for a prior with whole numbers, or for an array that cannot be
    written, as it arrives at a worker.
    """
    return np.require(values, kind, ["C_CONTIGUOUS", "WRITEABLE"])
