"""Criteria: the number that is minimised, with its standard error, from the errors of draws.

A criterion also says which searches can find its least value, and which lower bound it has.
Whatever computes, searches or answers asks the criterion, so a new one is a new form here.

Searches compare `Evaluation`s. Answers have a `Sample` of each set, on fresh draws, and print its
number with a 95 % interval.

References
----------
David, Nagaraja, "Order statistics", 3rd edition, 2003, section 7.1 (intervals of quantiles).
Grosse, Ancha, Roy, "Measuring the reliability of MCMC inference with bidirectional Monte Carlo",
NeurIPS 2016 (both sides of an evidence).
"""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.common.estimate import CONFIDENCE, UNKNOWN, Estimate, student_quantile
from pfdist.common.percent import range_of
from pfdist.common.rounding import with_interval, with_sides

if TYPE_CHECKING:
    from pfdist.filters.estimate import Evaluation

Array = NDArray[np.float64]
Bound = Literal["mean", "mixture", "submodular", "none"]
ChosenDraws = slice | NDArray[np.bool_]


class CriterionValue(NamedTuple):
    """A number, and the ends of its 95 % interval."""

    value: float
    low: float
    high: float

    @property
    def standard_error(self) -> float:
        """That of a normal variate with the same interval."""
        return (self.high - self.low) / (2 * _NORMAL)

    def text(self, unit: str = "") -> str:
        """The number with its unit and interval."""
        text, *ends = with_interval(*self)
        about = "exact" if self.low == self.high else f"95 % CI {range_of(*ends)}"
        return f"{text} {unit}".rstrip() + f" ({about})"

    def columns(self, name: str) -> dict[str, float]:
        """The number and the ends as columns of a table."""
        return {name: self.value, f"{name}_low": self.low, f"{name}_high": self.high}


class Sides(CriterionValue):
    """A lower side, from the lower end of its interval to the upper end of an upper side."""

    __slots__ = ()

    def text(self, unit: str = "") -> str:
        """The number with its unit and interval; if the upper side is far away, both as limits."""
        limits = with_sides(*self, unit)
        return f"{limits}; more particles bring both closer" if limits else super().text(unit)


@dataclass(frozen=True)
class Sample:
    """Results of fresh draws with a set of times; those that no criterion wants are empty.

    Parameters
    ----------
    mse : array of float64, (D,)
    errors, standard_errors : array of float64, (T,)
        Expected error at each instant that counts; 0 as standard error: exact.
    degrees : float
        Degrees of freedom of the standard errors.
    information : array of float64, (D,)
        Nats that the measurements of each draw give, whose mean is at most the true one.
    gap : array of float64, (D',)
        The nats to add for a mean that is at least the true one, on other draws.
    """

    mse: Array
    errors: Array = field(default_factory=lambda: np.empty(0))
    standard_errors: Array = field(default_factory=lambda: np.empty(0))
    degrees: float = math.inf
    information: Array = field(default_factory=lambda: np.empty(0))
    gap: Array = field(default_factory=lambda: np.zeros(1))


