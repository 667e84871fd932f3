"""The proof: lower bounds, and the gap between the expected MSE of known sets and these bounds.

Errors are the variances of particles that include the truth. Their expectation is at most the error
of the exact filter, for any number of particles (`pfdist.kernels.schemes.CONDITIONAL`). The bound
is the minimum of many estimates. Its expectation is at most the minimum expected error, so on
average the bound is too low and the gap too large, which is safe.

Sources: Bayraksan, Morton, "Assessing solution quality in stochastic programs", Mathematical
Programming 108, 2006 (the gap of a candidate and the optimum, paired on the same draws). Efron,
Tibshirani, "An introduction to the bootstrap", 1993, chapter 11 (the jackknife).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.common.estimate import Estimate
from pfdist.common.measurement_times import Times
from pfdist.search.programme import Programme, highest, with_multipliers
from pfdist.search.relaxation import Relaxation

Array = NDArray[np.float64]


class Sums(NamedTuple):
    """Sums of errors over G groups of draws. A single group of one draw holds exact errors."""

    # (G, E): errors of all windows of a relaxation, as `pfdist.search.programme.Programme` takes
    relaxed: Array
    known: Array  # (G, C, T+1): errors of each known set
    draws: Array  # (G,): number of draws of each group

    def means(self) -> tuple[Array, Array]:
        """The mean errors of windows, (1+G, E), and the expected MSE of each known set, (1+G, C).

        The first row is the mean over all groups, and each other row leaves one group out. With a
        single group, there is only the first row.
        """
        relaxed, known = (resampled(part, self.draws) for part in (self.relaxed, self.known))
        return relaxed, known.mean(axis=2)


@dataclass(frozen=True)
class Proof:
    """The lower bounds for all sums that may be spent, and the slack of known sets."""

    # lower bound of the expected MSE for 0, 1, 2, ... measurements, or units of money
    bounds: list[Estimate]
    # the times that reach each bound in the relaxation; they need not reach it themselves
    paths: list[Times]
    budgets: list[int]  # for each known set, the sum whose bound holds for it
    # For each known set, how much its own expected error, by the same estimate on the same draws,
    # lies above the bound of the sum that it spends.
    slack: list[Estimate]


def prove(
    relaxation: Relaxation,
    sums: Sums,
    sets: Sequence[Times],
    most: int,
    budgets: Sequence[int] = (),
) -> Proof:
    """The lower bounds for all sums up to `most`, and the slack of C known sets.

    `budgets` are the sums of the known sets, by default those of the relaxation. The jackknife,
    which gives the standard errors, leaves one group of draws out.
    """
    relaxed, own = sums.means()
    budgets = [*budgets] or [relaxation.spent(times) for times in sets]
    whole = Programme(relaxation, relaxed[0], most)
    lowest = np.array([whole.mse, *(replace(whole, errors=row).mse for row in relaxed[1:])])
    paths = [whole.path(spent) for spent in range(most + 1)]
    for spent in {*budgets} if relaxation.constraints.most else ():
        own_sets = (times for times, own in zip(sets, budgets, strict=True) if own == spent)
        known = min(map(whole.of_set, own_sets))
        best = with_multipliers(relaxation, relaxed[0], spent, known)
        paths[spent] = best.path(spent)
        lowest[:, spent] = [replace(best, errors=row).mse[spent] for row in relaxed]
    return Proof(
        [jackknifed(bound) for bound in lowest.T],
        paths,
        budgets,
        [jackknifed(own[:, i] - lowest[:, budget]) for i, budget in enumerate(budgets)],
    )


def resampled(sums: Array, draws: Array) -> Array:
    """Means over all groups, then over all groups but each, (1+G, ...); (1, ...) for one group."""
    whole: Array = (sums.sum(axis=0) / draws.sum())[None]
    if len(draws) == 1:
        return whole
    left = (draws.sum() - draws).reshape(-1, *(1,) * (sums.ndim - 1))
    without = (sums.sum(axis=0) - sums) / left
    return np.concatenate([whole, without])


def jackknifed(values: Array) -> Estimate:
    """Estimate and standard error from the value of all groups and those without one group each."""
    whole, without = float(values[0]), values[1:]
    if not without.size or not math.isfinite(whole):
        return Estimate(whole)
    groups = without.size
    pseudo = groups * whole - (groups - 1) * without
    return Estimate(whole, Estimate.of_mean(pseudo).standard_error, groups - 1)


_ROUNDING = 1e-12  # relative error of exact values
UNKNOWN, ZERO = Estimate(math.nan, math.nan), Estimate(0.0)


@dataclass(frozen=True)
class GapTerms:
    """The expected MSE of a set, and the parts of its gap that the relaxation does not cause."""

    expected_mse: Estimate  # with the job's own filter; NaN if a draw is infinite
    # Expected MSE with the true model, less the expected variance of particles among which the
    # truth stands. This is at least what the number of particles adds.
    estimate: Estimate = ZERO
    # expected MSE with the filter's model, less that with the true model
    filter_model: Estimate = ZERO
    both: Estimate = ZERO  # sum of both parts, with its own error
    # Expected MSE of the worst scenario, less the mean with the shares of the bound
    weighting: Estimate = ZERO


@dataclass(frozen=True)
class Gap:
    """The largest possible reduction of the expected MSE of one set by other times."""

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

    def refused(self, reason: str) -> "Gap":
        """The gap without a bound, for its existing reason or for this one, if any."""
        reason = self.reason or reason
        return Gap(self.name, self.measurement_times, self.expected_mse, reason) if reason else self

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
    name: str, times: Times, parts: GapTerms, proof: Proof, place: int, confidence: float
) -> Gap:
    """The gap of a feasible set, which has the index `place` in the proof's known sets.

    `confidence` is that of the limit of the gap. The result is compared with other sets by
    `consistent`.
    """
    mse = parts.expected_mse
    if not math.isfinite(mse.value):
        return Gap(name, times, mse, "a draw is infinite with the set itself")
    slack, budget = proof.slack[place].plus(parts.weighting), proof.budgets[place]
    total = slack.plus(parts.both)
    at_most = total.at_most(confidence)
    scale = 1 / mse.value if mse.value > 0 else 0.0
    is_below = total.is_negative() and -total.value * scale > _ROUNDING
    return Gap(
        name,
        times,
        mse,
        "the error of the set lies below the bound" if is_below else "",
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
    """The gaps of all known sets, without bounds that a set with a lower error contradicts.

    `pfdist.runner.ranks` tests the likelihood.
    """
    return {name: gap.refused(_contradicted(gap, gaps)) for name, gap in gaps.items()}


def _contradicted(gap: Gap, gaps: Mapping[str, Gap]) -> str:
    """Why a known set contradicts the bound; empty if none does."""
    for other in gaps.values():
        error = math.hypot(other.expected_mse.standard_error, gap.bound.standard_error)
        difference = Estimate(gap.bound.value - other.expected_mse.value, error)
        if other.budget == gap.budget and difference.is_positive():
            return f"the error of the set {other.name} lies below the bound"
    return ""


def best_shares(relaxation: Relaxation, errors: Array, spent: int) -> tuple[float, ...]:
    """The shares of C scenarios that maximise the smallest relaxed expected MSE of a sum.

    `errors` (C, E) are the expected errors of all windows in each scenario.
    """
    alone = [Programme(relaxation, row, spent) for row in errors]

    def lowest(shares: Array) -> tuple[float, Array]:
        mean = np.sum(shares[:, None] * errors, axis=0)  # BLAS would round by the processor
        path = Programme(relaxation, mean, spent).path(spent)
        return 0.0, np.array([programme.of_set(path) for programme in alone])

    shares = highest(lowest, np.full(len(errors), 1.0 / len(errors)), total=1.0)
    return tuple(shares.tolist())
