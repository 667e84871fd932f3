"""The proof: how far the expected MSE of known sets can lie above that of any feasible set.

Errors are the variances of particles among which the truth stands. Their expectation is at most
the error of the exact filter, for any number of particles (`pfdist.kernels.schemes.CONDITIONAL`).
The bound is the least of many estimated costs. Its expectation is at most the least expected cost,
so it is too low on average, and the gap too large: this is the safe direction.

Sources: Bayraksan, Morton, "Assessing solution quality in stochastic programs", Mathematical
Programming 108, 2006 (the gap of a candidate and the optimum, paired on the same draws). Efron,
Tibshirani, "An introduction to the bootstrap", 1993, chapter 11 (the jackknife).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.bounds.programme import least
from pfdist.bounds.relaxation import Relaxation
from pfdist.common.estimate import Estimate
from pfdist.times.measurement_times import Times

Array = NDArray[np.float64]


class Sums(NamedTuple):
    """Sums of errors over G groups of draws. A single group of one draw holds exact errors."""

    # (G, E): errors of all windows of a relaxation, as `pfdist.bounds.programme.least` takes them
    relaxed: Array
    own: Array  # (G, C, T+1): errors of each known set
    draws: Array  # (G,): number of draws of each group

    def means(self) -> tuple[Array, Array]:
        """Mean errors of the windows, (1+G, E), and expected MSE of each known set, (1+G, C).

        The first row is the mean over all groups, and each other row leaves one group out. With a
        single group, there is only the first row.
        """
        relaxed, own = (_resampled(part, self.draws) for part in (self.relaxed, self.own))
        return relaxed, own.mean(axis=2)


@dataclass(frozen=True)
class Proof:
    """The lower bounds of all sums that may be spent, and the slack of known sets."""

    # lower bound of the expected MSE for 0, 1, 2, ... measurements, or units of money
    bounds: list[Estimate]
    # the times that reach each bound in the relaxation; they need not reach it themselves
    paths: list[Times]
    budgets: list[int]  # for each known set, the sum whose bound holds for it
    # For each known set, how much its own expected error, by the same estimate on the same draws,
    # lies above the bound of the sum that it spends.
    slack: list[Estimate]


def prove(relaxation: Relaxation, sums: Sums, sets: Sequence[Times], most: int) -> Proof:
    """Compute the lower bounds of all sums up to `most`, and the slack of C known sets.

    The jackknife, which gives the standard errors, leaves one group of draws out.
    """
    relaxed, own = sums.means()
    lowest = least(relaxation, relaxed, most)
    budgets = [relaxation.spent(times) for times in sets]
    return Proof(
        [_jackknifed(bound) for bound in lowest.mse.T],
        lowest.paths,
        budgets,
        [_jackknifed(own[:, i] - lowest.mse[:, budget]) for i, budget in enumerate(budgets)],
    )


def _resampled(sums: Array, draws: Array) -> Array:
    """Means over all groups, then over all groups but each, (1+G, ...); (1, ...) for one group."""
    whole: Array = (sums.sum(axis=0) / draws.sum())[None]
    if len(draws) == 1:
        return whole
    left = (draws.sum() - draws).reshape(-1, *(1,) * (sums.ndim - 1))
    without = (sums.sum(axis=0) - sums) / left
    return np.concatenate([whole, without])


def _jackknifed(values: Array) -> Estimate:
    """Estimate and standard error from the value of all groups and those without one group each."""
    whole, without = float(values[0]), values[1:]
    if not without.size or not math.isfinite(whole):
        return Estimate(whole)
    groups = without.size
    pseudo = groups * whole - (groups - 1) * without
    return Estimate(whole, Estimate.of_mean(pseudo).standard_error, groups - 1)
