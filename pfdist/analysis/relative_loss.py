"""The relative loss of a changed set of times against the kept set, on the same draws."""

import math
from dataclasses import dataclass, field

import numpy as np

from pfdist.analysis.streaming_moments import Array, Pairs
from pfdist.common.estimate import CONFIDENCE, UNKNOWN, Interval

INSIDE, OPEN, OUTSIDE = "inside", "open", "outside"
"""States of a loss against a level: at most the level, undecided, and above the level."""
_TWO_SIDED = 2 * CONFIDENCE - 1  # its ends are one-sided limits of the confidence


@dataclass
class RelativeLoss:
    """Mean rise of the MSE over the mean MSE of the kept set, on the pairs of errors added so far.

    Draws that are degenerate with either set are left out.

    Parameters
    ----------
    pairs : Pairs
        Moments of the rise of the MSE (x) and the MSE of the kept set (y).
    degenerate_draws, kept_degenerate_draws : int
        Number of draws that are degenerate with the changed set, and with the kept set.
    """

    pairs: Pairs = field(default_factory=Pairs)
    degenerate_draws: int = 0
    kept_degenerate_draws: int = 0

    def add(self, changed_mse: Array, kept_mse: Array) -> None:
        """Add a block of draws; the same blocks in the same order give the same bits.

        Parameters
        ----------
        changed_mse, kept_mse : array of float64, (D,)
            Per-draw MSE of both sets on the same draws; NaN marks a degenerate draw.
        """
        degenerate, kept_degenerate = np.isnan(changed_mse), np.isnan(kept_mse)
        self.degenerate_draws += int(degenerate.sum())
        self.kept_degenerate_draws += int(kept_degenerate.sum())
        usable = ~(degenerate | kept_degenerate)
        with np.errstate(invalid="ignore"):  # infinite errors have no difference
            rise = changed_mse[usable] - kept_mse[usable]
        self.pairs.add(rise, kept_mse[usable])

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
        """Whether the loss is at most a level, by its one-sided limits.

        A loss is never inside if more draws are degenerate with the changed set than with the kept
        set: the errors of these draws are unknown.
        """
        low, high = self.limits
        if high <= level and self.degenerate_draws <= self.kept_degenerate_draws:
            return INSIDE
        return OUTSIDE if low > level else OPEN

    @property
    def _is_known(self) -> bool:
        rise, kept_mse = self.pairs.x, self.pairs.y
        moments = (rise.mean, rise.squares, kept_mse.mean, kept_mse.squares)
        return all(map(math.isfinite, moments)) and kept_mse.mean > 0.0
