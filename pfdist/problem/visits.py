"""Visits and installations: prices that are paid once for several measurements.

Someone comes once for all measurements of a visit, which may be limited, too. A sensor is installed
once.
"""

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, ClassVar, Self

import numpy as np

from pfdist.common.measurement_times import Times
from pfdist.problem.even_sets import EvenFamily, EvenLine, EvenSets
from pfdist.problem.feasible import Feasible
from pfdist.problem.points import Points
from pfdist.problem.shared import Money, Setup, Shared


class Installs(Shared):
    """Prices of installations, each paid once if any of its ways measures."""

    priced: ClassVar[str] = "install"

    @classmethod
    def on(cls, points: Points, each: Sequence[tuple[Money, Times]]) -> Self:
        """Installations from the price of each and its ways."""
        ways = [points.way(point) for point in range(points.number)]
        last = points.number
        ends = (tuple(last * (way in own) for way in ways) for _, own in each)
        return cls(setups=tuple(Setup(e, price) for e, (price, _) in zip(ends, each, strict=True)))

    def steps(self, points: Points) -> dict[str, Any]:
        """The price of each sensor's first measurement, beside its own."""
        ways = range(points.ways)
        each = (float(sum(own.price for own in self.setups if own.ends[way])) for way in ways)
        return {"install": tuple(each)}

    def since(self, first: int, taken: Times) -> Self | None:
        """The installations that were not paid yet."""
        unpaid = tuple(e.since(first, taken) for e in self.setups if not e.number(taken))
        return replace(self, setups=unpaid) if unpaid else None


class Visits(Shared):
    """The rule that divides measurements into visits, their price, and their largest number.

    A visit begins with its first measurement. The next measurement that is not before its end
    begins another one.

    >>> Visits.on((3, 4, 5, 6, 7, 8)).parts((0, 2, 4))
    [(0, 2), (4,)]
    """

    priced: ClassVar[str] = "visits.price"
    spaced: ClassVar[str] = "visits"

    @classmethod
    def on(cls, ends: Times, price: Money = 0, most: int | None = None) -> Self:
        """Visits from the first point after the visit that begins at each point."""
        return cls(setups=(Setup(ends, price, most, key="visits.most", things="visits"),))

    @property
    def setup(self) -> Setup:
        """The price, the largest number and the ends of visits."""
        return self.setups[0]

    @property
    def relaxed(self) -> tuple[str, ...]:
        """The limit that the bound relaxes."""
        return ("most of visits",) * (self.setup.most is not None)

    def steps(self, points: Points) -> dict[str, Any]:
        """The end of the visit that begins at each point, its price, and the largest number."""
        setup = self.setup
        return {
            "visit_ends": setup.ends,
            "visit_price": float(setup.price),
            "most_visits": points.number if setup.most is None else setup.most,
            "open_until": setup.open_until,
        }

    def parts(self, times: Times) -> list[Times]:
        """The measurements of each visit; `times` are sorted."""
        starts = (bisect_left(times, first) for first in self.setup.firsts(times))
        bounds = pairwise(sorted({0, *starts, len(times)}))
        return [times[start:stop] for start, stop in bounds]

    def in_words(self, points: Points, times: Times) -> str:
        """The measurements of each visit in words."""
        visits = [written(points, part) for part in self.parts(times)]
        each = " ".join(f"Visit {number}, {text}." for number, text in enumerate(visits, start=1))
        return f"in {len(visits)} visit{'s' * (len(visits) != 1)}. {each}" if visits else ""

    def regular(self, feasible: Feasible) -> Times:
        """The set with the most visits at regular times, or another one if there is none."""
        even, clock = EvenVisits(feasible, self), feasible.points.clock
        for number in reversed(even.numbers):
            targets = [clock.times[t] for t in clock.regular_times(number)]
            if (times := even.near_targets(targets, feasible.cheapest)) is not None:
                return times
        return feasible.repair(feasible.allowed, np.random.default_rng(0))

    def even_sets(self, feasible: Feasible) -> "EvenVisits":
        """The sets with evenly spaced visits."""
        return EvenVisits(feasible, self)


def written(points: Points, visit: Times) -> str:
    """The measurements of a visit as users read them: a day is named once.

    >>> from pfdist.problem.clock import Clock
    >>> written(Points(Clock.regular(2, 0.5, "h")), (0, 1, 2))
    't = 0, 0.5, 1 h'
    """
    calendar = points.clock.calendar
    has_hours = calendar is not None and not calendar.by_days
    dates = [points.clock.dates[points.instant(point)] for point in visit if has_hours]
    if len({date.date() for date in dates}) != 1:
        return f"t = {points.clock.listed(points.written_of(visit))}"
    hours = (
        f"{date:%H:%M} {points.sensor(point)}".rstrip()
        for date, point in zip(dates, visit, strict=True)
    )
    return f"{dates[0]:%a} {dates[0].day} {dates[0]:%b}: {', '.join(hours)}"


@dataclass(frozen=True)
class EvenVisits(EvenSets):
    """The sets with evenly spaced visits, in each of which one sensor measures evenly."""

    visits: Visits
    most_lines: ClassVar[int] = 3000  # which are moved to visits one by one

    @cached_property
    def numbers(self) -> range:
        """The numbers of visits of a set that can be paid for."""
        feasible, setup = self.feasible, self.visits.setup
        price = min(feasible.units) + feasible.in_units(setup.price)
        most = feasible.horizon + 1 if setup.most is None else setup.most
        return range(1, min(feasible.total // price, most, feasible.horizon + 1) + 1)

    def _families(self) -> Iterator[EvenFamily]:
        times = np.array(self.feasible.points.clock.times, np.float64)
        for ways in self.feasible.points.sensor_ways:
            for number in self.numbers:
                yield EvenFamily(number, (ways[:1],) * number, np.arange(times.size), times)

    def _sets(self, family: EvenFamily, lines: list[EvenLine]) -> list[Times | None]:
        steps, way = np.arange(family.targets), family.ways[0][0]
        return [self.near_targets((e.first + e.step * steps).tolist(), way) for e in lines]

    def near_targets(self, targets: Sequence[float], way: int) -> Times | None:
        """As many measurements as possible in visits around some times; None if there are none.

        One sensor measures. The measurements are divided evenly among the visits, and are evenly
        spaced in each. A visit lies around the nearest allowed time.
        """
        feasible, points, setup = self.feasible, self.feasible.points, self.visits.setup
        own = np.array([t for t in feasible.allowed if points.way(t) == way])
        if not own.size:
            return None
        when = np.array([points.clock.times[points.instant(t)] for t in own.tolist()])
        stops = np.searchsorted(own, np.array(setup.ends)[own])
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
        paid = (feasible.total - feasible.in_units(setup.price) * len(each)) // cheapest
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
