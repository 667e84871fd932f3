"""Visits, and all else that a set has begun and that still lasts: a number beside each window.

The end of what was begun may follow from an earlier measurement than the window has. So a state of
the programme has the window and, for each setup, the place of its end among those that are possible
after the last measurement. Prices are then exact.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from pfdist.constraints.setup import Setup

_MOST_MOVES = 30_000_000

Indices = NDArray[np.int64]
Flags = NDArray[np.bool_]


class Ends(NamedTuple):
    """The ends of a setup that are possible after each of P points, and after none, the last."""

    begun: Indices  # (P,): the end of what begins at each point; 0 if it does not need the setup
    values: Indices  # (V,): all ends, sorted; first 0: nothing lasts
    idle: Indices  # (P+1,): 1 if it is possible that nothing lasts, which then comes first
    low: Indices  # (P+1,): the place in `values` of the first of the others
    possible: Indices  # (P+1,): the number of possible ends

    @classmethod
    def all_of(cls, setup: Setup) -> Self:
        """All ends that some measurements lead to."""
        ends, points = np.array(setup.ends_here), np.arange(len(setup.ends_here))
        begun = np.where((ends > 0) & (points >= setup.open_until), ends, setup.open_until)
        values = np.unique([0, *begun.tolist(), setup.open_until])
        lasts = np.append(np.maximum.accumulate(begun), setup.open_until)
        at_first = np.searchsorted(values, setup.open_until)
        low = np.append(np.searchsorted(values, points, "right"), at_first)
        idle = np.append(ends == 0, np.False_).astype(np.int64)
        lasting = np.searchsorted(values, lasts, "right") - low
        return cls(ends, values, idle, low, idle + np.maximum(lasting, 0))

    @property
    def latest(self) -> Self:
        """Only the latest of these ends: less begins than in truth, so a bound remains one."""
        lasting = self.possible - self.idle
        low = np.where(lasting > 0, self.low + lasting - 1, 0)
        return self._replace(idle=0 * self.idle, low=low, possible=0 * self.possible + 1)

    @property
    def size(self) -> int:
        """The largest number of possible ends."""
        return int(self.possible.max())

    def after(self, last: Indices, number: Indices, time: int) -> tuple[Indices, Flags]:
        """The number of the end after a measurement, and whether it begins the setup, (n,) each.

        `last` are measurements before, and `number` the ends then; an impossible one is replaced.
        """
        lasting = np.minimum(number, self.possible[last] - 1) - self.idle[last]
        end = self.values[np.where(lasting < 0, 0, self.low[last] + lasting)]
        begins = (self.begun[time] > 0) & (time >= end)
        end = np.where(begins, self.begun[time], end)
        after = np.searchsorted(self.values, end) - self.low[time] + self.idle[time]
        return np.where(end > time, np.maximum(after, 0), 0), begins


@dataclass(frozen=True)
class Setups:
    """The numbers of all setups together, below `size`."""

    ends: Sequence[Ends]  # of each setup
    size: int

    @classmethod
    def within(cls, setups: Sequence[Setup], most: int, moves: Indices) -> Self:
        """All ends of those with the highest prices, and only the latest end of others.

        There are at most so many numbers. `moves` (P+1,) has the moves after each measurement.
        """
        ends, size, possible = [Ends.all_of(each) for each in setups], 1, moves
        for place in sorted(range(len(ends)), key=lambda place: -setups[place].price):
            own = ends[place]
            if size * own.size > most or possible @ own.possible > _MOST_MOVES:
                own = ends[place] = own.latest
            size, possible = size * own.size, possible * own.possible
        return cls(ends, size)

    def after(self, last: Indices, number: Indices, time: int) -> tuple[Indices, Flags]:
        """The number after a measurement, (n,), and whether it begins each setup, (setups, n).

        `last` are measurements before, and `number` the numbers then. After an impossible one it is
        `size`.
        """
        begun = np.zeros((len(self.ends), last.size), np.bool_)
        after, is_possible, size = np.zeros_like(last), np.ones(last.size, np.bool_), 1
        for begins, ends in zip(begun, self.ends, strict=True):
            number, own = np.divmod(number, ends.size)
            of_setup, begins[:] = ends.after(last, own, time)
            is_possible &= own < ends.possible[last]
            after, size = after + size * of_setup, size * ends.size
        return np.where(is_possible, after, self.size), begun
