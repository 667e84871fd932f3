"""Paired differences of costs: two sets evaluated on common draws."""

import math

import numpy as np

from pfdist.common.estimate import Estimate
from pfdist.evaluation.estimate import Evaluation


def difference(first: Evaluation, second: Evaluation) -> Estimate:
    """Cost of the first set minus that of the second, on the draws that both have.

    Errors common to both sets cancel in each draw, and with them most of the variance.
    """
    if not (math.isfinite(first.cost) and math.isfinite(second.cost)):
        mean = 0.0 if first.cost == second.cost else first.cost - second.cost
        return Estimate(mean)
    if first.exact is not None and second.exact is not None:
        return Estimate(first.exact - second.exact)
    draws = min(first.draws, second.draws)
    apart = first.mse[:draws] - second.mse[:draws]
    return Estimate.of_mean(apart[~np.isnan(apart)])
