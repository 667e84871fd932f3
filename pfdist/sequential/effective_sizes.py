"""The effective sample sizes of a filter that receives the measurements of one system."""

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
    """Effective sample size after each measurement, (N,), before the particles are resampled.

    The filter has particles and stands before the first of N times; y, (N, m), has the measurement
    at each. The sizes are NaN from the first measurement at which the filter fails: no particle
    explains it, or a state is not finite. (Kong, Liu, Wong, "Sequential imputations and Bayesian
    missing data problems", Journal of the American Statistical Association 89, 1994.)
    """
    sizes = [math.nan] * len(times)
    for number, (t, measured) in enumerate(zip(times, y, strict=True)):
        try:
            predicted, *_ = filtering.at(t)
            filtering, *_ = predicted.at(t, measured)
        except MeasurementsError:
            return sizes  # from here on the filter has no belief
        cloud = cast(Cloud, predicted.settings.prior)
        share, _ = weighed(filtering.model, cloud, measured)
        sizes[number] = Particles(cloud.x, share).effective_sample_size()
    return sizes
