"""The estimators of a draw's MSE; data only, without an import of Numba."""

from dataclasses import dataclass
from typing import NamedTuple


class ErrorWeights(NamedTuple):
    """The estimated error of an instant as a weighted sum: the weight of each term."""

    squared_error: float = 0.0  # of the error of each filter's estimate of z
    variance: float = 0.0  # of each filter's variance of z, summed over the components of z
    # of the squared distance between the estimates of two independent filters
    distance: float = 0.0
    # of the log evidence of each measurement, and of the mean log-likelihood of the particles after
    # it
    evidence: float = 0.0
    explained: float = 0.0


@dataclass(frozen=True)
class Estimator:
    """An estimator of the error of one instant."""

    name: str  # as tables name it
    weights: ErrorWeights
    # whether the mean of the truth's error over the particles takes the place of the variance: for
    # the squared norm, and for angles with their default error, they are equal
    by_error: bool = False

    @property
    def filters(self) -> int:
        """Number of independent filters."""
        return 2 if self.weights.distance else 1


SQUARED_ERROR = Estimator("squared_error", ErrorWeights(squared_error=1.0))
"""The error of the filter's estimate, for any filter and any error."""

FILTER_VARIANCE = Estimator("filter_variance", ErrorWeights(variance=1.0))
"""The variance of z over the particles, summed over the components of z.

It is an error only if the filter has the true model, and the error is the squared norm.
"""

FILTER_NOISE = Estimator("filter_noise", ErrorWeights(distance=0.5))
"""Half the squared distance of the estimates of two filters: the part of particles alone."""

TWO_CLOUDS = Estimator("two_clouds", ErrorWeights(variance=0.5, distance=0.5))
"""The mean variance of two clouds, and half the squared distance of their estimates.

What the variance lacks, because few ancestral lines are left, the distance has: the sum is nearly
the error of the exact smoother, even with few particles. The conditions are those of the variance.
"""

TWO_ERRORS = Estimator("two_errors", ErrorWeights(squared_error=0.5, distance=-0.5))
"""The mean squared error of two filters, less half the squared distance of their estimates.

It is the product of both errors, whose noise is independent: the error without the part of
particles, for any filter model. It varies more than `TWO_CLOUDS`.
"""

CONTROL = Estimator("control", ErrorWeights(squared_error=1.0, variance=-1.0), by_error=True)
"""The control variate of the comparison: the error less the particles' mean error against it.

The filter must have the true model. With the truth among the particles its mean is exactly 0: given
y and the cloud as a set, the truth is distributed as the weights, see
`pfdist.kernels.schemes.CONDITIONAL`. This holds for any error and any number of particles.

Source: Owen, "Monte Carlo theory, methods and examples", 2013, section 8.9 (control variates).
"""

EVIDENCE = Estimator("evidence", ErrorWeights(evidence=1.0))
"""The log evidence of the measurements.

Its expectation is at most the true one. With the truth among the particles it is at least the true
one, because 1 / evidence is unbiased then. So both are sides of the truth.
"""

INFORMATION = Estimator("information", ErrorWeights(evidence=1.0, explained=-1.0))
"""Minus the information of the measurements of each instant, in nats.

The truth must be among the particles. Given y and the cloud as a set, it is distributed as the
weights, so the mean log-likelihood of the weighted particles takes the place of the truth's. The
information is at most the true one, for any number P of particles, and at most log P a measurement.

Source: Grosse, Ancha, Roy, "Measuring the reliability of MCMC inference with bidirectional Monte
Carlo", NeurIPS 2016.
"""

ESTIMATORS = {
    each.name: each
    for each in (
        SQUARED_ERROR, FILTER_VARIANCE, FILTER_NOISE, TWO_CLOUDS, TWO_ERRORS, CONTROL, EVIDENCE,
        INFORMATION,
    )
}  # fmt: skip
