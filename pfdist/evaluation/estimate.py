"""An estimate of the expected MSE of one set of times, and what its draws are for."""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from pfdist.common.streams import stream_key
from pfdist.times.measurement_times import Times

DEGENERATE_POLICIES = ("kill", "leave_out")
"""What one degenerate draw does to an evaluation: ``kill``, the paper's, makes its cost infinite;
``leave_out`` takes the mean over the other draws."""


@dataclass(frozen=True)
class Evaluation:
    """One estimate of the expected MSE for one set of measurement times.

    Parameters
    ----------
    measurement_times : tuple of int
    mse : array of float64, (D,)
        Per-draw MSE; NaN for a degenerate draw.
    degenerate_policy : {"kill", "leave_out"}
    exact : float, optional
        The expected MSE where it is known without draws.
    end : int, optional
        Last instant whose errors count, if it is not T.
    """

    measurement_times: Times
    mse: NDArray[np.float64]
    degenerate_policy: str = "kill"
    exact: float | None = None
    end: int | None = None

    @property
    def draws(self) -> int:
        """D, the degenerate draws included."""
        return self.mse.size

    @cached_property
    def degenerate_draws(self) -> int:
        """How many draws are degenerate."""
        return int(np.isnan(self.mse).sum())

    @cached_property
    def expected_mse(self) -> float:
        """Mean of the per-draw MSE; what a degenerate draw makes of it is the policy's."""
        if self.exact is not None:
            return self.exact
        usable = self._usable
        return float(np.mean(usable)) if usable.size else math.inf

    @cached_property
    def standard_error(self) -> float:
        """Standard error of `expected_mse`, infinite where that is or with fewer than 2 draws."""
        if self.exact is not None:
            return 0.0
        usable = self._usable
        if usable.size < 2 or not np.isfinite(usable).all():
            return math.inf
        return float(np.std(usable, ddof=1) / math.sqrt(usable.size))

    @property
    def cost(self) -> float:
        """What a search minimises: `expected_mse`."""
        return self.expected_mse

    @property
    def _usable(self) -> NDArray[np.float64]:
        if self.degenerate_draws and self.degenerate_policy == "kill":
            return np.empty(0)
        return self.mse[~np.isnan(self.mse)]


class SearchEvaluation(Evaluation):
    """On draws that a search chooses by: its cost is never reported as a set's own."""


class ProbeEvaluation(Evaluation):
    """On the draws that decide whether a search may believe its estimator, and on no other."""


class ShortlistEvaluation(Evaluation):
    """On the draws that decide between what searches have found, and on no other."""


class ReportEvaluation(Evaluation):
    """On draws that chose nothing."""


E = TypeVar("E", bound=Evaluation)


@dataclass(frozen=True)
class Purpose(Generic[E]):
    """What draws are for. Different purposes have different keys, so they share no draw.

    Parameters
    ----------
    name : str
    evaluation : type
        Of what is estimated from them: what one purpose needs is not taken for another's.
    """

    name: str
    evaluation: type[E]

    def stream(self, seed: int, *what: Any) -> int:
        """Key of the noise for something under this purpose."""
        return stream_key(seed, self.name, *what)


SEARCH = Purpose("search", SearchEvaluation)
PROBE = Purpose("probe", ProbeEvaluation)
SHORTLIST = Purpose("shortlist", ShortlistEvaluation)
REPORT = Purpose("comparison", ReportEvaluation)
BUDGET = Purpose("budget", ReportEvaluation)
"""What a number of measurements was chosen by is not to prove what comes of it."""
