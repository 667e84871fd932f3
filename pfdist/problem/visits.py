"""Visits and installations: prices that are paid once for several measurements.

Someone comes once for all measurements of a visit, which may be limited, too. A sensor is installed
once.
"""

from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, pairwise, product
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times
from pfdist.common.points import PointNumbers
from pfdist.problem.points import Points
from pfdist.problem.shared import Money, Shared

if TYPE_CHECKING:
    from pfdist.problem.feasible import Feasible


Numbers = NDArray[np.int64]


@dataclass(frozen=True)
class Installs(Shared):
    """Prices of installations, each paid once if any of its ways measures."""

    each: tuple[tuple[Money, Times], ...]

    @property
    def fees(self) -> dict[str, tuple[Money, ...]]:
        """The price of each installation."""
        return {"install": tuple(price for price, _ in self.each)}

    def counts(self, points: Points, times: Times) -> list[int]:
        """Whether some times need each installation."""
        used = {points.way(time) for time in times}
        return [not used.isdisjoint(ways) for _, ways in self.each]

    def choices(
        self, in_units: Callable[[Money], int], most: int
    ) -> Iterator[tuple[int, frozenset[int]]]:
        """For each choice of installed sensors, its price in units, and the ways of the others.

        Only so many installations count, those with the highest prices.
        """
        known = sorted((in_units(price), ways) for price, ways in self.each)
        known = known[max(0, len(known) - most) :]
        for used in product((True, False), repeat=len(known)):
            paid = sum(units for (units, _), is_used in zip(known, used, strict=True) if is_used)
            others = (ways for (_, ways), is_used in zip(known, used, strict=True) if not is_used)
            yield paid, frozenset(chain.from_iterable(others))

    def since(self, points: Points, first: int, taken: Times) -> Self | None:
        """The installations that were not paid yet."""
        used = self.counts(points, taken)
        left = tuple(each for each, is_paid in zip(self.each, used, strict=True) if not is_paid)
        return replace(self, each=left) if left else None

    def steps(self, points: Points) -> dict[str, Any]:
        """The price of each sensor's first measurement, beside its own."""
        install = {way: float(price) for price, ways in self.each for way in ways}
        return {"install": tuple(install.get(way, 0.0) for way in range(points.ways))}


