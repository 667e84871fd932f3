"""The largest expected error over the instants that count."""

import math
from dataclasses import dataclass

import numpy as np

from pfdist.common.estimate import CONFIDENCE, UNKNOWN, Estimate, student_quantile
from pfdist.filters.criterion import (
    Array,
    Bound,
    CriterionValue,
    Errors,
    OtherCriterion,
    Sample,
    criterion,
)


@criterion
@dataclass(frozen=True)
class WorstInstant(OtherCriterion):
    """The largest expected error over the instants that count."""

    name: str = "worst_instant"
    label: str = "expected error at the worst instant"
    short: str = "worst instant"
    meaning: str = (
        "largest expected error at an instant; from limits that hold together at all instants"
    )
    bound: Bound = "mixture"
    by_instant: bool = True
    of_each_draw: bool = False
    fewest: int = 240  # ten groups of a block of draws

    def value(self, errors: Errors) -> Estimate:
        """The largest error, with its standard error at that instant."""
        groups = errors.groups
        if not (groups.size and np.isfinite(groups).all()):
            return Estimate(math.inf, math.inf)
        return Estimate.of_mean(groups[:, groups.mean(axis=0).argmax()])

    def difference(self, first: Errors, second: Errors) -> Estimate:
        """The difference of the largest errors of two sets, by the jackknife over groups."""
        both = np.stack([first.groups, second.groups])
        count, total = both.shape[1], both.sum(axis=1, keepdims=True)
        value, other = total.max(axis=2)[:, 0] / count
        if count == 1:
            return Estimate(float(value - other), math.nan)
        differences = -np.diff(((total - both) / (count - 1)).max(axis=2), axis=0)[0]
        error = math.sqrt((count - 1) * np.var(differences))
        return Estimate(float(value - other), error, count - 1)

    def of_instants(self, errors: Array) -> Array:
        """The largest error of each set."""
        numbers: Array = errors.max(axis=1)
        return numbers

    def of_sample(self, sample: Sample) -> CriterionValue:
        """The largest error, between the largest lower and the largest upper limit."""
        return self._between(sample, sample.errors.size)

    def change(self, sample: Sample, other: Sample) -> CriterionValue:
        """The share by which a set's largest error is lower, from limits that hold together.

        No error is below 0, even if a limit is.
        """
        limits = sample.errors.size + other.errors.size
        value, low, high = self._between(sample, limits)
        of_other, least, most = self._between(other, limits)
        with np.errstate(divide="ignore", invalid="ignore"):
            ratios = np.divide([value, high, max(low, 0.0)], [of_other, max(least, 0.0), most])
        return CriterionValue(*(1 - ratios).tolist())

    def _between(self, sample: Sample, limits: int) -> CriterionValue:
        if not sample.errors.size:
            return CriterionValue(math.nan, *UNKNOWN)
        half = sample.standard_errors  # of the interval's width
        if half.any():
            share = (1 - CONFIDENCE) / 2 / limits  # Bonferroni
            half = -student_quantile(share, sample.degrees) * half
        ends = sample.errors, sample.errors - half, sample.errors + half
        return CriterionValue(*(float(each.max()) for each in ends))
