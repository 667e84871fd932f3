"""Rules: at each instant, the spread of the particles decides which sensors measure."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

ROUNDING = 1e-9  # share of the budget by which sums of prices may be rounded
ALWAYS, NEVER = -1.0, float("inf")
"""Thresholds with which each draw is measured, even if its particles agree; and none."""


class Rule(NamedTuple):
    """Measure at a point if the predicted standard deviation of z exceeds its level there.

    The level is threshold * (rest of time / rest of budget)^exponent, in the unit of z. With
    several components of z, the variances are added up. So a set of times is a rule, too: with it,
    each draw is measured always at some points, and never at the others.
    """

    # of each point, or of each sensor at all instants; below 0: it always measures
    thresholds: tuple[float, ...]
    exponent: float = 0.0
    limit: float = 0.0  # what the rule may spend; 0: there is no limit, nor an exponent

    def thresholds_of(self, points: ArrayLike) -> NDArray[np.float64]:
        """The thresholds of some points.

        >>> Rule((2.0, 5.0)).thresholds_of(range(3)).tolist()
        [2.0, 5.0, 2.0]
        """
        return np.array(self.thresholds, np.float64)[np.array(points) % len(self.thresholds)]

    def levels(self, points: Iterable[int], instants: int, spent: float) -> list[float]:
        """The levels of an instant's points with so many instants left, this one included.

        >>> Rule((6.0,)).levels([31], 30, 5), Rule((3.0, 9.0), 0.5, 21).levels((58, 59), 32, 13)
        ([6.0], [6.0, 18.0])
        >>> Rule((3.0,), 0.5, 2).levels([1], 9, 2), Rule((ALWAYS,), 0.5, 2).levels([1], 8, 0)
        ([inf], [-2.0])
        """
        thresholds, left = self.thresholds_of([*points]).tolist(), self.limit - spent
        if not self.limit:
            return thresholds
        if not left > ROUNDING * self.limit:
            return [NEVER] * len(thresholds)
        return [threshold * (instants / left) ** self.exponent for threshold in thresholds]

    def chosen(
        self,
        deviation: float,
        points: Sequence[int],
        instants: int,
        spent: float,
        prices: Sequence[float],
        *,
        several: bool,
    ) -> list[int]:
        """The sensors that measure at an instant, from the highest threshold to the lowest.

        Parameters
        ----------
        deviation : float
            The predicted standard deviation of z.
        points : sequence of int
            Those of the instant: one of each sensor.
        instants : int
            Those that are left, this one included.
        spent : float
            Money, or number of measurements, before this instant.
        prices : sequence of float
            The price of each sensor at this instant; 0 if it may not measure.
        several : bool
            Whether several sensors may measure at an instant.

        Examples
        --------
        >>> cheap_and_sharp, at = Rule((2.0, 5.0)), (0, 1)
        >>> [cheap_and_sharp.chosen(d, at, 9, 0, (1, 4), several=False) for d in (1, 3, 6)]
        [[], [0], [1]]
        """
        levels, chosen = self.levels(points, instants, spent), list[int]()
        for sensor in sorted(range(len(levels)), key=lambda sensor: -levels[sensor]):
            left = (self.limit or NEVER) * (1 + ROUNDING) - spent
            is_free = several or not chosen
            if is_free and 0 < prices[sensor] <= left and deviation > levels[sensor]:
                chosen.append(sensor)
                spent += prices[sensor]
        return chosen

    def scaled(self, factor: float) -> "Rule":
        """The rule whose thresholds are so many times as high; "always" remains "always"."""
        thresholds = (float(f"{c * factor:.4g}") if c > 0 else c for c in self.thresholds)
        return self._replace(thresholds=tuple(thresholds))