@dataclass(frozen=True)
class Visits(Shared):
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

    @property
    def fees(self) -> dict[str, tuple[Money, ...]]:
        """The price of a visit."""
        return {"visits.price": (self.price,)} if self.price else {}

    @property
    def relaxed(self) -> str:
        """The limit that the bound relaxes."""
        return "most of visits" * (self.most is not None)

    def counts(self, points: Points, times: Times) -> list[int]:
        """The number of visits that some sorted times begin."""
        return [self.number(times)] if self.price else []

    def broken(self, points: Points, times: Times) -> Iterator[str]:
        """A sentence if some sorted times begin too many visits."""
        if self.most is not None and (number := self.number(times)) > self.most:
            yield f"visits.most is {self.most}, got {number} visits"

    def beyond(self, points: Points, times: Times) -> range:
        """The points that would begin a visit too many."""
        is_full = self.most is not None and self.number(times) >= self.most
        return range(self.end(times), points.number) if is_full else range(0)

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

    def begins(self, last: Numbers, time: Numbers | int) -> NDArray[np.bool_]:
        """Whether a measurement after a last one (-1: none) begins a visit at the latest.

        It does if it lies after a visit that would begin at the last measurement. If ends do not
        depend on the first measurement, as those of days, no other measurement begins a visit.
        """
        ends = np.array([*self.ends, 0])[last]  # the last entry is that of no measurement
        begins: NDArray[np.bool_] = np.asarray(time) >= np.maximum(ends, self.open_until)
        return begins

    def at_least(self, times: Times) -> int:
        """A number of visits that follows from each measurement and the one before."""
        return int(self.begins(np.array((-1, *times))[:-1], np.array(times)).sum())

    def after(
        self, points: Points, last: Numbers, age: Numbers, ages: int, time: int
    ) -> tuple[NDArray[np.bool_], Numbers]:
        """Whether a measurement after each last one (-1: none) begins a visit, and the age then.

        The age is the number of instants since the visit began; of an impossible one, `ages`. With
        a single age, 0, a visit begins only if the last measurement says so.
        """
        first = np.where(last < 0, last, (points.instant(last) - age) * points.ways)
        begun = self.begins(last if ages == 1 else first, time)
        older = np.where(last < 0, 0, age + points.instant(time) - points.instant(last))
        possible = (last < 0) | (first >= 0)
        return begun, np.where(possible, np.where(begun | (ages == 1), 0, older), ages)

    def longest(self, points: PointNumbers) -> int:
        """The number of instants of the longest visit; 1 if its last measurement tells the end."""
        visits = [(t, end) for t, end in enumerate(self.ends) if end < len(self.ends)]
        if all({*self.ends[t:end]} == {end} for t, end in visits):
            return 1
        return (
            max(points.instant(end - 1) - points.instant(t) for t, end in enumerate(self.ends)) + 1
        )

    def since(self, points: Points, first: int, taken: Times) -> Self:
        """The visits from a point on, after some measurements; points count from there."""
        most = None if self.most is None else max(0, self.most - self.number(taken))
        ends = tuple(end - first for end in self.ends[first:])
        return replace(self, ends=ends, most=most, open_until=max(0, self.end(taken) - first))

    def steps(self, points: Points) -> dict[str, Any]:
        """The end of the visit that begins at each point, its price, and the largest number."""
        return {
            "visit_ends": self.ends,
            "visit_price": float(self.price),
            "most_visits": points.number if self.most is None else self.most,
            "open_until": self.open_until,
        }

    # --- sets of visits ---------------------------------------------------------------------------

    def moved(self, feasible: "Feasible", times: Times, reach: int | None) -> list[Times]:
        """The feasible sets in which all measurements of a visit move by the same instants."""
        moved, points = list[Times](), feasible.points
        for part in self.parts(times):
            rest = {*times} - {*part}
            for first in feasible.near(part[0], reach):
                if points.way(first) == points.way(part[0]) and first != part[0]:
                    changed = tuple(sorted({*rest, *(t + first - part[0] for t in part)}))
                    if changed[-1] < points.number and feasible.accepts(changed):
                        moved.append(changed)
        return moved

    def together(self, times: Times, order: Iterable[int]) -> list[int]:
        """The times of a set in an order, each visit as a whole at its first one."""
        parts = {t: part for part in self.parts(times) for t in part}
        return [*dict.fromkeys(chain.from_iterable(parts[t] for t in order))]

    def numbers(self, feasible: "Feasible") -> range:
        """The numbers of visits of a set that can be paid for."""
        price = min(feasible.units) + feasible.in_units(self.price)
        most = feasible.horizon + 1 if self.most is None else self.most
        most = min(feasible.total // price, most, feasible.horizon + 1)
        return range(1, most + 1)

    def evenly(self, feasible: "Feasible") -> Times | None:
        """The set with the most visits at regular times; None if there is none."""
        clock = feasible.points.clock
        for number in reversed(self.numbers(feasible)):
            targets = [clock.times[t] for t in clock.regular_times(number)]
            if (times := self.near(feasible, targets)) is not None:
                return times
        return None

    def near(
        self, feasible: "Feasible", targets: Sequence[float], way: int | None = None
    ) -> Times | None:
        """As many measurements as possible in visits around some times; None if there are none.

        One sensor measures, by default the cheapest. The measurements are divided evenly among the
        visits, and are evenly spaced in each. A visit lies around the nearest allowed time.
        """
        points, way = feasible.points, feasible.cheapest if way is None else way
        times, own = (
            points.clock.times,
            np.array([t for t in feasible.allowed if points.way(t) == way]),
        )
        if not own.size:
            return None
        when = np.array([times[points.instant(t)] for t in own.tolist()])
        stops = np.searchsorted(own, np.array(self.ends)[own])
        slots = dict[int, Times]()  # the times of each visit, by its first
        for target in targets:
            near = int(np.abs(when - target).argmin())
            first = max(
                (k for k in range(near + 1) if stops[k] > near),
                key=lambda k: (stops[k] - k, -abs(when[k] + when[stops[k] - 1] - 2 * target)),
            )
            slots[first] = tuple(own[first : stops[first]].tolist())
        if len(slots) < len(targets):
            return None
        each, cheapest = [*slots.values()], min(feasible.units[t] for t in own.tolist())
        paid = (feasible.total - feasible.in_units(self.price) * len(each)) // cheapest
        for number in range(min(paid, sum(map(len, each))), len(each) - 1, -1):
            shares = [number // len(each) + (k < number % len(each)) for k in range(len(each))]
            spaced = {
                slot[place]
                for slot, share in zip(each, shares, strict=True)
                for place in np.linspace(0, len(slot) - 1, share).round().astype(int).tolist()
            }
            chosen = feasible.with_required(spaced)
            if len(spaced) == number and feasible.accepts(chosen):
                return chosen
        return None
