"""The estimators of a draw's MSE; data only, without an import of Numba."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple


class ErrorWeights(NamedTuple):
    """The estimated error of an instant as a weighted sum: the weight of each term."""

    squared_error: float = 0.0  # of the error of each filter's estimate of z
    variance: float = 0.0  # of each filter's variance of z, summed over the components of z
    # of the squared distance between the estimates of two independent filters
    distance: float = 0.0


@dataclass(frozen=True)
class Estimator:
    """An estimator of the error of one instant."""

    name: str  # as job files name it
    weights: ErrorWeights
    description: str  # in one line, for help and manual
    needs_truth: bool = False  # whether the filter's model must be the true model
    # whether the mean of the truth's error over the particles takes the place of the variance: for
    # the squared norm, and for angles with their default error, they are equal
    by_error: bool = False

    @property
    def filters(self) -> int:
        """Number of independent filters."""
        return 2 if self.weights.distance else 1

    @property
    def for_any_filter(self) -> bool:
        """Whether the estimate is right for any filter and any error.

        For any other estimator the error must be the squared Euclidean norm, and the filter's model
        must be the true model if `needs_truth`.
        """
        return not self.weights.variance and not self.weights.distance


SQUARED_ERROR = Estimator(
    "squared_error", ErrorWeights(squared_error=1.0), "The error of the filter's estimate."
)
FILTER_VARIANCE = Estimator(
    "filter_variance",
    ErrorWeights(variance=1.0),
    "The variance of z over the particles, summed over the components of z.",
    needs_truth=True,
)
OWN_VARIANCE = Estimator(
    "own_variance",
    ErrorWeights(variance=1.0),
    "The variance of z over the particles, for a filter with any model.",
)
TWO_FILTERS = Estimator(
    "two_filters",
    ErrorWeights(variance=0.5, distance=1.0),
    "The mean of the variances of two filters, plus the squared distance of their estimates.",
    needs_truth=True,
)
FILTER_NOISE = Estimator(
    "filter_noise",
    ErrorWeights(distance=0.5),
    "Half the squared distance of the estimates of two filters: the part of particles alone.",
)
CONTROL = Estimator(
    "control",
    ErrorWeights(squared_error=1.0, variance=-1.0),
    "The error of the estimate, less the mean error of the particles against it.",
    needs_truth=True,
    by_error=True,
)
"""The control variate of the comparison: with the truth among the particles its mean is exactly 0.

Given y and the cloud as a set, the truth is distributed as the weights, see
`pfdist.kernels.schemes.CONDITIONAL`. This holds for any error and any number of particles.

Source: Owen, "Monte Carlo theory, methods and examples", 2013, section 8.9 (control variates).
"""

ESTIMATORS = {
    estimator.name: estimator
    for estimator in (SQUARED_ERROR, FILTER_VARIANCE, TWO_FILTERS, OWN_VARIANCE)
}
"""The estimators that a job can name."""
if TYPE_CHECKING:
    EstimatorName = str
else:
    EstimatorName = Literal[tuple(ESTIMATORS)]

ALL_ESTIMATORS = ESTIMATORS | {each.name: each for each in (FILTER_NOISE, CONTROL)}
