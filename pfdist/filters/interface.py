"""The contract of the engines: results, checked arguments, and a loop over several sets.

A draw's MSE is estimated by the error of the filter's mean against the simulated z, as in the
paper, or by the variance of the particles. Given y, the expected squared error of the filter's mean
is the variance of z given y plus the variance that the particles cause. So if the filter has the
true model, both have nearly the same expectation. The variance does not depend on the simulated z,
so it varies less between draws. Its expectation is too small by a term of order 1/P, about twice
the variance that the particles cause, which is half the expected squared distance of the means of
two filters on the same y.

The same holds for angles z with the error 1 - cos(z - m), where m is the direction of the mean of
the particles' unit vectors, and R the length of this mean. Given y, the expectation of
cos(z - m) is R if the particles are draws from the distribution of z. So 1 - R takes the place of
the variance. The mean vectors of two filters are independent. So R' cos(m - m'), with the second
filter's R' and m', has the expectation of cos(z - m), and the distance is R' (1 - cos(m - m')).

The compiled filter sums these estimates at each instant (`pfdist.kernels.filter`). This
module computes them from the recorded means and variances.

Source: Owen, "Monte Carlo theory, methods and examples", 2013, section 8.7 (conditioning).
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Lag, Times, validated
from pfdist.common.points import PointNumbers
from pfdist.errors import MeasurementTimesError
from pfdist.filters.cloud import Prior
from pfdist.filters.draws import Draws
from pfdist.filters.settings import check_filter_settings, check_start
from pfdist.filters.work import Estimation, filter_streams, sum_of_draws
from pfdist.kernels.batch import FilterArrays
from pfdist.kernels.estimators import ESTIMATORS, SQUARED_ERROR, ErrorWeights, Estimator
from pfdist.kernels.schemes import ALWAYS
from pfdist.models import StateSpaceModel
from pfdist.models.base import angular_error
from pfdist.models.twin import twin_of

Array = NDArray[np.float64]

SUMS, EACH_DRAW = "sums", "each draw"
"""Errors of instants that `filter_checked_sets` may be asked for: see `particle_filter`."""


def checking(filter_checked_draws: Callable[..., FilterArrays]) -> Callable[..., FilterArrays]:
    """A function that checks its arguments, and then calls the given filter.

    `filter_checked_draws` has the arguments of
    `pfdist.filters.particle_filter.filter_checked_draws`.
    """

    def filter_draws(
        model: StateSpaceModel,
        draws: Draws,
        measurement_times: Times,
        particles: int,
        stream: int,
        resampling: str = "multinomial",
        trajectories: bool = False,
        prior: Prior | None = None,
        threshold: float = ALWAYS,
        lag: Lag = 0,
    ) -> FilterArrays:
        """The result of a filter for D draws with one set of times and a 64-bit noise key.

        `model` is the filter's model, which need not be the draws'. With `trajectories`, the result
        has estimate and variance. `threshold` is that of `pfdist.kernels.schemes.threshold_of`, and
        `lag` that of `Estimation`. The Kalman filter ignores the particles, and only it starts from
        a normal distribution.

        Raises MeasurementTimesError, ModelError, PriorError or ArgumentError for wrong times,
        models, priors or settings.
        """
        settings = Estimation(particles, resampling, prior=prior, threshold=threshold, lag=lag)
        check_filter_settings(model, draws.model, settings)
        check_start(model, draws, prior)
        last = draws.instants[-1]
        times = validated_from(draws.start, measurement_times, last, model.points)
        return filter_checked_draws(model, draws, times, stream, settings, trajectories)

    return filter_draws


def validated_from(
    start: int, measurement_times: Iterable[int], end: int, points: PointNumbers
) -> Times:
    """A sorted set of points.

    Raises `MeasurementTimesError` if one is not an integer, lies outside the instants start..end,
    or is given twice.
    """
    first, last = points.first(start), points.at(end)[-1]
    times = validated(measurement_times, last)
    if times and times[0] < first:
        raise MeasurementTimesError(
            f"measurement_times must lie in {first}..{last}, got {times[0]}"
        )
    return times


def weighed(errors: NDArray[np.float64], weights: Any) -> NDArray[np.float64]:
    """Weighted errors, (..., T+1); with weight 0, even an infinite error counts as 0."""
    weighted: NDArray[np.float64] = np.zeros_like(errors)
    np.multiply(errors, weights, out=weighted, where=np.not_equal(weights, 0.0))
    return weighted


def one_by_one(
    filter_checked_draws: Callable[..., FilterArrays],
    model: StateSpaceModel,
    draws: Draws,
    sets: Sequence[Times],
    ends: Sequence[int],
    stream: int,
    settings: Estimation,
    errors: str = "",
) -> FilterArrays:
    """The results of `filter_checked_sets` by a filter that is called for each set.

    The other arguments are those of `pfdist.filters.particle_filter.filter_checked_sets`.
    """
    keys, estimator = filter_streams(stream, settings.estimator), ESTIMATORS[settings.estimator]
    count, instants = draws.z.shape[:2]
    mse, degenerate = np.empty((count, len(sets))), np.empty((count, len(sets)), np.bool_)
    sums = np.zeros((len(sets), instants))
    each_draw = np.zeros((*mse.shape, instants if errors else 0))
    measured = np.empty((count, 0), np.uint8)
    for column, (times, some) in enumerate(zip(sets, map(draws.upto, ends), strict=True)):
        filters = [filter_checked_draws(model, some, times, key, settings, True) for key in keys]
        until, measured = some.z.shape[1], filters[0].measured
        mse[:, column] = _mse(filters, some, estimator) * (until / instants)
        degenerate[:, column] = np.any([each.degenerate for each in filters], axis=0)
        with np.errstate(all="ignore"):
            if errors:
                each_draw[:, column, :until] = errors_of_filters(filters, some, estimator)
            if errors == SUMS:
                weighted = weighed(each_draw[:, column, :until], some.instant_weights)
                sums[column, :until] = sum_of_draws(weighted)
        is_unknown = np.isnan([each.mse for each in filters]).any()
        if is_unknown or not np.isfinite(sums[column]).all():
            sums[column] = np.nan
    if errors == SUMS:
        return FilterArrays(mse, degenerate, errors=sums)
    return FilterArrays(mse, degenerate, errors=all_or_none(each_draw, mse), measured=measured)


def all_or_none(errors: Array, mse: Array) -> Array:
    """The errors of each draw at each instant, all infinite or NaN where the draw's MSE is."""
    errors[~np.isfinite(mse)] = mse[~np.isfinite(mse), None]
    return errors


