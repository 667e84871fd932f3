"""Estimates of one draw's MSE, by what the filter knows of itself: cheaper ones than the error.

The error of the filter's mean, given y, is on average the variance of z given y, and what the
particles add. So where the filter knows the truth, three estimates have nearly one expectation:

=============== ==================================================================================
squared_error   the error of the mean against the z that was drawn: the paper's, and the only one
                that any error and any filter allow
filter_variance the particles' variance: z itself is not needed, so its chance is gone; less than
                squared_error by a term of order 1/P, about twice what the particles add
two_filters     the mean of two filters' variances on the same y, and the squared distance of
                their means, which is twice what the particles of one add: by this the term of order
                1/P is that of squared_error
=============== ==================================================================================

The compiled filter adds them up as it goes (`pfdist.kernels.moments`); here they are made from
what a filter tells, for the engines that compute one set after another.

References
----------
Owen, "Monte Carlo theory, methods and examples", 2013, section 8.7 (conditioning).
"""

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from pfdist.filters.draws import Draws
from pfdist.filters.particle_filter import Filtered, filter_streams
from pfdist.kernels.estimators import ESTIMATORS, SQUARED_ERROR
from pfdist.models import StateSpaceModel
from pfdist.times.measurement_times import Times

Array = NDArray[np.float64]


def one_by_one(filter_draws: Callable[..., Filtered]) -> Callable[..., Array]:
    """Make of a filter of one set what `pfdist.filters.particle_filter.filter_sets` is of several.

    Parameters
    ----------
    filter_draws : callable
        As `pfdist.filters.particle_filter.filter_draws`.
    """

    def filter_sets(
        model: StateSpaceModel,
        draws: Draws,
        sets: Sequence[Times],
        particles: int,
        stream: int,
        resampling: str,
        dtype: str,
        ends: Sequence[int],
        estimator: str,
    ) -> Array:
        keys, columns = filter_streams(stream, estimator), []
        for times, end in zip(sets, ends, strict=True):
            prefix = draws.upto(end)
            filters = [
                filter_draws(model, prefix, times, particles, key, resampling, True, dtype)
                for key in keys
            ]
            columns.append(_mse(filters, estimator) * ((end + 1) / draws.z.shape[1]))
        return np.stack(columns, axis=1)

    return filter_sets


def filter_variance(variance: Array) -> Array:
    """Estimate what an instant costs by one filter's variance.

    Parameters
    ----------
    variance : array of float64, (D, T+1, q)

    Returns
    -------
    array of float64, (D, T+1)
    """
    total: Array = np.sum(variance, axis=2)
    return total


def two_filters(estimates: Array, variances: Array) -> Array:
    """Estimate what an instant costs by two independent filters on the same measurements.

    Parameters
    ----------
    estimates, variances : array of float64, (2, D, T+1, q)

    Returns
    -------
    array of float64, (D, T+1)
    """
    apart: Array = np.sum((estimates[0] - estimates[1]) ** 2, axis=2)
    return filter_variance(np.mean(variances, axis=0)) + apart


def _mse(filters: Sequence[Filtered], estimator: str) -> Array:
    """Estimate each draw's MSE, (D,); a draw that ended in one filter has ended."""
    mse: Array = np.sum([filtered.mse for filtered in filters], axis=0)
    if estimator == SQUARED_ERROR.name:
        return mse
    means, variances = (
        np.array([getattr(filtered, name) for filtered in filters])
        for name in ("estimate", "variance")
    )
    with np.errstate(all="ignore"):
        two = ESTIMATORS[estimator].filters == 2
        costs = two_filters(means, variances) if two else filter_variance(variances[0])
        mean = np.mean(costs, axis=1)
    return np.where(np.isnan(mse), np.nan, np.where(mean < np.inf, mean, np.inf))
