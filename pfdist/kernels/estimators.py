"""The estimators of a draw's MSE that a job can name. Data only: this imports no Numba."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Estimator:
    """How the error of one instant is estimated.

    Parameters
    ----------
    name : str
        As job files name it.
    filters : int
        Number of independent filters.
    for_any_filter : bool
        Whether the estimate is right for any filter and any error. Otherwise the filter must know
        the truth, and the error must be the squared Euclidean norm.
    description : str
        The estimator in one line.
    """

    name: str
    filters: int = 1
    for_any_filter: bool = False
    description: str = ""


SQUARED_ERROR = Estimator(
    "squared_error", for_any_filter=True, description="The error of the filter's estimate."
)
FILTER_VARIANCE = Estimator(
    "filter_variance",
    description="The variance of z over the particles, summed over the components of z.",
)
TWO_FILTERS = Estimator(
    "two_filters",
    filters=2,
    description=(
        "The mean of the variances of two filters, plus the squared distance of their estimates."
    ),
)

ESTIMATORS = {
    estimator.name: estimator for estimator in (SQUARED_ERROR, FILTER_VARIANCE, TWO_FILTERS)
}
SQUARED_ERROR_INDEX = 0
"""The compiled filter receives the index of an estimator in this table."""