@dataclass(frozen=True)
class Criterion:
    """The expected MSE, which is the mean over all draws; other forms overwrite what differs.

    Parameters
    ----------
    name : str
        As a job and columns of tables call it.
    label : str
        How answers call the number.
    is_mean : bool
        Whether it is the expected MSE, so that gains of means are gains of the criterion.
    additive : bool
        Whether it is a mean over draws of a sum over instants. Then searches may add errors of
        instants. Else only searches that compare whole sets can minimise it, and exchanges for the
        mean come first.
    bound : {"mean", "mixture", "submodular", "none"}
        Its lower bound: that of the mean; that of the mean with the shares of scenarios for which
        it is largest; that by the gains of single measurements; or none.
    scenario_count : int
        Number of scenarios that are each judged by separate draws.
    sign : int
        The number that is minimised is that of answers times this.
    by_instant : bool
        Whether it judges the expected errors of instants, which searches then ask for.
    needs_draws : bool
        Whether an exact engine has no value of it either.
    fewest : int
        Draws from which on its standard error is known well enough for a decision.
    """

    name: str = "expected_mse"
    label: str = "expected MSE"
    is_mean: bool = True
    additive: bool = True
    bound: Bound = "mean"
    scenario_count: int = 1
    sign: int = 1
    by_instant: bool = False
    needs_draws: bool = False
    fewest: int = 1

    @property
    def mse_criterion(self) -> "Criterion":
        """The criterion by which MSEs alone are judged, if the job has this one."""
        return self

    @property
    def unit(self) -> str:
        """The unit of the number; empty for that of errors."""
        return ""

    @property
    def head(self) -> str:
        """The head of its column on pages."""
        return f"{self.label}, {self.unit}" if self.unit else self.label

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

    def shares(self, errors: Array, given: Sequence[float]) -> Array:
        """The share of each scenario in the exact value of each set, (C, S) or (C, 1).

        Parameters
        ----------
        errors : array of float64, (C, S)
            Exact errors of C scenarios.
        given : sequence of float, (C,)
            Shares of the scenarios, whose sum is 1.
        """
        return np.array(given)[:, None]

    def exactly(self, value: float) -> "Exact":
        """The criterion of a set whose value is known."""
        return Exact(**{each.name: getattr(self, each.name) for each in fields(MEAN)}, error=value)


MEAN = Criterion()


@dataclass(frozen=True)
class WorstScenario(Criterion):
    """The largest expected MSE of a scenario."""

    name: str = "worst_scenario"
    label: str = "expected MSE in the worst scenario"
    is_mean: bool = False
    additive: bool = False
    bound: Bound = "mixture"

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

    def shares(self, errors: Array, given: Sequence[float]) -> Array:
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


@dataclass(frozen=True)
class OtherCriterion(Criterion):
    """A criterion other than a mean of errors."""

    is_mean: bool = False
    additive: bool = False
    bound: Bound = "none"

    @property
    def mse_criterion(self) -> Criterion:
        """The expected MSE."""
        return MEAN

    def of_sample(self, sample: Sample) -> CriterionValue:
        """The number of a set."""
        raise NotImplementedError

    def change(self, sample: Sample, other: Sample) -> CriterionValue:
        """The share by which a set's number is lower than another's."""
        raise NotImplementedError


