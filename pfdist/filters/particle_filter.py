"""The intermittent particle filter (paper, section 2.1).

Sampling importance resampling: particles are propagated by the model, and weighted and resampled
only at the measurement times. `pfdist.kernels.fused_filter` compiles it. `pfdist.filters.plain`
holds the same filter in plain NumPy, for reading.

Source: Arulampalam, Maskell, Gordon, Clapp, "A tutorial on particle filters", 2002, algorithm 4
(which resamples systematically; a job chooses the scheme).
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.errors import PriorError
from pfdist.filters import plain
from pfdist.filters.cloud import Gaussian
from pfdist.filters.draws import Draws
from pfdist.filters.interface import Filtered, checking
from pfdist.filters.work import Estimation, filter_streams
from pfdist.kernels.cloud import FROM_INITIAL, FilterFormulas, Prior
from pfdist.kernels.estimators import ALL_ESTIMATORS
from pfdist.kernels.formulas import compiled_formulas
from pfdist.kernels.fused_filter import Request, Results, fused_filter
from pfdist.kernels.prefixes import Plan, Planned, measurements_of, plan
from pfdist.kernels.schemes import ALL_SCHEMES
from pfdist.kernels.scratch import WithScratch
from pfdist.models import StateSpaceModel
from pfdist.models.parameters import flat_parameters, parameter_names
from pfdist.times.measurement_times import Times

KERNEL_VERSION = 5
"""Number of changes after which the same keys give other figures; part of a run's identity."""


class _Wanted(NamedTuple):
    """Arrays that the filter fills besides the mse; see `pfdist.kernels.fused_filter.Results`."""

    moments: NDArray[np.float64] = np.empty((2, 0, 0, 0))
    errors: NDArray[np.float64] = np.empty((0, 0))
    ranks: NDArray[np.float64] = np.empty((2, 0, 0, 0))
    cloud: NDArray[np.float64] = np.empty((0, 0, 0))
    weight: NDArray[np.float64] = np.empty((0, 0))


_NOTHING_ELSE = _Wanted()


def filter_checked_draws(
    model: StateSpaceModel,
    draws: Draws,
    measurement_times: Times,
    stream: int,
    settings: Estimation,
    trajectories: bool = False,
) -> Filtered:
    """Filter draws as `filter_draws` does, with arguments that the caller has checked.

    The times are sorted instants of the draws. `check_filter` has accepted the settings for this
    model and the draws' model.
    """
    planned = _planned(draws, (measurement_times,)).plan
    if not trajectories:
        mse, degenerate = _filter(model, draws, planned, stream, settings)
        return Filtered(mse[:, 0], degenerate[:, 0])
    count, particles = len(draws.index), settings.particles
    wanted = _Wanted(
        moments=np.full((2, *draws.z.shape), np.nan),
        ranks=np.full((2, *draws.z.shape), np.nan),
        cloud=np.full((count, model.components[0], particles), np.nan),
        weight=np.ones((count, particles)),
    )
    mse, degenerate = _filter(model, draws, planned, stream, settings, wanted)
    estimate, variance = wanted.moments
    for array in (estimate, variance, wanted.cloud):
        array[np.isnan(array)] = np.nan  # which NaN an operation gives depends on the processor
    weights = wanted.weight if settings.carries else None
    given = estimate, variance, tuple(wanted.cloud), weights, wanted.ranks
    return Filtered(mse[:, 0], degenerate[:, 0], *given)


filter_draws = checking(filter_checked_draws)


