"""Criteria: the number that is minimised, with its standard error, from the errors of draws.

A criterion also says which searches can find its least value, which lower bound it has, and its
words. Whatever computes, searches or answers asks the criterion, so a new one is a new file in
`pfdist.filters.criteria`.

Searches compare the `Errors` of sets. Answers have a `Sample` of each set, on fresh draws, and
print its number with a 95 % interval.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, Literal, NamedTuple, Protocol, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from pfdist.common.changes import change_of
from pfdist.common.estimate import CONFIDENCE, Estimate
from pfdist.common.percent import gap_sentence, range_of
from pfdist.common.registry import Registry
from pfdist.common.rounding import with_interval
from pfdist.filters.aspects import Aspect

Array = NDArray[np.float64]
Bound = Literal["mean", "mixture", "submodular", "none"]
ChosenDraws = slice | NDArray[np.bool_]
SIDES = (1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2
_NORMAL = 1.96  # half the width of a 95 % interval, in standard errors


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


class Errors(Protocol):
    """The errors of a set that searches compare; see `pfdist.filters.estimate.Evaluation`."""

    @property
    def mse(self) -> Array: ...  # noqa: D102

    @property
    def groups(self) -> Array: ...  # noqa: D102

    @property
    def scenarios(self) -> NDArray[np.int64] | None: ...  # noqa: D102

    @property
    def clouds(self) -> int: ...  # noqa: D102

    @property
    def estimate(self) -> Estimate: ...  # noqa: D102


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
    aspects : mapping of Aspect to array of float64, (D',)
        Each aspect that a criterion wants, on draws of its own; a single value is exact.
    """

    mse: Array
    errors: Array = field(default_factory=lambda: np.empty(0))
    standard_errors: Array = field(default_factory=lambda: np.empty(0))
    degrees: float = math.inf
    aspects: Mapping[Aspect, Array] = field(default_factory=dict)

    def values_of(self, aspect: Aspect) -> Array:
        """The values of an aspect; none if it is not known."""
        return self.aspects.get(aspect, np.empty(0))


