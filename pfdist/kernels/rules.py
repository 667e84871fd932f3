"""Rules: at each instant, the spread of the particles decides which sensors measure."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfdist.kernels.follows import ROUNDING, UNLIMITED, Follows, StepLimits
from pfdist.kernels.left import Left

ALWAYS, NEVER = -1.0, float("inf")
"""Thresholds with which each draw is measured, even if its particles agree; and none."""


class Thresholds(NamedTuple):
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

        >>> Thresholds((2.0, 5.0)).thresholds_of(range(3)).tolist()
        [2.0, 5.0, 2.0]
        """
        return np.array(self.thresholds, np.float64)[np.array(points) % len(self.thresholds)]

    def levels(self, points: Iterable[int], instants: int, spent: float) -> list[float]:
        """The levels of an instant's points with so many instants left, this one included.

        >>> Thresholds((6.0,)).levels([31], 30, 5)
        [6.0]
        >>> Thresholds((3.0, 9.0), 0.5, 21).levels((58, 59), 32, 13)
        [6.0, 18.0]
        >>> Thresholds((3.0,), 0.5, 2).levels([1], 9, 2)
        [inf]
        >>> Thresholds((ALWAYS,), 0.5, 2).levels([1], 8, 0)
        [-2.0]
        """
        thresholds, left = self.thresholds_of([*points]).tolist(), self.limit - spent
        if not self.limit:
            return thresholds
        if not left > ROUNDING * self.limit:
            return [NEVER] * len(thresholds)
        return [threshold * (instants / left) ** self.exponent for threshold in thresholds]

    def chosen(self, deviation: float, t: int, left: Left) -> list[int]:
        """The points that are measured at an instant, from the highest threshold to the lowest.

        The predicted standard deviation of z decides, and what may follow what was measured.
        `left`, of one draw, takes these points.

        Examples
        --------
        >>> from pfdist.constraints.kinds import PlainStep
        >>> from pfdist.kernels.follows import StepLimits
        >>> alone = PlainStep("apart", (-1, 1, 2), (0,))
        >>> rule, cheap_and_sharp = Thresholds((2.0, 5.0)), StepLimits(steps=(alone,))
        >>> [rule.chosen(d, 1, Left(cheap_and_sharp, 2, range(4), 2)) for d in (1, 3, 6)]
        [[], [2], [3]]
        """
        points, chosen = left.made_at(t), list[int]()
        levels = self.levels(points, left.instants - t, float(left.spent[0]))
        for place in sorted(range(len(points)), key=lambda place: -levels[place]):
            is_wanted = deviation > levels[place] or left.requires(points[place])
            if is_wanted and left.may(points[place])[0]:
                left.take(points[place])
                chosen.append(points[place])
        return chosen

    def scaled(self, factor: float) -> "Thresholds":
        """The rule whose thresholds are so many times as high; "always" remains "always"."""
        thresholds = (float(f"{c * factor:.4g}") if c > 0 else c for c in self.thresholds)
        return self._replace(thresholds=tuple(thresholds))


class Applied(NamedTuple):
    """A rule as a filter applies it."""

    rule: Thresholds
    follows: StepLimits = UNLIMITED  # what may be measured after other measurements
    flipped: int | None = None  # a point at which the rule decides the opposite

    @property
    def recorded(self) -> dict[str, Any]:
        """The fields by name, without unused ones."""
        flipped = {} if self.flipped is None else {"flipped": self.flipped}
        return {"rule": self.rule} | flipped | self.follows.recorded


class Replicates(NamedTuple):
    """Measurements that particles would make, for the compiled filter; by default there are none.

    Rows have 16 particles of each draw.
    """

    penalise: int = 0  # address of `pfdist.kernels.replicates.penalise`
    factor: float = 0.0  # by which the penalty counts
    # the blocks of a simulation, as `pfdist.kernels.blocks.Blocks` has them
    addresses: NDArray[np.int64] = np.empty(0, np.int64)
    places: NDArray[np.int64] = np.empty(0, np.int64)
    table: NDArray[np.float64] = np.empty(0)
    memory: NDArray[np.float64] = np.empty(0)
    components: int = 0  # of the measurement noise
    kinds: NDArray[np.int64] = np.empty(0, np.int64)  # (components,)
    first_noises: NDArray[np.int64] = np.empty(0, np.int64)  # (sensors,)
    row: int = 0  # entries of a row
    states: NDArray[np.float64] = np.empty(0)  # rows of x
    values: NDArray[np.float64] = np.empty(0)  # rows of y
    noise: NDArray[np.float32] = np.empty(0, np.float32)


class Ruling(NamedTuple):
    """A rule in the form that the compiled filter reads; by default there is none."""

    decide: int = 0  # address of `pfdist.kernels.deciding.decide`
    together: int = 2**31  # draws of a batch, at most
    exponent: float = 0.0
    limit: float = 0.0
    thresholds: NDArray[np.float64] = np.empty(0)  # (T+1, sensors)
    # (T+1, sensors): the sensors, from the highest threshold at an instant to the lowest
    turns: NDArray[np.int64] = np.empty(0, np.int64)
    flipped: int = -1  # the point at which it decides the opposite; -1: none
    follows: Follows = UNLIMITED.arrays(1, range(1))
    size: int = 0  # numbers of the states of a draw
    # of the draws of a batch, and of a trial: what is spent and when something may follow, (D+1, 2)
    spent: NDArray[np.float64] = np.empty(0)
    states: NDArray[np.int64] = np.empty(0, np.int64)  # (D+1, size)
    replicates: Replicates = Replicates()