@dataclass(frozen=True)
class Quantile(OtherCriterion):
    """A quantile over the draws of the MSE: that of the bad draws."""

    needs_draws: bool = True
    share: float = 0.9

    def value(self, errors: "Evaluation") -> Estimate:
        """The quantile; its standard error is that of a normal variate with the same interval."""
        found = self.of_sample(Sample(errors.mse))
        if not math.isfinite(found.value):
            return Estimate(math.inf, math.inf)
        return Estimate(found.value, found.standard_error)

    def difference(self, first: "Evaluation", second: "Evaluation") -> Estimate:
        """The difference of two quantiles on the same draws, by a paired bootstrap."""
        both = np.stack([first.mse, second.mse])
        apart = -np.diff(self._again(both, _FEW_RESAMPLES), axis=0)[0]
        value, other = self._values(both)
        return Estimate(float(value - other), float(np.std(apart, ddof=1)))

    def of_sample(self, sample: Sample) -> CriterionValue:
        """The quantile, and an interval from two order statistics for any distribution."""
        from scipy.stats import binom  # noqa: PLC0415  workers need no intervals

        count = sample.mse.size
        if not count:
            return CriterionValue(math.nan, *UNKNOWN)
        low, high = (int(binom.ppf(side, count, self.share)) for side in _SIDES)
        ordered = np.concatenate([[0.0], np.sort(sample.mse), [math.inf]])
        (value,) = self._values(sample.mse[None])
        return CriterionValue(
            float(value), float(ordered[low]), float(ordered[min(high, count) + 1])
        )

    def change(self, sample: Sample, other: Sample) -> CriterionValue:
        """The share by which a set's quantile is lower than another's, by a paired bootstrap."""
        both = np.stack([sample.mse, other.mse])
        value, of_other = self._values(both)
        again, of_other_again = self._again(both, _RESAMPLES)
        with np.errstate(divide="ignore", invalid="ignore"):
            changes = 1 - again / of_other_again
            return CriterionValue(
                float(1 - value / of_other), *np.quantile(changes, _SIDES).tolist()
            )

    def _values(self, mse: Array) -> Array:
        """The quantile of each set, (S,), of errors (S, D)."""
        rank = max(0, math.ceil(self.share * mse.shape[1]) - 1)
        values: Array = np.partition(mse, rank, axis=1)[:, rank]
        return values

    def _again(self, mse: Array, resamples: int) -> Array:
        """The quantiles of resampled draws, the same for all sets, (S, resamples)."""
        count, again = mse.shape[1], np.empty((len(mse), resamples))
        rank = max(0, math.ceil(self.share * count) - 1)
        # No resample has its quantile before this one of the ordered draws.
        first = max(0, rank - _SPREADS * math.isqrt(count))
        orders = np.argsort(mse, axis=1)[:, first:]
        for k, times in enumerate(_resampled(resamples, count)):
            for s, order in enumerate(orders):
                number = np.cumsum(times[order], dtype=np.int64)
                place = np.searchsorted(number, rank - (count - number[-1]), "right")
                again[s, k] = mse[s, order[place]]
        return again


def _resampled(resamples: int, count: int) -> Iterable[NDArray[np.uint8]]:
    """How often each draw comes in each resample; a search asks for the same ones very often."""
    if resamples * count <= _KEPT:
        return _kept_resamples(resamples, count)
    rng = np.random.default_rng(0)
    return (_times(rng, count) for _ in range(resamples))


@lru_cache(maxsize=2)
def _kept_resamples(resamples: int, count: int) -> NDArray[np.uint8]:
    rng = np.random.default_rng(0)
    return np.stack([_times(rng, count) for _ in range(resamples)])


def _times(rng: np.random.Generator, count: int) -> NDArray[np.uint8]:
    return np.bincount(rng.integers(0, count, count), minlength=count).astype(np.uint8)


