"""The proof: how far the expected MSE of known sets can lie above that of any feasible set.

The bound is the least of many estimated costs. Its expectation is at most the least expected cost,
so it is too low on average, and the gap too large: this is the safe direction.

References
----------
Bayraksan, Morton, "Assessing solution quality in stochastic programs", Mathematical Programming
108, 2006 (the gap of a candidate and the optimum, paired on the same draws). Efron, Tibshirani, "An
introduction to the bootstrap", 1993, chapter 11 (the jackknife).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from pfdist.bounds.programme import least
from pfdist.bounds.relaxation import Relaxation
from pfdist.times.measurement_times import Times

CONFIDENCE = 0.95

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Known:
    """An estimate and its standard error.

    Parameters
    ----------
    value, standard_error : float
        The error is 0 if the value is exact.
    """

    value: float
    standard_error: float = 0.0

    def plus(self, other: "Known") -> "Known":
        """Add an independent estimate."""
        error = math.hypot(self.standard_error, other.standard_error)
        return Known(self.value + other.value, error)

    def at_most(self, degrees: int) -> float:
        """Give the upper end of the one-sided 95 % interval, by Student's t."""
        if self.standard_error == 0.0:
            return self.value
        return self.value + float(stats.t.ppf(CONFIDENCE, degrees)) * self.standard_error


@dataclass(frozen=True)
class Proof:
    """The lower bounds of all numbers of measurements, and the slack of known sets.

    Parameters
    ----------
    bounds : list of Known
        Lower bound of the expected MSE for 0, 1, 2, ... measurements.
    paths : list of tuples of int
        The times that reach each bound in the relaxation; they need not reach it themselves.
    slack : list of Known
        For each known set, how much its own expected error, by the same estimate on the same draws,
        lies above the bound of its number of measurements.
    groups : int
        Number of groups of draws of the jackknife; 0 if everything is exact.
    """

    bounds: list[Known]
    paths: list[Times]
    slack: list[Known]
    groups: int


def prove(
    relaxation: Relaxation, sums: Array, draws: Array, sets: Sequence[Times], most: int
) -> Proof:
    """Compute the lower bounds from errors of the relaxed filter.

    Parameters
    ----------
    relaxation : Relaxation
    sums : array of float64, (G, S+C, T+1)
        For each group of draws, the sums of the errors of each state of the relaxation and then of
        each known set. One group of one draw holds exact errors.
    draws : array of float64, (G,)
        Number of draws of each group. The jackknife leaves one group out.
    sets : sequence of tuples of int, (C,)
        The known sets.
    most : int
        The largest number of measurements.
    """
    groups = len(draws)
    means = (sums.sum(axis=0) / draws.sum())[None]
    if groups > 1:
        without = (sums.sum(axis=0) - sums) / (draws.sum() - draws)[:, None, None]
        means = np.concatenate([means, without])
    states = len(relaxation.states)
    found = least(relaxation, means[:, :states], most)
    own = means[:, states:].mean(axis=2)
    numbers = [len(times) for times in sets]
    return Proof(
        [_jackknifed(bound) for bound in found.mse.T],
        found.paths,
        [_jackknifed(own[:, i] - found.mse[:, number]) for i, number in enumerate(numbers)],
        groups if groups > 1 else 0,
    )


def paired(first: Array, second: Array, draws: Array) -> Known:
    """Give the mean of a difference that is known for groups of draws.

    Parameters
    ----------
    first, second : array of float64, (G,)
        Sums over the draws of each group.
    draws : array of float64, (G,)
    """
    difference = first - second
    mean = difference.sum() / draws.sum()
    without = (difference.sum() - difference) / (draws.sum() - draws)
    return _jackknifed(np.concatenate([[mean], without]))


def _jackknifed(values: Array) -> Known:
    """Estimate and standard error from the value of all groups and those without one group each."""
    whole, without = float(values[0]), values[1:]
    if not without.size or not math.isfinite(whole):
        return Known(whole)
    groups = without.size
    pseudo = groups * whole - (groups - 1) * without
    return Known(whole, float(np.std(pseudo, ddof=1) / math.sqrt(groups)))
