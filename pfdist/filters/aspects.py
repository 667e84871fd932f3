"""Aspects: results of filtering a draw with a set of times, besides its error.

The comparison loops over the aspects that its criteria want, and so do whatever evaluates sets,
tables, samples and exact engines. None of them knows an aspect by name.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pfdist.kernels.estimators import FILTER_NOISE, FILTER_VARIANCE
from pfdist.kernels.schemes import CONDITIONAL

if TYPE_CHECKING:
    from pfdist.filters.work import Estimation

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
        return f"exact_{self.named}"

    def values(self, errors: Array, control: Array) -> Array:
        """Its values, from estimated errors and their controls."""
        return self.sign * (errors - control if self.is_controlled else errors)


def _beside_truth(own: "Estimation") -> "Estimation":
    return replace(own.another(FILTER_VARIANCE.name, CONDITIONAL.name), proposal=own.proposal)


DISTANCE = Aspect(
    "filter_distance", "half the squared distance of two filters' estimates",
    lambda own: replace(own, estimator=FILTER_NOISE.name), start="distance", knows_truth=False,
)  # fmt: skip
VARIANCE = Aspect(
    "filter_variance", "of particles among which the truth stands, with the true model",
    _beside_truth, start="variance", has_unmeasured=True,
)  # fmt: skip
"""The two estimates of the particle loss; see `pfdist.results.particle_loss`."""


def other_estimate(kind: str) -> Aspect:
    """The MSE of the estimate that the job did not ask for, "smoothed" or "filtered"."""
    text = f"MSE of the {kind} estimate with this set"
    return Aspect("other_estimate", text, lambda own: own, start=kind, knows_truth=False)