@dataclass(frozen=True)
class Criterion:
    """The expected MSE, which is the mean over all draws; other forms overwrite what differs.

    Parameters
    ----------
    name : str
        As a job and columns of tables call it.
    label : str
        How answers call the number.
    short, meaning : str
        Head of its column in the table of sets, without a unit, and a phrase for the manual.
    unit : str
        The unit of the number; empty for that of errors.
    is_side : bool
        Whether the number is a lower side, which may be far from the upper one.
    most : str
        How a sentence calls the best of several numbers.
    aspects : tuple of Aspect
        Results besides errors that it judges; it minimises the first.
    is_mean : bool
        Whether it is the expected MSE, so that gains of means are gains of the criterion.
    additive : bool
        Whether it is a mean over draws of a sum over instants. Then searches may add errors of
        instants. Else only searches that compare whole sets can minimise it, and exchanges for the
        mean come first.
    bound : {"mean", "mixture", "submodular", "none"}
        Its lower bound: that of the mean; that of the mean with the shares of scenarios for which
        it is largest; that by the gains of single measurements; or none.
    proof : str
        How its bound is proved, for people; empty for that of errors, whose gaps have parts.
    scenario_count : int
        Number of scenarios that are each judged by separate draws.
    sign : int
        The number that is minimised is that of answers times this.
    by_instant : bool
        Whether it judges the expected errors of instants, which searches then ask for.
    needs_draws : bool
        Whether an exact engine has no value of it either.
    of_each_draw : bool
        Whether it judges the MSE of each draw alone, in any order of the draws.
    fewest : int
        Draws from which on its standard error is known well enough for a decision.
    """

    name: str = "expected_mse"
    label: str = "expected MSE"
    short: str = ""
    meaning: str = ""
    unit: str = ""
    is_side: bool = False
    most: str = "lowest"
    aspects: tuple[Aspect, ...] = ()
    is_mean: bool = True
    additive: bool = True
    bound: Bound = "mean"
    proof: str = ""
    scenario_count: int = 1
    sign: int = 1
    by_instant: bool = False
    needs_draws: bool = False
    of_each_draw: bool = True
    fewest: int = 1

    @property
    def mse_criterion(self) -> "Criterion":
        """The criterion by which MSEs alone are judged, if the job has this one."""
        return self

    @property
    def head(self) -> str:
        """The head of its column on pages."""
        return f"{self.label}, {self.unit}" if self.unit else self.label

    @property
    def worsens(self) -> str:
        """The verb for a number of answers that gets worse."""
        return "falls" if self.sign < 0 else "rises"

    def deciding(self, errors: Errors) -> ChosenDraws:
        """The draws whose errors decide."""
        return slice(None)

    def common(self, first: Errors, second: Errors) -> ChosenDraws | None:
        """The draws that decide for both sets; None if other draws decide for each."""
        return slice(None)

    def value(self, errors: Errors) -> Estimate:
        """The number that is minimised; infinite if it is unknown."""
        values = errors.mse[self.deciding(errors)]
        mean = float(np.mean(values)) if values.size else math.nan
        if not math.isfinite(mean):
            return Estimate(math.inf if math.isnan(mean) else mean, math.inf)
        return replace(Estimate.of_mean(values, errors.clouds), value=mean)

    def difference(self, first: Errors, second: Errors) -> Estimate:
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

    def of_instants(self, errors: Array) -> Array:
        """The number of each set, (S,), from exact errors of the instants that count, (S, T)."""
        numbers: Array = errors.mean(axis=1)
        return numbers

    def aim(self, z: str) -> str:
        """The aim, for the end of a question about the quantity z."""
        return f"the lowest {self.label} of {z}"

    def than(self, change: CriterionValue, other: str) -> str:
        """The change from another set to this one, for a sentence."""
        return f"{change_of(change.value, change[1:])} than {other}"

    def sentence(self, value: CriterionValue, change: CriterionValue, reference: str) -> str:
        """A sentence about a set's number and its advantage over the reference.

        Empty if the sentence about errors says it.
        """
        return ""

    def proof_sentence(
        self, gap: Mapping[str, Any], measurements: int, *, has_fewer: bool, **about: bool
    ) -> str:
        """The sentence that says how much better other times can be; see `gap_sentence`."""
        return gap_sentence(gap, measurements, has_fewer=has_fewer, label=self.label, **about)

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
    of_each_draw: bool = False

    def deciding(self, errors: Errors) -> NDArray[np.bool_]:
        """The draws of the worst scenario; one of infinite or unknown errors is the worst."""
        numbers = np.zeros(errors.mse.size) if errors.scenarios is None else errors.scenarios
        each = numbers == np.unique(numbers)[:, None]
        worst: NDArray[np.bool_] = each[np.argmax([np.mean(errors.mse[own]) for own in each])]
        return worst

    def common(self, first: Errors, second: Errors) -> ChosenDraws | None:
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

    def common(self, first: Errors, second: Errors) -> None:
        """There are no draws."""

    def value(self, errors: Errors) -> Estimate:
        """The exact value."""
        return Estimate(self.error)


@dataclass(frozen=True)
class OtherCriterion(Criterion):
    """A criterion other than a mean of errors."""

    is_mean: bool = False
    additive: bool = False
    bound: Bound = "none"
    written: str = ""  # how a job asks for it, if that is not its name

    @classmethod
    def read(cls, written: str) -> Self | None:
        """The criterion that a job asks for by this text; None if it is another one."""
        return cls() if written == cls.name else None

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


CRITERIA: Registry[type[OtherCriterion]] = Registry("pfdist.filters.criteria", "pfdist.criteria")
"""The criteria that a job can name besides the expected MSE."""
F = TypeVar("F", bound=type[OtherCriterion])


def criterion(form: F) -> F:
    """Declare a criterion, a class, under its name."""
    CRITERIA.declare(form.name, form)
    return form


def criteria_in_words() -> str:
    """The criteria that a job may ask for."""
    others = (form.written or form.name for form in CRITERIA.values())
    return ", ".join(map(repr, (MEAN.name, *others)))


def criterion_named(written: str) -> Criterion:
    """The criterion of this name; raises ValueError if there is none."""
    found = (form.read(written) for form in CRITERIA.values())
    known = MEAN if written == MEAN.name else next(filter(None, found), None)
    if known is None:
        raise ValueError(f"a criterion must be one of {criteria_in_words()}, got {written!r}")
    return known


def unit_of_criterion(name: str) -> str:
    """The unit of the criterion of this name; empty for that of errors."""
    return CRITERIA[name].unit if name in CRITERIA else ""


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
