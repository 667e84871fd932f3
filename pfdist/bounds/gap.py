"""The gap between a set's expected MSE and the lower bound of all sets of so many times."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pfdist.bounds.proof import Proof
from pfdist.common.estimate import Estimate
from pfdist.times.measurement_times import Times

_ROUNDING = 1e-12  # relative error of exact values
UNKNOWN, ZERO = Estimate(math.nan, math.nan), Estimate(0.0)


@dataclass(frozen=True)
class GapParts:
    """The expected MSE of a set, and the parts of its gap that no relaxation causes."""

    expected_mse: Estimate  # with the job's own filter; NaN if a draw is degenerate or infinite
    # Expected MSE with the true model, less the expected variance of particles among which the
    # truth stands. This is at least what the number of particles costs.
    estimate: Estimate = ZERO
    # expected MSE with the filter's model, less that with the true model
    filter_model: Estimate = ZERO
    both: Estimate = ZERO  # sum of both parts, with its own error
    # Expected MSE of the worst scenario, less the mean with the shares of the bound
    weighting: Estimate = ZERO


@dataclass(frozen=True)
class Gap:
    """How much lower the expected MSE of other times can be, for one set of a run."""

    name: str
    measurement_times: Times  # instants, as in `path`; times on the clock where a user reads them
    # with the job's own filter, on draws that neither chose the set nor gave the bound
    expected_mse: Estimate
    # Why there is no bound; then everything below is NaN. Empty if the bound holds.
    reason: str = ""
    # The bound holds for all feasible sets of so many times, or of so much money, in the units of
    # the relaxation.
    budget: int = 0
    bound: Estimate = UNKNOWN  # lower bound of the expected MSE of every such set, by any filter
    path: Times = ()  # the times that reach the bound in the relaxation
    # The sum of the three parts below over the expected MSE, at least 0. Each part is a difference
    # on common draws, so the gap has a smaller error than 1 - bound / expected_mse.
    gap: float = math.nan
    gap_at_most: float = math.nan  # one-sided limit of the gap
    relaxation: Estimate = UNKNOWN  # part of the gap: relaxation, also by shares, and chance
    estimate: Estimate = UNKNOWN  # part of the gap: number of particles and bias of the estimate
    filter_model: Estimate = UNKNOWN  # part of the gap: wrong model of the filter

    def columns(self) -> dict[str, Any]:
        """The gap as values of a table's row; an estimate becomes two values."""
        row = dict[str, Any]()
        for key, value in vars(self).items():
            if isinstance(value, Estimate):
                row |= {key: value.value, f"{key}_error": value.standard_error}
            else:
                row[key] = value
        return row


def gap_of(
    name: str, times: Times, parts: GapParts, proof: Proof, place: int, confidence: float
) -> Gap:
    """The gap of a feasible set, which is number `place` of the proof's known sets.

    `confidence` is that of the limit of the gap. The result is compared with other sets by
    `consistent`.
    """
    mse = parts.expected_mse
    if not math.isfinite(mse.value):
        return Gap(name, times, mse, "a draw is degenerate or infinite with the set itself")
    slack, budget = proof.slack[place].plus(parts.weighting), proof.budgets[place]
    total = slack.plus(parts.both)
    at_most = total.at_most(confidence)
    scale = 1 / mse.value if mse.value > 0 else 0.0
    is_below = total.is_negative() and -total.value * scale > _ROUNDING
    return Gap(
        name,
        times,
        mse,
        "the set costs less than the bound" if is_below else "",
        budget,
        proof.bounds[budget],
        proof.paths[budget],
        min(max(0.0, total.value * scale), 1.0),
        min(max(0.0, at_most * scale), 1.0),  # no error is negative
        relaxation=slack,
        estimate=parts.estimate,
        filter_model=parts.filter_model,
    )


def consistent(gaps: Mapping[str, Gap]) -> dict[str, Gap]:
    """The gaps of all known sets, without those that a wrong likelihood must have caused.

    With the likelihood of the noise, the variance is at most the squared error, and no set costs
    less than the bound.
    """
    everywhere = ""
    if any(gap.estimate.is_negative() for gap in gaps.values()):
        everywhere = "the variance of the particles exceeds their squared error"
    checked = {}
    for name, gap in gaps.items():
        reason = gap.reason or everywhere or _contradicted(gap, gaps)
        checked[name] = (
            Gap(name, gap.measurement_times, gap.expected_mse, reason) if reason else gap
        )
    return checked


def _contradicted(gap: Gap, gaps: Mapping[str, Gap]) -> str:
    """Why a known set contradicts the bound; empty if none does."""
    for other in gaps.values():
        error = math.hypot(other.expected_mse.standard_error, gap.bound.standard_error)
        difference = Estimate(gap.bound.value - other.expected_mse.value, error)
        if other.budget == gap.budget and difference.is_positive():
            return f"the set {other.name} costs less than the bound"
    return ""