def filter_checked_sets(
    model: StateSpaceModel,
    draws: Draws,
    sets: Sequence[Times],
    ends: Sequence[int],
    stream: int,
    settings: Estimation,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The MSE of draws with several checked sets under the same noise, (D, S).

    The second array, (D, S), says which of them are degenerate.

    A prefix that two sets share is filtered once. This is faster than filtering the sets one by
    one, and gives the same bits. `ends` are the last instants whose errors count; their sum is
    divided by the number of all instants. The times are sorted instants of the draws.
    `check_filter` has accepted the settings for this model and the draws' model.
    """
    planned, columns, _ = _planned(draws, sets, ends)
    mse, degenerate = _filter(model, draws, planned, stream, settings)
    return mse[:, columns], degenerate[:, columns]


def sum_errors(
    model: StateSpaceModel,
    draws: Draws,
    sets: Sequence[Times],
    ends: Sequence[int],
    stream: int,
    settings: Estimation,
) -> NDArray[np.float64]:
    """Sums of the errors of each instant over draws, (S, T+1), with checked arguments.

    A set has NaN if a draw is infinite with it, or degenerate although the truth is among the
    particles. Values after the end of a set mean
    nothing. The memory does not grow with the draws. Arguments are those of `filter_checked_sets`.
    """
    instants = draws.z.shape[1]
    planned, columns, givers = _planned(draws, sets, ends)
    errors = np.zeros((len(planned.measured), instants))
    mse, _ = _filter(model, draws, planned, stream, settings, _Wanted(errors=errors))
    for row, giver, begin in zip(errors, givers, planned.begins, strict=True):
        row[:begin] = errors[giver, :begin]
    sums = errors[columns]
    sums[~np.isfinite(mse[:, columns]).all(axis=0)] = np.nan
    return sums


def _filter(
    model: StateSpaceModel,
    draws: Draws,
    planned: Plan,
    stream: int,
    settings: Estimation,
    wanted: _Wanted = _NOTHING_ELSE,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """The mse of the sets of a plan, (D, U), and which draws are degenerate, (D, U).

    The other arrays that are wanted are filled.
    """
    mse, truth = np.empty((len(draws.index), len(planned.measured))), draws.model
    degenerate = np.zeros(mse.shape, np.bool_)
    request = Request(
        np.array(filter_streams(stream, settings.estimator), np.uint64),
        draws.index.start,
        draws.start,
        _prior(draws, stream, settings),
        draws.x,
        draws.y,
        draws.z,
        settings.particles,
        ALL_ESTIMATORS[settings.estimator].weights,
        draws.instant_weights,
        settings.threshold,
        flat_parameters(model.parameters, draws.instants.stop),
        flat_parameters(truth.parameters, draws.instants.stop),
    )
    estimate, variance = wanted.moments
    at = np.zeros(2, np.int64)
    results = Results(mse, degenerate, estimate, variance, *wanted[1:], at)

    def again() -> str:
        """Filter the failed draw in NumPy."""
        row, number = at
        sensors = len(model.parts)
        measured = measurements_of(planned.measured[number], sensors)
        times = tuple(draws.start * sensors + measurement for measurement in measured)
        end, draw = draws.start + planned.ends[number] - 1, draws[row : row + 1]
        plain.filter_checked_sets(model, draw, [times], [end], stream, settings)
        return f"the filter of draw {draw.index.start}"

    with compiled_formulas(model.name, again):
        compiled_filter(model, truth, settings)(request, planned, results)
    if ALL_SCHEMES[settings.resampling].holds_truth:
        mse[degenerate] = np.nan  # the truth itself does not explain a measurement
    return mse, degenerate


def _planned(draws: Draws, sets: Sequence[Times], ends: Sequence[int] | None = None) -> Planned:
    """Plan the filter of several sets, with instants counted from the draws' first."""
    start, instants, sensors = draws.start, draws.z.shape[1], len(draws.model.parts)
    if start:
        sets = [tuple(time - start * sensors for time in times) for times in sets]
    stops = None if ends is None else tuple(end + 1 - start for end in ends)
    return plan(tuple(sets), instants, stops, sensors)


def _prior(draws: Draws, stream: int, settings: Estimation) -> Prior:
    """The particles from which each draw's filter starts."""
    if settings.prior is None:
        return FROM_INITIAL
    if isinstance(settings.prior, Gaussian):
        raise PriorError("a particle filter must start from particles, got a normal distribution")
    prior, particles = settings.prior, settings.particles
    weight = prior.weight_of_filters(particles) if settings.carries else None
    if weight is not None:
        as_it_is = np.broadcast_to(np.arange(particles), (2, len(draws.index), particles))
        return Prior(np.ascontiguousarray(prior.x), np.ascontiguousarray(as_it_is), weight)
    chosen = [
        prior.chosen_for_filters(particles, draws.index, key)
        for key in filter_streams(stream, settings.estimator)
    ]
    return Prior(np.ascontiguousarray(prior.x), np.stack(chosen), np.empty(0))


def compiled_filter(
    model: StateSpaceModel, truth: StateSpaceModel, settings: Estimation
) -> WithScratch:
    """The compiled filter of a model, whose errors the truth defines."""
    proposal: tuple[Any, ...] = ()
    noise_kinds: tuple[tuple[str, ...], ...] = (model.initial_noise, model.process_noise)
    if settings.guides(model):
        proposal = (model.proposal, model.proposal_log_density)
        noise_kinds = (*noise_kinds, model.proposal_variates)
    formulas = FilterFormulas(
        model.initial,
        model.transition,
        model.quantity_of_interest,
        truth.formulas["error"],
        tuple(part.model.log_likelihood for part in model.parts),
        proposal,
    )
    states, _, quantities = model.components
    return fused_filter(
        formulas,
        noise_kinds,
        (states, tuple(part.model.components[1] for part in model.parts), quantities),
        (parameter_names(model.parameters), parameter_names(truth.parameters)),
        settings.resampling,
        truth.is_angle,
        settings.carries,
    )
