"""The estimators of a draw's MSE. Data only: this imports no Numba."""

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
    "The variance of z over the particles, as a filter of any model believes it to be.",
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

ESTIMATORS = {
    estimator.name: estimator
    for estimator in (SQUARED_ERROR, FILTER_VARIANCE, TWO_FILTERS, OWN_VARIANCE)
}
"""The estimators that a job can name."""
if TYPE_CHECKING:
    EstimatorName = str
else:
    EstimatorName = Literal[tuple(ESTIMATORS)]

ALL_ESTIMATORS = ESTIMATORS | {FILTER_NOISE.name: FILTER_NOISE}