def errors_by_variance(
    estimates: Array, variances: Array, weights: ErrorWeights, is_angle: Sequence[bool]
) -> Array:
    """The estimated error of each instant, (D, T+1), from estimates and variances of F filters.

    Estimates and variances are (F, D, T+1, q), of independent filters on the same measurements. The
    weight of the squared error is ignored. The distance of two directions counts as much as the
    second filter's particles point in one direction, R: then the identity at the head of this
    module holds for angles, too.
    """
    errors: Array = np.zeros(variances.shape[1:3])
    if weights.variance:  # else an infinite variance would make a NaN
        errors += weights.variance * np.sum(variances, axis=(0, 3))
    if weights.distance:
        first, second = estimates
        angular = (1.0 - variances[1]) * angular_error(first, second)
        distances = np.where(is_angle, angular, (first - second) ** 2)
        errors += weights.distance * np.sum(distances, axis=2)
    return errors


def errors_of_filters(filters: Sequence[FilterArrays], draws: Draws, estimator: Estimator) -> Array:
    """The estimated error of each draw at each instant, (D, T+1), without its weight."""
    model = draws.model
    estimates, variances = (
        np.array([getattr(each, name) for each in filters]) for name in ("estimate", "variance")
    )
    errors = errors_by_variance(estimates, variances, estimator.weights, model.is_angle)
    if evidence := estimator.weights.evidence:
        (of_filter,) = filters
        log_evidence, explained = of_filter.log_likelihoods
        errors = evidence * log_evidence + estimator.weights.explained * explained
    if estimator.weights.squared_error:
        error, shape = twin_of(model, draws.instants).error, (len(draws.index), 1)
        for estimate in estimates:
            columns = [
                np.reshape(error(tuple(z.T), tuple(each.T), t, model.p), (-1, 1))
                for z, each, t in zip(
                    draws.z.swapaxes(0, 1), estimate.swapaxes(0, 1), draws.instants, strict=True
                )
            ]
            squared = np.concatenate([np.broadcast_to(each, shape) for each in columns], axis=1)
            errors = errors + estimator.weights.squared_error * squared
    return errors


def _mse(filters: Sequence[FilterArrays], draws: Draws, estimator: Estimator) -> Array:
    """The estimated MSE of each draw, (D,); NaN and inf of any filter remain."""
    mse: Array = np.sum([filtered.mse for filtered in filters], axis=0)
    if estimator == SQUARED_ERROR:
        return mse
    with np.errstate(all="ignore"):
        errors = weighed(errors_of_filters(filters, draws, estimator), draws.instant_weights)
        mean = np.mean(errors, axis=1)
    return np.where(np.isnan(mse), np.nan, np.where(mean < np.inf, mean, np.inf))
