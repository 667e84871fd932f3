"""The gap between a set's expected MSE and the lower bound of all sets of so many times."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from pfdist.bounds.proof import Estimate
from pfdist.times.measurement_times import Times

UNKNOWN = Estimate(math.nan, math.nan)


@dataclass(frozen=True)
class Gap:
    """How much lower the expected MSE of other times can be, for one set of a run.

    Parameters
    ----------
    name : str
    measurement_times : tuple of int
    expected_mse : Estimate
        With the job's own filter, on draws that neither chose the set nor gave the bound.
    reason : str
        Why there is no bound; then everything below is NaN. Empty if the bound holds.
    bound : Estimate
        Lower bound of the expected MSE of every feasible set of so many times, by any filter.
    path : tuple of int
        The times that reach the bound in the relaxation.
    gap : float
        The sum of the three parts below over the expected MSE, at least 0. Each part is a
        difference on common draws, so the gap has a smaller error than 1 - bound / expected_mse.
    gap_at_most : float
        One-sided 95 % limit of the gap, and what the bound falls with four times the particles.
    relaxation, estimate, filter_model : Estimate
        The parts of the difference: relaxation and chance; number of particles and bias of the
        estimate; wrong model of the filter.
    """

    name: str
    measurement_times: Times
    expected_mse: Estimate
    reason: str = ""
    bound: Estimate = UNKNOWN
    path: Times = ()
    gap: float = math.nan
    gap_at_most: float = math.nan
    relaxation: Estimate = UNKNOWN
    estimate: Estimate = UNKNOWN
    filter_model: Estimate = UNKNOWN


def contradiction(gap: Gap, gaps: Mapping[str, Gap]) -> str:
    """Say which known set costs less than the bound; empty if none does.

    Parameters
    ----------
    gap : Gap
        With the bound.
    gaps : mapping of str to Gap
        All known sets; those of more measurements contradict nothing.
    """
    for other in gaps.values():
        error = math.hypot(other.expected_mse.standard_error, gap.bound.standard_error)
        difference = Estimate(gap.bound.value - other.expected_mse.value, error)
        fewer = len(other.measurement_times) <= len(gap.measurement_times)
        if fewer and difference.is_positive:
            return f"the set {other.name} costs less than the bound"
    return ""
