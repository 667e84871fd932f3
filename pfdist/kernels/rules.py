"""A rule that decides at each instant whether to measure, by the spread of a filter's particles."""

from typing import NamedTuple


class Rule(NamedTuple):
    """Measure at t if the predicted standard deviation of z exceeds the level at t.

    The level is threshold * (rest of time / rest of budget)^exponent, in the unit of z. With
    several components of z, the variances are added up.
    """

    threshold: float
    exponent: float = 0.0
    limit: int = 0  # measurements that the rule may spend; 0: there is no limit, nor an exponent

    def level(self, instants: int, spent: int) -> float:
        """The level with so many instants left, this one included, after so many measurements.

        >>> Rule(6.0).level(30, 5), Rule(3.0, 0.5, 21).level(32, 13), Rule(3.0, 0.5, 2).level(9, 2)
        (6.0, 6.0, inf)
        """
        left = self.limit - spent
        if not self.limit:
            return self.threshold
        return self.threshold * (instants / left) ** self.exponent if left > 0 else float("inf")
