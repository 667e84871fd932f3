"""Paired differences of costs: two sets evaluated on common draws."""

import math
from typing import NamedTuple

import numpy as np

from pfdist.evaluation.estimate import Evaluation

CLEAR_ERRORS = 4.0
"""Number of standard errors beyond which chance alone does not explain a difference."""


class Difference(NamedTuple):
    """An estimate of the difference of two costs.

    Parameters
    ----------
    mean, standard_error : float
    """

    mean: float
    standard_error: float

    def is_worse(self, errors: float) -> bool:
        """Whether the difference lies above 0 by more than this number of standard errors."""
        return self.mean > errors * self.standard_error

    def is_better(self, errors: float) -> bool:
        """Whether the difference lies below 0 by more than this number of standard errors."""
        return self.mean < -errors * self.standard_error


def difference(first: Evaluation, second: Evaluation) -> Difference:
    """Give the cost of the first set minus that of the second, on the draws that both have.

    Errors common to both sets cancel in each draw, and with them most of the variance.
    """
    if not (math.isfinite(first.cost) and math.isfinite(second.cost)):
        mean = 0.0 if first.cost == second.cost else first.cost - second.cost
        return Difference(mean, 0.0)
    if first.exact is not None and second.exact is not None:
        return Difference(first.exact - second.exact, 0.0)
    draws = min(first.draws, second.draws)
    apart = first.mse[:draws] - second.mse[:draws]
    apart = apart[~np.isnan(apart)]
    if apart.size < 2:
        return Difference(0.0, math.inf)
    return Difference(float(np.mean(apart)), float(np.std(apart, ddof=1) / math.sqrt(apart.size)))
