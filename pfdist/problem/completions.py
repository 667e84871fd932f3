"""The ways to complete a prefix of measurement times, counted from the horizon backwards.

A completion depends only on the last time of the prefix and on the money left. This requires that
the cheap times are given: those that the money left over at the end would pay for. A set may omit a
cheap time only if another time of the set lies within its spacing.

Sources: Bellman, "Dynamic programming", 1957. Nijenhuis, Wilf, "Combinatorial algorithms", 1978,
chapter 13 (objects of equal probability by counting how each beginning can be completed).
"""

from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.problem.spacing import Spacing

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
        """The times that may follow a prefix of one of these sets."""
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
