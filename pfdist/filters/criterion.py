"""Criteria: the number that is minimised, with its standard error, from the errors of draws.

A criterion also says which searches can find its least value, and which lower bound it has.
Whatever computes, searches or answers asks the criterion, so a new one is a new form here.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from pfdist.common.estimate import Estimate

if TYPE_CHECKING:
    from pfdist.filters.estimate import Evaluation

Array = NDArray[np.float64]
ChosenDraws = slice | NDArray[np.bool_]


@dataclass(frozen=True)
class Criterion:
    """The expected MSE, which is the mean over all draws; other forms overwrite what differs.

    Parameters
    ----------
    label : str
        How answers call the number.
    additive : bool
        Whether it is a mean over draws of a sum over instants. Then searches may add errors of
        instants, and gains of means are gains of the criterion. Else only searches that compare
        whole sets can minimise it, and exchanges for the mean come first.
    bound : {"mean", "mixture", "none"}
        Its lower bound: that of the mean; that of the mean with the shares of scenarios for which
        it is largest; or none.
    apart : int
        Number of scenarios that are each judged by separate draws.
    """

    label: str = "expected MSE"
    additive: bool = True
    bound: Literal["mean", "mixture", "none"] = "mean"
    apart: int = 1

    def deciding(self, errors: "Evaluation") -> ChosenDraws:
        """The draws whose errors decide."""
        return slice(None)

    def common(self, first: "Evaluation", second: "Evaluation") -> ChosenDraws | None:
        """The draws that decide for both sets; None if other draws decide for each."""
        return slice(None)

    def value(self, errors: "Evaluation") -> Estimate:
        """The number that is minimised; infinite if it is unknown."""
        values = errors.mse[self.deciding(errors)]
        mean = float(np.mean(values)) if values.size else math.nan
        if not math.isfinite(mean):
            return Estimate(math.inf if math.isnan(mean) else mean, math.inf)
        return replace(Estimate.of_mean(values, errors.clouds), value=mean)

    def difference(self, first: "Evaluation", second: "Evaluation") -> Estimate:
        """The value of the first set less that of the second, on the same draws.

        Errors common to both sets cancel in each draw, and with them most of the variance. If other
        draws decide for each set, nothing cancels.
        """
        both = self.common(first, second)
        if both is None:
            return first.estimate.plus(second.estimate.times(-1.0))
        return Estimate.of_mean(first.mse[both] - second.mse[both], first.clouds)

    def shares(self, errors: Array, own: Sequence[float]) -> Array:
        """The share of each scenario in the exact value of each set, (C, S) or (C, 1).

        Parameters
        ----------
        errors : array of float64, (C, S)
            Exact errors of C scenarios.
        own : sequence of float, (C,)
            Shares of the scenarios, whose sum is 1.
        """
        return np.array(own)[:, None]

    def exactly(self, value: float) -> "Exact":
        """The criterion of a set whose value is known."""
        return Exact(self.label, self.additive, self.bound, self.apart, value)


MEAN = Criterion()


@dataclass(frozen=True)
class WorstScenario(Criterion):
    """The largest expected MSE of a scenario."""

    label: str = "expected MSE in the worst scenario"
    additive: bool = False
    bound: Literal["mean", "mixture", "none"] = "mixture"

    def deciding(self, errors: "Evaluation") -> NDArray[np.bool_]:
        """The draws of the worst scenario; one of infinite or unknown errors is the worst."""
        numbers = np.zeros(errors.mse.size) if errors.scenarios is None else errors.scenarios
        each = numbers == np.unique(numbers)[:, None]
        worst: NDArray[np.bool_] = each[np.argmax([np.mean(errors.mse[own]) for own in each])]
        return worst

    def common(self, first: "Evaluation", second: "Evaluation") -> ChosenDraws | None:
        """The draws of the worst scenario, if it is the same for both sets."""
        own, other = self.deciding(first), self.deciding(second)
        return own if np.array_equal(own, other) else None

    def shares(self, errors: Array, own: Sequence[float]) -> Array:
        """1 for the worst scenario of each set, else 0."""
        return np.eye(len(errors))[:, errors.argmax(axis=0)]


@dataclass(frozen=True)
class Exact(Criterion):
    """The value of another criterion, if it is known without draws."""

    error: float = math.nan

    def common(self, first: "Evaluation", second: "Evaluation") -> None:
        """There are no draws."""

    def value(self, errors: "Evaluation") -> Estimate:
        """The exact value."""
        return Estimate(self.error)
