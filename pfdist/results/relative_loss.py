"""The relative loss of a changed set of times against the kept set, on the same draws."""

import math
from dataclasses import dataclass, field

import numpy as np

from pfdist.common.estimate import CONFIDENCE, UNKNOWN, Interval
from pfdist.results.streaming_moments import Array, Pairs

INSIDE, OPEN, OUTSIDE = "inside", "open", "outside"
"""States of a loss against a level: at most the level, undecided, and above the level."""
_TWO_SIDED = 2 * CONFIDENCE - 1  # its ends are one-sided limits of the confidence


@dataclass
class RelativeLoss:
    """Mean rise of the MSE over the mean MSE of the kept set, on the pairs of errors added so far.

    Parameters
    ----------
    pairs : Pairs
        Moments of the rise of the MSE (x) and the MSE of the kept set (y).
    """

    pairs: Pairs = field(default_factory=Pairs)

    def add(self, changed_mse: Array, kept_mse: Array) -> None:
        """Add a block of draws; the same blocks in the same order give the same bits.

        Parameters
        ----------
        changed_mse, kept_mse : array of float64, (D,)
            Per-draw MSE of both sets on the same draws.
        """
        with np.errstate(invalid="ignore"):  # infinite errors have no difference
            self.pairs.add(changed_mse - kept_mse, kept_mse)

    @property
    def mean(self) -> float:
        """The loss; NaN if an error is infinite, or if the mean error is not above 0."""
        return self.pairs.x.mean / self.pairs.y.mean if self._is_known else math.nan

    @property
    def standard_error(self) -> float:
        """Standard error of the loss, by the delta method."""
        return self.pairs.ratio_error if self._is_known else math.nan

    @property
    def limits(self) -> Interval:
        """One-sided 95 % lower limit and one-sided 95 % upper limit, Fieller's."""
        return self.pairs.ratio_interval(_TWO_SIDED) if self._is_known else UNKNOWN

    @property
    def interval(self) -> Interval:
        """95 % interval, Fieller's."""
        return self.pairs.ratio_interval() if self._is_known else UNKNOWN

    def state(self, level: float) -> str:
        """Whether the loss is at most a level, by its one-sided limits."""
        low, high = self.limits
        if high <= level:
            return INSIDE
        return OUTSIDE if low > level else OPEN

    @property
    def _is_known(self) -> bool:
        rise, kept_mse = self.pairs.x, self.pairs.y
        moments = (rise.mean, rise.squares, kept_mse.mean, kept_mse.squares)
        return all(map(math.isfinite, moments)) and kept_mse.mean > 0.0
