"""Estimates of the expected MSE of a set of times, and the difference of two."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pfdist.common.estimate import Estimate
from pfdist.common.measurement_times import Times
from pfdist.common.parts import Facts, Page, Section
from pfdist.common.percent import heavy_tail_warning
from pfdist.common.rounding import unrounded, with_error
from pfdist.common.shown import Shown
from pfdist.filters.criterion import (
    MEAN,
    Criterion,
    CriterionValue,
    Exact,
    Sample,
    unit_of_criterion,
)

if TYPE_CHECKING:
    import pandas as pd

DOUBTFUL = 0.01
"""The share of degenerate draws from which they put an answer in doubt."""


@dataclass(frozen=True, repr=False)
class Evaluation(Shown):
    """One estimate of the expected MSE for one set of measurement times.

    Parameters
    ----------
    measurement_times : tuple of int
        Instants; users see times on the clock.
    mse : array of float64, (D,)
        Per-draw MSE. In a degenerate draw the filter ignores the measurements that no particle
        explains, and the draw counts with the error of this filter.
    degenerate_policy : {"continue", "kill"}
        With ``kill``, as in the paper, a degenerate draw makes the error infinite.
    end : int, optional
        Last instant whose error counts, if it is not T.
    errors : array of float64, (end - since + 1,), optional
        Expected error of each instant, if a search has requested it.
    groups : array of float64, (G, I)
        Mean error in each of G groups of draws at the I instants that count, not weighted, if a
        criterion judges instants; then D is 0.
    purpose : str
        Purpose of the draws, one of `pfdist.common.streams.CHOOSING` or `PROVING`.
    scenarios : array of int64, (D,), optional
        The number of each draw's scenario.
    criterion : Criterion
        Makes `expected_mse` of the errors, by default their mean. It has the exact value if the
        engine computes this without draws; then D is 0.
    degenerate : array of bool, (D,), optional
        Whether each draw is degenerate; by default none is.
    clouds : int
        Number of independent clouds of particles, if filters started from them: equal successive
        parts of the draws have a cloud each. The standard error contains the noise of the clouds.
    profile : DataFrame, optional
        The expected error over time, if `pfdist.evaluate` was asked for it: t, measured, draws,
        error and standard_error.
    few_lines : str
        A sentence if a smoothed estimate is that of few particles.
    also : mapping of str to CriterionValue
        The numbers of further criteria by their names, if `pfdist.evaluate` was asked for them:
        value, and low and high of its 95 % interval.
    sample : Sample, optional
        The results that these criteria judge.
    """

    measurement_times: Times
    mse: NDArray[np.float64]
    degenerate_policy: str = "continue"
    end: int | None = None
    errors: NDArray[np.float64] | None = None
    groups: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 0)))
    purpose: str = "search"
    scenarios: NDArray[np.int64] | None = None
    criterion: Criterion = MEAN
    degenerate: NDArray[np.bool_] | None = None
    clouds: int = 0
    profile: "pd.DataFrame | None" = None
    few_lines: str = ""
    also: Mapping[str, CriterionValue] = field(default_factory=dict)
    sample: Sample | None = None

    @property
    def draws(self) -> int:
        """D, with the degenerate draws."""
        return self.mse.size

    @cached_property
    def degenerate_draws(self) -> int:
        """Number of degenerate draws."""
        return 0 if self.degenerate is None else int(self.degenerate.sum())

    @cached_property
    def estimate(self) -> Estimate:
        """The value of the criterion and its standard error; both are infinite for a killed set."""
        is_killed = self.degenerate_policy == "kill" and self.degenerate_draws
        return Estimate(math.inf, math.inf) if is_killed else self.criterion.value(self)

    @property
    def expected_mse(self) -> float:
        """Mean of the per-draw MSE, or that of the worst scenario; infinite for a killed set."""
        return self.estimate.value

    @property
    def standard_error(self) -> float:
        """Standard error of `expected_mse`; infinite if that is, NaN with fewer than 2 draws."""
        return self.estimate.standard_error

    def difference(self, other: "Evaluation") -> Estimate:
        """`expected_mse` less that of another set, on the draws that both have."""
        if not (math.isfinite(self.expected_mse) and math.isfinite(other.expected_mse)):
            are_equal = self.expected_mse == other.expected_mse
            return Estimate(0.0 if are_equal else self.expected_mse - other.expected_mse)
        draws = min(self.draws, other.draws)
        return self.criterion.difference(self.first(draws), other.first(draws))

    def judged_by(self, criterion: Criterion) -> "Evaluation":
        """The evaluation by another criterion; a value without draws stays."""
        return replace(self, criterion=criterion) if self.draws else self

    @cached_property
    def of_scenarios(self) -> "dict[int, Evaluation]":
        """The evaluation on the draws of each scenario, by its number; empty without scenarios."""
        if self.scenarios is None:
            return {}
        return {
            number: replace(self._of(self.scenarios == number), scenarios=None, criterion=MEAN)
            for number in np.unique(self.scenarios).tolist()
        }

    @cached_property
    def largest_share(self) -> float:
        """Share of `expected_mse` due to the largest 1 % of the draws; NaN with fewer than 100."""
        return largest_share(self._deciding, self._deciding.size, self.expected_mse)

    @property
    def _deciding(self) -> NDArray[np.float64]:
        mse: NDArray[np.float64] = self.mse[self.criterion.deciding(self)]
        return mse

    @classmethod
    def exactly(
        cls, times: Times, value: float, criterion: Criterion = MEAN, **others: Any
    ) -> "Evaluation":
        """The evaluation of a set whose value of the criterion is known without draws."""
        return cls(times, np.empty(0), criterion=criterion.exactly(value), **others)

    @classmethod
    def together(cls, parts: "Sequence[Evaluation]") -> "Evaluation":
        """The evaluation on the draws of several clouds, from that of each; or the only one."""
        if len(parts) == 1:
            return parts[0]
        mse, degenerate = np.array([(each.mse, each.degenerate) for each in parts]).swapaxes(0, 1)
        together = {"mse": mse.ravel(), "degenerate": degenerate.ravel() > 0}
        return replace(parts[0], clouds=len(parts), **together)

    def first(self, draws: int) -> "Evaluation":
        """The evaluation on the first draws."""
        return self if draws == self.draws else self._of(slice(draws))

    def _of(self, chosen: slice | NDArray[np.bool_]) -> "Evaluation":
        return replace(
            self,
            mse=self.mse[chosen],
            scenarios=None if self.scenarios is None else self.scenarios[chosen],
            degenerate=None if self.degenerate is None else self.degenerate[chosen],
            clouds=0,
            profile=None,
            also={},
            sample=None,
        )

    @property
    def errors_of_instants(self) -> NDArray[np.float64]:
        """The array `errors`; raises ValueError if it is missing."""
        if self.errors is None:
            raise ValueError("the errors of each instant were not requested")
        return self.errors

    def _page(self) -> Page:
        mse = with_error(self.expected_mse, self.standard_error)
        count = len(self.measurement_times)
        on = "exact" if isinstance(self.criterion, Exact) else f"on {self.draws:,} draws"
        also = {
            name.replace("_", " "): judged.text(unit_of_criterion(name))
            for name, judged in self.also.items()
        }
        texts = [" ".join(each) for each in (*also.items(), (self.criterion.label, mse))]
        title = f"evaluation of {count} measurement{'s' * (count != 1)}: {', '.join(texts)}, {on}"
        rows = [("measured at t", ", ".join(map(unrounded, self.measurement_times)))]
        rows += also.items()
        if self.degenerate_draws:
            rows.append(("degenerate", self.degenerate_text))
        if warning := self.heavy_tail:
            rows.append(("heavy tail", warning))
        return Page("", title, [Section("", [Facts(rows)])])

    @property
    def heavy_tail(self) -> str:
        """A warning if the interval of `expected_mse` is too short, else nothing."""
        return heavy_tail_warning([self.largest_share])

    @property
    def degenerate_text(self) -> str:
        """A sentence with the number of degenerate draws; empty if there are none."""
        return degenerate_text(self.degenerate_draws, self.draws)

    @property
    def alarm(self) -> str:
        """The same sentence, if so many draws are degenerate that the error is in doubt."""
        return degenerate_text(self.degenerate_draws, self.draws, DOUBTFUL)


def degenerate_text(count: int, draws: int, least: float = 0.0) -> str:
    """A sentence with the number of degenerate draws; empty for none, or less than a share.

    >>> degenerate_text(3, 200)
    '3 of 200 draws are degenerate: the filter leaves out measurements that no particle explains'
    """
    are = "draw is" if draws == 1 else "draws are"
    return (
        f"{count:,} of {draws:,} {are} degenerate: the filter leaves out measurements that no "
        "particle explains"
    ) * (count > 0 and count >= least * draws)


def largest_share(largest: NDArray[np.float64], draws: int, mean: float) -> float:
    """Share of a mean over draws that is due to the 1 % of the draws with the largest values.

    It is a point of the Lorenz curve. It is NaN with fewer than 100 draws, or if the mean is not
    positive and finite. `largest` has at least these values.
    """
    top = np.sort(largest)[::-1][: draws // 100]
    return float(top.sum()) / draws / mean if draws >= 100 and 0 < mean < math.inf else math.nan
