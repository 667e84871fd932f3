"""Differences of costs under common draws."""

import math
from typing import NamedTuple

import numpy as np

from pfdist.evaluation import Evaluation


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


def difference(first: Evaluation, second: Evaluation) -> Difference:
    """Estimate the cost of one set less that of another, on the draws that both have.

    What is common to both sets in a draw cancels, and with it most of the variance.
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
