"""Visits: measurements that share a price, because someone comes once for all of them."""

from bisect import bisect_left
from collections.abc import Iterable
from dataclasses import dataclass
from decimal import Decimal
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times
from pfdist.common.points import PointNumbers

Money = int | Decimal
"""A price, exactly as the user has written it."""


@dataclass(frozen=True)
class Visits:
    """The rule that divides measurements into visits, their price, and their largest number.

    A visit begins with its first measurement. The next measurement that is not before its end
    begins another one.

    >>> Visits(ends=(3, 4, 5, 6, 7, 8)).parts((0, 2, 4))
    [(0, 2), (4,)]
    """

    # (points,): the first point after the visit that begins at each point; they never decrease
    ends: tuple[int, ...]
    price: Money = 0
    most: int | None = None
    open_until: int = 0  # points before this one belong to a visit that has begun

    def firsts(self, times: Iterable[int]) -> Times:
        """The first measurement of each visit that some sorted times begin."""
        firsts, end = list[int](), self.open_until
        for time in times:
            if time >= end:
                firsts.append(time)
                end = self.ends[time]
        return tuple(firsts)

    def number(self, times: Iterable[int]) -> int:
        """The number of visits that some sorted times begin."""
        return len(self.firsts(times))

    def end(self, times: Iterable[int]) -> int:
        """The first point after the last visit of some sorted times."""
        firsts = self.firsts(times)
        return self.ends[firsts[-1]] if firsts else self.open_until

    def parts(self, times: Times) -> list[Times]:
        """The measurements of each visit; `times` are sorted."""
        starts = (bisect_left(times, first) for first in self.firsts(times))
        bounds = pairwise(sorted({0, *starts, len(times)}))
        return [times[start:stop] for start, stop in bounds]

    def begins(self, last: NDArray[np.int64], time: NDArray[np.int64] | int) -> NDArray[np.bool_]:
        """Whether a measurement after a last one (-1: none) begins a visit at the latest.

        It does if it lies after a visit that would begin at the last measurement. If ends do not
        depend on the first measurement, as those of days, no other measurement begins a visit.
        """
        ends = np.array([*self.ends, 0])[last]  # the last entry is that of no measurement
        begins: NDArray[np.bool_] = np.asarray(time) >= np.maximum(ends, self.open_until)
        return begins

    def longest(self, points: PointNumbers) -> int:
        """The number of instants of the longest visit; 1 if its last measurement tells the end."""
        visits = [(t, end) for t, end in enumerate(self.ends) if end < len(self.ends)]
        if all({*self.ends[t:end]} == {end} for t, end in visits):
            return 1
        return (
            max(points.instant(end - 1) - points.instant(t) for t, end in enumerate(self.ends)) + 1
        )

    def since(self, first: int, taken: Times) -> "Visits":
        """The visits from a point on, after some measurements; points count from there."""
        most = None if self.most is None else max(0, self.most - self.number(taken))
        ends = tuple(end - first for end in self.ends[first:])
        return Visits(ends, self.price, most, max(0, self.end(taken) - first))
