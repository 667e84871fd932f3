"""Aspects: results of filtering a draw with a set of times, besides its error.

The comparison loops over the aspects that its criteria want, and so do whatever evaluates sets,
tables, samples and exact engines. None of them knows an aspect by name.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from pfdist.common.estimate import Estimate
from pfdist.common.measurement_times import Lag
from pfdist.kernels.estimators import FILTER_NOISE, FILTER_VARIANCE
from pfdist.kernels.schemes import CONDITIONAL

if TYPE_CHECKING:  # tables are read without Numba
    from pfdist.filters.work import Estimation, FilterWork

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Aspect:
    """A result of filtering a draw with a set: a table of the comparison, a column a set.

    Parameters
    ----------
    table : str
        Name of the table of its draws.
    description : str
        Its meaning, a phrase.
    estimation : callable
        Its need of the filter: an estimation, from that of the comparison.
    start : str
        Beginning of its columns; by default the name of the table.
    exact : str
        The column of the table ``compared`` that has its exact values; by default ``exact_`` and
        the beginning of its columns.
    unit : str
        Its unit; by default that of errors.
    sign : float
        The result is the estimated error times this.
    of_all_draws : bool
        Whether it is wanted of all draws of the comparison, not of the first alone.
    is_controlled : bool
        Whether the control variate of the estimated error is subtracted.
    knows_truth : bool
        Whether the filter has the true model.
    has_unmeasured : bool
        Whether there is a last column ``unmeasured``, without any measurement.
    """

    table: str
    description: str
    estimation: Callable[["Estimation"], "Estimation"]
    start: str = ""
    exact: str = ""
    unit: str = ""
    sign: float = 1.0
    of_all_draws: bool = False
    is_controlled: bool = False
    knows_truth: bool = True
    has_unmeasured: bool = False

    @property
    def named(self) -> str:
        """Beginning of its columns."""
        return self.start or self.table

    @property
    def exact_column(self) -> str:
        """The column of the table ``compared`` that has its exact values."""
        return self.exact or f"exact_{self.named}"

    def work(self, errors: "FilterWork", draws: int) -> "FilterWork":
        """The work that gives it on the first draws, from that of the errors."""
        return replace(
            errors,
            draws=(0, draws),
            over_time=0,
            estimation=self.estimation(errors.estimation),
            knows_truth=self.knows_truth,
            controlled=self.is_controlled,
        )

    def values(self, errors: Array, control: Array) -> Array:
        """Its values, from estimated errors and their controls."""
        return self.sign * (errors - control if self.is_controlled else errors)


class FilterTraits(Protocol):
    """Properties of `pfdist.filters.evaluator.Evaluator` on which another error depends."""

    @property
    def has_particle_loss(self) -> bool: ...  # noqa: D102

    @property
    def variance_is_error(self) -> bool: ...  # noqa: D102


@dataclass(frozen=True, kw_only=True)
class ErrorBeside(Aspect):
    """Another error of a set, which answers show beside that of the job, from fewer draws.

    The job's criterion of MSEs makes a number of it. Declared ones are in `pfdist.filters.beside`.

    Parameters
    ----------
    fits : callable
        Whether a job shows it, from the lag of its estimate.
    is_smoothed : bool
        Whether it is that of the estimate from all measurements, else that at the moment.
    settings : callable
        Its estimation, from the evaluator and the estimation of the job.
    head : str
        Head of its column, without an error.
    meaning : str
        A phrase for the manual.
    is_raised : bool
        Whether few particles raise it, so it is an upper limit where their loss is unknown.
    when : str
        How answers call it, at the beginning of a sentence.
    planned : str
        A sentence that says how to plan for it, after one that begins with `alone`; or empty.
    """

    estimation: Callable[["Estimation"], "Estimation"] = lambda own: own
    knows_truth: bool = False
    fits: Callable[[Lag], bool]
    is_smoothed: bool = False
    settings: Callable[[FilterTraits, "Estimation"], "Estimation"] = lambda _, own: own
    head: str
    meaning: str
    is_raised: bool = False
    when: str
    alone: str = ""
    planned: str = ""

    @property
    def mse(self) -> str:
        """Its column in the table of sets."""
        return f"{self.named}_mse"

    @property
    def error(self) -> str:
        """The column of its standard error."""
        return f"{self.named}_error"

    def columns(self, estimate: Estimate) -> dict[str, float]:
        """Its columns of a set."""
        return {self.mse: estimate.value, self.error: estimate.standard_error}

    def head_of(self, *, is_limit: bool = False) -> str:
        """The head of its column, which says whether it is an upper limit."""
        return f"{self.head}{', at most' * is_limit} ± standard error"

    def beside(self, evaluator: FilterTraits, errors: "FilterWork", draws: int) -> "FilterWork":
        """The work that gives it on the first draws, from that of an evaluator's errors."""
        estimation = self.settings(evaluator, errors.estimation)
        return replace(self.work(errors, draws), beside=self.named, estimation=estimation)


def _beside_truth(own: "Estimation") -> "Estimation":
    return own.with_truth(CONDITIONAL.name, FILTER_VARIANCE.name)


DISTANCE = Aspect(
    "filter_distance", "half the squared distance of two filters' estimates",
    lambda own: replace(own, estimator=FILTER_NOISE.name), start="distance", knows_truth=False,
)  # fmt: skip
VARIANCE = Aspect(
    "filter_variance", "of particles among which the truth stands, with the true model",
    _beside_truth, start="variance", has_unmeasured=True,
)  # fmt: skip
"""The two estimates of the particle loss; see `pfdist.results.particle_loss`."""
