"""How a set of measurement times can go on after its last time, found from the horizon backwards.

What may follow depends on the last time and on the money that is left alone, once it is settled
which times are cheap: those that could be paid for with what is left over at the end, so that none
of them may have been left out where it had room.

References
----------
Bellman, "Dynamic programming", 1957. Nijenhuis, Wilf, "Combinatorial algorithms", 1978, chapter 13
(objects of equal probability by counting how each beginning can be completed).
"""

from bisect import bisect_left
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

_BEFORE = -1  # the last time where there is none; of a table's rows, the last


@dataclass(frozen=True)
class Completions:
    """Sets of times that leave over at the end what they may.

    Parameters
    ----------
    horizon : int
        T.
    usable : tuple of int
        Times that may be in a set, sorted; none is nearer than the spacing to a required one.
    required : tuple of int
        Those of them that must be in it.
    cheap : tuple of int
        Times that must be in it unless there is one nearer than the spacing.
    spacing : int
        Least difference of two times.
    cost : tuple of int, (T+1,)
        Of each time, at least 1.
    total : int
        What there is to spend.
    left_over : range
        How much of it may be left at the end: what pays for the cheap times and for no other.
    """

    horizon: int
    usable: tuple[int, ...]
    required: tuple[int, ...]
    cheap: tuple[int, ...]
    spacing: int
    cost: tuple[int, ...]
    total: int
    left_over: range

    @cached_property
    def size(self) -> int:
        """How many sets there are."""
        return int(self._ways[_BEFORE, self.total])

    def extensions(self, times: tuple[int, ...]) -> list[int]:
        """Give the times that may follow, so that one of these sets can still come of it."""
        last = _BEFORE
        for time in times:
            if time not in self._window(last):
                return []
            last = time
        left = self.total - sum(self.cost[time] for time in times)
        return [time for time in self._following(last) if self._goes_on(time, left)]

    def every(self) -> Iterator[tuple[int, ...]]:
        """Give all sets, in the order of words in a dictionary."""
        unfinished: list[tuple[tuple[int, ...], int]] = [((), self.total)]
        while unfinished:
            times, left = unfinished.pop()
            last = times[-1] if times else _BEFORE
            if self._ends(last, left):
                yield times
            unfinished += [
                ((*times, time), left - self.cost[time])
                for time in reversed(self._following(last))
                if self._goes_on(time, left)
            ]

    def at(self, index: int) -> tuple[int, ...]:
        """Give the set of this number, counted from 0 in the order of `every`."""
        times: list[int] = []
        last, left = _BEFORE, self.total
        while not self._ends(last, left):
            for time in self._following(last):
                if not self._goes_on(time, left):
                    continue
                ways = self._ways[time, left - self.cost[time]]
                if index < ways:
                    break
                index -= ways
            times.append(time)
            last, left = time, left - self.cost[time]
        return tuple(times)

    def _first_after(self, last: int) -> int:
        return 0 if last == _BEFORE else last + self.spacing

    def _next(self, times: tuple[int, ...], first: int) -> int:
        """The first of them from a time on; T + 1 if there is none."""
        place = bisect_left(times, first)
        return times[place] if place < len(times) else self.horizon + 1

    def _window(self, last: int) -> range:
        """Where the next time must lie: before it, nothing required or cheap is left out."""
        first = self._first_after(last)
        cheap, required = self._next(self.cheap, first), self._next(self.required, last + 1)
        stop = min(cheap + self.spacing, required + 1, self.horizon + 1)
        return range(first, max(first, stop))

    def _following(self, last: int) -> tuple[int, ...]:
        window = self._window(last)
        first, stop = (bisect_left(self.usable, end) for end in (window.start, window.stop))
        return self.usable[first:stop]

    def _goes_on(self, time: int, left: int) -> bool:
        """Whether so much pays for a time and for what can follow it."""
        after = left - self.cost[time]
        return after >= 0 and bool(self._reaches[time, after])

    def _ends(self, last: int, left: int) -> bool:
        """Whether a set may end here."""
        nothing_more = self.horizon + 1
        return (
            left in self.left_over
            and self._next(self.cheap, self._first_after(last)) == nothing_more
            and self._next(self.required, last + 1) == nothing_more
        )

    @cached_property
    def _ways(self) -> NDArray[Any]:
        return self._table(exact=True)

    @cached_property
    def _reaches(self) -> NDArray[Any]:
        return self._table(exact=False)

    def _table(self, exact: bool) -> NDArray[Any]:
        """In how many ways a set can go on, or whether it can, by last time and money left.

        What follows lies in a window, so sums from each time on give all in one difference.
        """
        instants, kind = self.horizon + 1, np.dtype(object if exact else np.int64)
        ways = np.zeros((instants + 1, self.total + 1), kind if exact else np.bool_)
        with_later = np.zeros((instants + 1, self.total + 1), kind)  # than the row, or at it
        usable = set(self.usable)
        for last in range(self.horizon, _BEFORE - 1, -1):
            window = self._window(last)
            first, stop = (min(end, instants) for end in (window.start, window.stop))
            row = with_later[first] - with_later[stop]
            if self._ends(last, self.left_over.start):
                row[self.left_over.start : self.left_over.stop] += 1
            ways[last] = row if exact else row > 0
            if last == _BEFORE:
                break
            with_later[last] = with_later[last + 1]
            if last in usable:
                paid_for = max(0, self.total + 1 - self.cost[last])
                with_later[last, self.cost[last] :] += ways[last, :paid_for]
        return ways