_KEPT = 50_000_000  # bytes of resamples
_SPREADS = 6  # the number of a resample's draws up to a quantile varies by sqrt(count) / 2
_SIDES = (1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2
_RESAMPLES, _FEW_RESAMPLES = 500, 100  # of a bootstrap, for an answer and in a search
_NORMAL = 1.96  # half the width of a 95 % interval, in standard errors
_IN_TAIL = 20  # draws beyond a quantile, or before it, from which on its standard error is known


@dataclass(frozen=True)
class WorstInstant(OtherCriterion):
    """The largest expected error over the instants that count."""

    name: str = "worst_instant"
    label: str = "expected error at the worst instant"
    by_instant: bool = True
    fewest: int = 240  # ten groups of a block of draws

    def value(self, errors: "Evaluation") -> Estimate:
        """The largest error, with its standard error at that instant."""
        groups = errors.groups
        if not (groups.size and np.isfinite(groups).all()):
            return Estimate(math.inf, math.inf)
        return Estimate.of_mean(groups[:, groups.mean(axis=0).argmax()])

    def difference(self, first: "Evaluation", second: "Evaluation") -> Estimate:
        """The difference of the largest errors of two sets, by the jackknife over groups."""
        both = np.stack([first.groups, second.groups])
        count, total = both.shape[1], both.sum(axis=1, keepdims=True)
        value, other = total.max(axis=2)[:, 0] / count
        if count == 1:
            return Estimate(float(value - other), math.nan)
        apart = -np.diff(((total - both) / (count - 1)).max(axis=2), axis=0)[0]
        error = math.sqrt((count - 1) * np.var(apart))
        return Estimate(float(value - other), error, count - 1)

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
        apart = sample.standard_errors
        if apart.any():
            share = (1 - CONFIDENCE) / 2 / limits  # Bonferroni
            apart = -student_quantile(share, sample.degrees) * apart
        ends = sample.errors, sample.errors - apart, sample.errors + apart
        return CriterionValue(*(float(each.max()) for each in ends))


@dataclass(frozen=True)
class Information(OtherCriterion):
    """The expected information of the measurements about the path, and what is learned, in nats.

    The number that is minimised is its negative.
    """

    name: str = "information"
    label: str = "information"
    additive: bool = True
    bound: Bound = "submodular"
    sign: int = -1

    @property
    def unit(self) -> str:
        """The unit of a natural logarithm."""
        return "nats"

    def of_sample(self, sample: Sample) -> CriterionValue:
        """The lower side, from the lower end of its interval to the upper end of the upper side."""
        below = Estimate.of_mean(sample.information)
        return Sides(*self._between(below, below, _and_mean(sample.information, sample.gap)))

    def change(self, sample: Sample, other: Sample) -> CriterionValue:
        """The nats that a set gives more than another."""
        more = sample.information - other.information
        low, high = _and_mean(more, -other.gap), _and_mean(more, sample.gap)
        return self._between(Estimate.of_mean(more), low, high)

    @staticmethod
    def _between(value: Estimate, below: Estimate, above: Estimate) -> CriterionValue:
        if value.degrees == math.inf:  # exact: a single draw
            return CriterionValue(value.value, value.value, value.value)
        low, high = (
            each.interval()[place] if math.isfinite(each.value) else each.value
            for place, each in enumerate((below, above))
        )
        return CriterionValue(value.value, low, high)


def _and_mean(values: Array, others: Array) -> Estimate:
    """The sum of two means, if the other one may be that of the first draws alone."""
    if others.size == values.size:
        return Estimate.of_mean(values + others)
    return Estimate.of_mean(values).plus(Estimate.of_mean(others))


_NAMED: dict[str, Criterion] = {e.name: e for e in (MEAN, WorstInstant(), Information())}
_SHARE = re.compile(r"quantile ?(0?\.\d{1,6})")
CRITERIA = f"{', '.join(map(repr, _NAMED))} or a quantile, as 'quantile 0.9'"
"""What a job may ask for, in words."""


def criterion_named(written: str) -> Criterion:
    """The criterion of this name; raises ValueError if there is none."""
    if written in _NAMED:
        return _NAMED[written]
    found = _SHARE.fullmatch(written)
    if found and 0 < (share := float(found[1])) < 1:
        fewest = round(_IN_TAIL / min(share, 1 - share))
        label = f"{100 * share:g} % quantile of the MSE"
        return Quantile("quantile", label, fewest=fewest, share=share)
    raise ValueError(f"a criterion must be {CRITERIA}, got {written!r}")


def unit_of_criterion(name: str) -> str:
    """The unit of the criterion of this name; empty for that of errors."""
    return _NAMED.get(name, MEAN).unit


def other_criteria_of(
    criterion: str | None, also: Sequence[str] | None
) -> dict[str, OtherCriterion]:
    """The criteria of these written names but the expected MSE, by their own names.

    Raises ValueError if two of them have one name.
    """
    written = [*([criterion] if criterion else []), *(also or ())]
    named = {criterion_named(each) for each in written}
    found = [each for each in named if isinstance(each, OtherCriterion)]
    if len({each.name for each in found}) < len(found):
        raise ValueError(f"one run has one quantile, got {', '.join(map(repr, written))}")
    return {each.name: each for each in sorted(found, key=lambda each: each.name)}
