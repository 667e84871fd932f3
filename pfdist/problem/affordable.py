"""The set of times nearest to wanted times, among the sets that spend most of a sum of money.

Source: Bellman, "Dynamic programming", 1957.
"""

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times
from pfdist.errors import MeasurementTimesError
from pfdist.problem.spacing import Spacing

_IMPOSSIBLE = -(2**62)

Keys = NDArray[np.int64]


@dataclass(frozen=True)
class Affordable:
    """The sets of times that a sum of money pays for."""

    usable: Times  # times that a set may contain, sorted
    # usable times that every set must contain; no other usable time lies within their spacing
    required: Times
    spacing: Spacing
    units: Sequence[int]  # (T+1,): price of each time in units, at least 1
    total: int  # the sum to spend; it pays for the required times, and for at least one time

    def nearest(self, wanted: Callable[[int], Times]) -> Times:
        """The set that spends the most, has the most times, and is nearest to wanted times, sorted.

        The three criteria apply in this order. Only sets that spend the largest possible sum are
        considered; among them, those with the most times; among these, the set with the smallest
        sum of distances between its times and the wanted times, both in order. If several sets
        remain, the one whose last time is the earliest is chosen, then whose last but one, and so
        on. `wanted` takes a number of times, and returns so many wanted times, sorted.
        """
        most = self._keys(())[self._last_required :].max(axis=0, initial=0)  # for each sum spent
        spent = max(np.flatnonzero(most).tolist(), default=0)
        number = int(most[spent]) // self._count
        times = wanted(number)
        return self._followed_back(self._keys(times), spent, times)

    @property
    def _count(self) -> int:
        """The value of a time in a key: more than the sum of all distances of a set."""
        return (len(self.units) + 1) ** 2

    @property
    def _last_required(self) -> int:
        """Place in `usable` of the last required time, the first place at which a set may end."""
        return self.usable.index(self.required[-1]) if self.required else 0

    def _keys(self, wanted: Times) -> Keys:
        """The key of the best prefix, for each last time and sum spent, (usable, total + 1).

        The key is the number of times, in units of `_count`, less the sum of the distances to the
        wanted times, if there are any. It is `_IMPOSSIBLE` if there is no such prefix.

        A prefix of a best set has as many times as any prefix that ends there and spends as much:
        with a prefix of more times, the whole set would have more. So the number of times is no
        part of the state.
        """
        keys = np.full((len(self.usable), self.total + 1), _IMPOSSIBLE)
        before = np.full(self.total + 1, _IMPOSSIBLE)  # the best prefixes that may come before
        before[0] = 0
        following, targets = 0, np.array(wanted)
        for index, time in enumerate(self.usable):
            if index and self.usable[index - 1] in self.required:  # no set may leave it out
                before, following = keys[index - 1].copy(), index
            while self.usable[following] <= self.spacing.before(time):
                np.maximum(before, keys[following], out=before)
                following += 1
            price = self.units[time]
            row = before[: max(0, self.total + 1 - price)] + self._count
            if wanted:
                number = np.clip(-(-row // self._count), 1, len(wanted))
                row -= np.abs(time - targets[number - 1])
            keys[index, price:] = np.where(row > 0, row, _IMPOSSIBLE)
        return keys

    def _followed_back(self, keys: Keys, spent: int, wanted: Times) -> Times:
        """The times of the best set that spends this sum, found from the last to the first."""
        first = self._last_required
        key = int(keys[first:, spent].max(initial=0))
        stop, times = len(self.usable), list[int]()
        for target in reversed(wanted):
            index = first + int((keys[first:stop, spent] == key).argmax())
            time = self.usable[index]
            times.append(time)
            spent, key = spent - self.units[time], key - self._count + abs(time - target)
            before = [self.usable.index(other) for other in self.required if other < time]
            first = max(before, default=0)
            stop = bisect_right(self.usable, self.spacing.before(time))
        return tuple(reversed(times))


def nearest(wanted: Times, usable: Times, required: Times, spacing: Spacing) -> Times:
    """The set of N usable times that is nearest to a set of N wanted times; all are sorted.

    It is the set of `Affordable.nearest` where each time has a price of one unit. The set contains
    the required times, and no other usable time lies within their spacing. A
    `MeasurementTimesError` says that fewer than N usable times are far enough apart.

    >>> spacing = Spacing.constant(3, horizon=10)
    >>> nearest((0, 5, 10), usable=(1, 2, 3, 4, 6, 8, 9), required=(), spacing=spacing)
    (1, 4, 9)
    """
    units = (1,) * len(spacing.successors)
    affordable = Affordable(usable, required, spacing, units, len(wanted))
    times = affordable.nearest(lambda number: wanted[:number])
    if len(times) < len(wanted):
        raise MeasurementTimesError(
            f"there must be {len(wanted)} usable times far enough apart, got {usable}"
        )
    return times
