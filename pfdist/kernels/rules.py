"""A rule that decides at each instant which sensors measure, by the spread of the particles."""

from collections.abc import Sequence
from typing import NamedTuple

ROUNDING = 1e-9  # share of the budget by which sums of prices may be rounded


class Rule(NamedTuple):
    """Measure with a sensor at t if the predicted standard deviation of z exceeds its level at t.

    The level is threshold * (rest of time / rest of budget)^exponent, in the unit of z. With
    several components of z, the variances are added up. Without sensors there is one threshold.
    """

    thresholds: tuple[float, ...]  # of each sensor; infinite: it never measures
    exponent: float = 0.0
    limit: float = 0.0  # what the rule may spend; 0: there is no limit, nor an exponent

    def levels(self, instants: int, spent: float) -> list[float]:
        """The level of each sensor with so many instants left, this one included.

        >>> Rule((6.0,)).levels(30, 5), Rule((3.0, 9.0), 0.5, 21).levels(32, 13)
        ([6.0], [6.0, 18.0])
        >>> Rule((3.0,), 0.5, 2).levels(9, 2), Rule((3.0,), 40.0, 0.3).levels(9, 0.1 + 0.1 + 0.1)
        ([inf], [inf])
        """
        left = self.limit - spent
        if not self.limit:
            return [*self.thresholds]
        is_left = left > ROUNDING * self.limit
        factor = (instants / left) ** self.exponent if is_left else float("inf")
        return [threshold * factor for threshold in self.thresholds]

    def chosen(
        self,
        deviation: float,
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
        >>> cheap_and_sharp = Rule((2.0, 5.0))
        >>> [cheap_and_sharp.chosen(d, 9, 0, (1, 4), several=False) for d in (1, 3, 6)]
        [[], [0], [1]]
        """
        levels, chosen = self.levels(instants, spent), list[int]()
        for sensor in self.turns:
            left = (self.limit or float("inf")) * (1 + ROUNDING) - spent
            is_free = several or not chosen
            if is_free and 0 < prices[sensor] <= left and deviation > levels[sensor]:
                chosen.append(sensor)
                spent += prices[sensor]
        return chosen

    @property
    def turns(self) -> list[int]:
        """The sensors, that of the highest threshold first."""
        return sorted(range(len(self.thresholds)), key=lambda sensor: -self.thresholds[sensor])
