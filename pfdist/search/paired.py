"""Differences of costs under common draws."""

import math
from typing import NamedTuple

import numpy as np

from pfdist.evaluation.estimate import Evaluation

CLEAR_ERRORS = 4.0
"""Number of standard errors beyond which chance alone does not explain a difference."""


class Difference(NamedTuple):
    """An estimate of one cost less another.

    Parameters
    ----------
    mean, standard_error : float
    """

    mean: float
    standard_error: float

    def is_worse(self, errors: float) -> bool:
        """Whether it is larger than 0 by more than so many standard errors."""
        return self.mean > errors * self.standard_error

    def is_better(self, errors: float) -> bool:
        """Whether it is less than 0 by more than so many standard errors."""
        return self.mean < -errors * self.standard_error


def difference(one: Evaluation, other: Evaluation) -> Difference:
    """Estimate the cost of one set less that of another, on the draws that both have.

    What is common to both sets in a draw cancels, and with it most of the variance.
    """
    if not (math.isfinite(one.cost) and math.isfinite(other.cost)):
        mean = 0.0 if one.cost == other.cost else one.cost - other.cost
        return Difference(mean, 0.0)
    if one.exact is not None and other.exact is not None:
        return Difference(one.exact - other.exact, 0.0)
    draws = min(one.draws, other.draws)
    apart = one.mse[:draws] - other.mse[:draws]
    apart = apart[~np.isnan(apart)]
    if apart.size < 2:
        return Difference(0.0, math.inf)
    return Difference(float(np.mean(apart)), float(np.std(apart, ddof=1) / math.sqrt(apart.size)))
