"""The affordable sets of times: the set nearest to wanted times, and all sets.

Dynamic programmes find both. They count the ways to complete a prefix of times, from the horizon
backwards. A completion depends only on the last time of the prefix and on the money left, once the
cheap times are given: those that the money left over at the end would pay for. A set may omit a
cheap time only if another time of the set lies within its spacing.

Sources: Bellman, "Dynamic programming", 1957. Nijenhuis, Wilf, "Combinatorial algorithms", 1978,
chapter 13 (objects of equal probability by counting how each beginning can be completed).
"""

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times
from pfdist.constraints.spacing import Spacing
from pfdist.errors import MeasurementTimesError

_IMPOSSIBLE = -(2**62)

Keys = NDArray[np.int64]


@dataclass(frozen=True)
class Affordable:
    """The sets of times that a total price pays for."""

    usable: Times  # times that a set may contain, sorted
    # usable times that every set must contain; no other usable time lies within their spacing
    required: Times
    spacing: Spacing
    units: Sequence[int]  # (T+1,): price of each time in units, at least 1
    total: int  # the sum to spend; it pays for the required times, and for at least one time

    def nearest(self, wanted: Callable[[int], Times]) -> Times:
        """The set that spends the most, has the most times, and is nearest to wanted times, sorted.

        The three criteria apply in this order: the largest sum spent, then the most times, then the
        smallest sum of distances between its times and the wanted times, both in order. If several
        sets remain, the set with the earliest last time is chosen, then the earliest last but one,
        and so on. `wanted` takes a number of times, and returns that many wanted times, sorted.
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
    the required times, and no other usable time lies within their spacing. Raises
    `MeasurementTimesError` if fewer than N usable times are far enough apart.

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


# --- all sets -------------------------------------------------------------------------------------

_BEFORE = -1  # stands for the last time of an empty prefix; as an index, the table's last row


@dataclass(frozen=True)
class Completions:
    """The sets of times whose money left over lies in a given range."""

    horizon: int
    # times that a set may contain, sorted; none lies within the spacing of a required time
    usable: tuple[int, ...]
    required: tuple[int, ...]  # usable times that every set must contain
    # times that a set must contain unless another of its times lies within the spacing
    cheap: tuple[int, ...]
    spacing: Spacing
    units: tuple[int, ...]  # (T+1,): price of each time in units, at least 1
    total: int  # the sum to spend
    # money that may be left at the end: it pays for the cheap times and for no others
    left_over: range

    @cached_property
    def size(self) -> int:
        """Number of sets."""
        return int(self._ways[_BEFORE, self.total])

    def extensions(self, times: tuple[int, ...]) -> list[int]:
        """The times that may follow a prefix in one of these sets."""
        last = _BEFORE
        for time in times:
            if time not in self._window(last):
                return []
            last = time
        left = self.total - sum(self.units[time] for time in times)
        return [time for time in self._following(last) if self._can_be_completed(time, left)]

    def every(self) -> Iterator[tuple[int, ...]]:
        """All sets, in lexicographic order."""
        unfinished: list[tuple[tuple[int, ...], int]] = [((), self.total)]
        while unfinished:
            times, left = unfinished.pop()
            last = times[-1] if times else _BEFORE
            if self._is_complete(last, left):
                yield times
            unfinished += [
                ((*times, time), left - self.units[time])
                for time in reversed(self._following(last))
                if self._can_be_completed(time, left)
            ]

    def at(self, index: int) -> tuple[int, ...]:
        """The set of this index in the order of `every`."""
        times: list[int] = []
        last, left = _BEFORE, self.total
        while index or not self._is_complete(last, left):
            index -= self._is_complete(last, left)  # a set precedes those that begin with it
            for time in self._following(last):
                if not self._can_be_completed(time, left):
                    continue
                ways = self._ways[time, left - self.units[time]]
                if index < ways:
                    break
                index -= ways
            times.append(time)
            last, left = time, left - self.units[time]
        return tuple(times)

    def _next(self, times: tuple[int, ...], first: int) -> int:
        """The earliest of some times that is not before `first`; T + 1 if there is none."""
        index = bisect_left(times, first)
        return times[index] if index < len(times) else self.horizon + 1

    def _window(self, last: int) -> range:
        """The range of the next time: a later time would omit a required or a cheap time."""
        first = self.spacing.after(last)
        cheap, required = self._next(self.cheap, first), self._next(self.required, last + 1)
        stop = min(self.spacing.after(cheap), required + 1, self.horizon + 1)
        return range(first, max(first, stop))

    def _following(self, last: int) -> tuple[int, ...]:
        window = self._window(last)
        first, stop = (bisect_left(self.usable, end) for end in (window.start, window.stop))
        return self.usable[first:stop]

    def _can_be_completed(self, time: int, left: int) -> bool:
        """Whether the money left pays for a time and for some completion after it."""
        after = left - self.units[time]
        return after >= 0 and bool(self._completable[time, after])

    def _is_complete(self, last: int, left: int) -> bool:
        """Whether a prefix with this last time and this money left is a whole set."""
        nothing_more = self.horizon + 1
        return (
            left in self.left_over
            and self._next(self.cheap, self.spacing.after(last)) == nothing_more
            and self._next(self.required, last + 1) == nothing_more
        )

    @cached_property
    def _ways(self) -> NDArray[Any]:
        """Number of completions by last time and money left."""
        return self._table(exact=True)

    @cached_property
    def _completable(self) -> NDArray[Any]:
        """Whether there is a completion, by last time and money left."""
        return self._table(exact=False)

    def _table(self, exact: bool) -> NDArray[Any]:
        """The number of completions, or whether there is any, by last time and money left.

        The next time lies in a window. With sums over all later times, the number of completions is
        the difference of two sums. The row -1 of the table, its last, is that of the empty prefix.
        """
        instants, kind = self.horizon + 1, np.dtype(object if exact else np.int64)
        ways = np.zeros((instants + 1, self.total + 1), kind if exact else np.bool_)
        from_here_on = np.zeros((instants + 1, self.total + 1), kind)  # sums over later rows
        usable = set(self.usable)
        for last in range(self.horizon, _BEFORE - 1, -1):
            window = self._window(last)
            first, stop = (min(end, instants) for end in (window.start, window.stop))
            row = from_here_on[first] - from_here_on[stop]
            if self._is_complete(last, self.left_over.start):
                row[self.left_over.start : self.left_over.stop] += 1
            ways[last] = row if exact else row > 0
            if last == _BEFORE:
                break
            from_here_on[last] = from_here_on[last + 1]
            if last in usable:
                paid_for = max(0, self.total + 1 - self.units[last])
                from_here_on[last, self.units[last] :] += ways[last, :paid_for]
        return ways
