"""The most measurements that a sum of money pays for, as near to wanted times as they can be.

References
----------
Bellman, "Dynamic programming", 1957.
"""

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pfdist.times.measurement_times import Times

_IMPOSSIBLE = -(2**62)

Keys = NDArray[np.int64]


@dataclass(frozen=True)
class Affordable:
    """The sets of times that a sum of money pays for.

    Parameters
    ----------
    usable : tuple of int
        Times that may be in a set, sorted.
    required : tuple of int
        Those of them that must be; the others are no nearer to them than the spacing.
    spacing : int
        Least difference of two times.
    price : sequence of int, (T+1,)
        Of each time, at least 1.
    total : int
        What there is to spend; it pays for the required times and for one time at least.
    """

    usable: Times
    required: Times
    spacing: int
    price: Sequence[int]
    total: int

    def nearest(self, wanted: Callable[[int], Times]) -> Times:
        """Give the set that spends the most, has the most times, and is nearest to those wanted.

        In this order: of the sets that spend as much as any can, those with the most times; of
        these, that with the least sum of distances to the wanted times of its number, one by one.
        Of several such sets, that whose last time is the earliest, then the last but one, and so
        on.

        Parameters
        ----------
        wanted : callable
            Gives that many times, sorted.

        Returns
        -------
        tuple of int
            Sorted.
        """
        most = self._keys(())[self._last_required :].max(axis=0)  # by what they spend
        spent = int(np.flatnonzero(most > 0)[-1])
        number = int(most[spent]) // self._count
        times = wanted(number)
        return self._followed_back(self._keys(times), spent, times)

    @property
    def _count(self) -> int:
        """What another time adds to a key: more than all distances together can take away."""
        return (len(self.price) + 1) ** 2

    @property
    def _last_required(self) -> int:
        return self.usable.index(self.required[-1]) if self.required else 0

    def _keys(self, wanted: Times) -> Keys:
        """Key of the best prefix by its last time and what it spends: more times, less distance.

        A prefix of a best set has as many times as any that ends there and spends as much: with
        another that had more, the whole would have more. So its number need not be kept apart.
        """
        keys = np.full((len(self.usable), self.total + 1), _IMPOSSIBLE)
        before = np.full(self.total + 1, _IMPOSSIBLE)  # of the prefixes that may come before
        before[0] = 0
        following, targets = 0, np.array(wanted)
        for place, time in enumerate(self.usable):
            if place and self.usable[place - 1] in self.required:  # which none may leave out
                before, following = keys[place - 1].copy(), place
            while self.usable[following] <= time - self.spacing:
                np.maximum(before, keys[following], out=before)
                following += 1
            price = self.price[time]
            row = before[: max(0, self.total + 1 - price)] + self._count
            if wanted:
                number = np.clip(-(-row // self._count), 1, len(wanted))
                row -= np.abs(time - targets[number - 1])
            keys[place, price:] = np.where(row > 0, row, _IMPOSSIBLE)
        return keys

    def _followed_back(self, keys: Keys, spent: int, wanted: Times) -> Times:
        """Find the times of the best set that spends so much, from the last to the first."""
        first, key = self._last_required, int(keys[self._last_required :, spent].max())
        stop, times = len(self.usable), list[int]()
        for target in reversed(wanted):
            place = first + int((keys[first:stop, spent] == key).argmax())
            time = self.usable[place]
            times.append(time)
            spent, key = spent - self.price[time], key - self._count + abs(time - target)
            before = [self.usable.index(taken) for taken in self.required if taken < time]
            first = max(before, default=0)
            stop = bisect_right(self.usable, time - self.spacing)
        return tuple(reversed(times))
