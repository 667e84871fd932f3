"""The guard of a bound: withdraw bounds that more particles, or known sets, contradict.

With peaked likelihoods and few particles, the variance of the particles can exceed that of the
exact filter. It then falls as particles are added.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

from pfdist.bounds.gap import Gap
from pfdist.bounds.proof import Estimate

_TOLERATED = 0.005  # fall of a variance with more particles


@dataclass(frozen=True)
class Falls:
    """How far bounds and variances fall with more particles, on the same draws.

    Parameters
    ----------
    of_bounds : list of Estimate
        Relative fall of the bound of each sum that may be spent.
    of_sets : list of Estimate
        Relative fall of the variance of each known set.
    particles : str
        Says how many particles were taken in the place of how many.
    """

    of_bounds: list[Estimate]
    of_sets: list[Estimate]
    particles: str


def guarded(gaps: Mapping[str, Gap], falls: Falls) -> dict[str, Gap]:
    """Give the gaps without the bounds that are contradicted.

    Parameters
    ----------
    gaps : mapping of str to Gap
        All known sets.
    falls : Falls
    """
    everywhere = _reason_for_all(gaps, falls)
    checked = {}
    for name, gap in gaps.items():
        fall = falls.of_bounds[gap.budget]
        reason = gap.reason or everywhere or _reason(gap, gaps, fall, falls.particles)
        if reason:
            checked[name] = Gap(name, gap.measurement_times, gap.expected_mse, reason)
        else:
            share = max(0.0, fall.value)
            checked[name] = replace(gap, gap_at_most=gap.gap_at_most + share, fall=share)
    return checked


def _reason_for_all(gaps: Mapping[str, Gap], falls: Falls) -> str:
    """Say why no set has a bound; empty if nothing speaks against all bounds."""
    if any(gap.estimate.is_negative for gap in gaps.values()):
        return "the variance of the particles exceeds their squared error"
    if any(map(_is_large, falls.of_sets)):
        return f"the variance of a compared set falls with {falls.particles}"
    return ""


def _reason(gap: Gap, gaps: Mapping[str, Gap], fall: Estimate, particles: str) -> str:
    """Say why a set has no bound; empty if nothing speaks against the bound."""
    if _is_large(fall):
        return f"the bound falls by {100 * fall.value:.2g} % with {particles}"
    for other in gaps.values():
        error = math.hypot(other.expected_mse.standard_error, gap.bound.standard_error)
        difference = Estimate(gap.bound.value - other.expected_mse.value, error)
        alike = other.budget == gap.budget
        if alike and difference.is_positive:
            return f"the set {other.name} costs less than the bound"
    return ""


def _is_large(fall: Estimate) -> bool:
    return fall.is_positive and fall.value > _TOLERATED
