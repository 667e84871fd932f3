"""The effective sample sizes of a filter that is given the measurements of one system."""

import math
from typing import cast

import numpy as np
from numpy.typing import NDArray

from pfdist.errors import MeasurementsError
from pfdist.filters.cloud import Cloud
from pfdist.sequential.beliefs import Particles, weighed
from pfdist.sequential.one_filter import OneFilter
from pfdist.times.measurement_times import Times

Array = NDArray[np.float64]


def effective_sample_sizes(filtering: OneFilter, times: Times, y: Array) -> list[float]:
    """Give the effective sample size after each measurement, before the particles are resampled.

    Parameters
    ----------
    filtering : OneFilter
        A filter with particles, before the first of the times.
    times : tuple of int, (N,)
    y : array of float64, (N, m)
        The measurement at each time.

    Returns
    -------
    list of float, (N,)
        NaN from the first measurement that no particle explains.

    References
    ----------
    Kong, Liu, Wong, "Sequential imputations and Bayesian missing data problems", Journal of the
    American Statistical Association 89, 1994.
    """
    sizes = []
    try:
        for t, measured in zip(times, y, strict=True):
            predicted, *_ = filtering.at(t)
            cloud = cast(Cloud, predicted.settings.prior)
            filtering, *_ = predicted.at(t, measured)
            share, _ = weighed(filtering.model, cloud, measured)
            sizes.append(Particles(cloud.x, share).effective_sample_size())
    except MeasurementsError:
        pass
    return sizes + [math.nan] * (len(times) - len(sizes))
