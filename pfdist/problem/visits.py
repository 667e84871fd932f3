"""Visits and installations: prices that are paid once for several measurements.

Someone comes once for all measurements of a visit, which may be limited, too. A sensor is installed
once.
"""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise, product
from typing import ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times
from pfdist.constraints.setup import NO_LIMIT, Setup
from pfdist.constraints.step import Money, Step
from pfdist.problem.even_sets import Array, EvenFamily, EvenLine, EvenSets, lines_of_family
from pfdist.problem.feasible import Feasible
from pfdist.problem.points import Points
from pfdist.problem.shared import Shared

_MOST_FAMILIES, _FEWEST_PATTERNS = 20_000, 12  # of visits, and of times in each
_MOST_LINES = 6000  # whose sets are checked one by one


class Installs(Shared):
    """Prices of installations, each paid once if any of its ways measures."""

    priced: ClassVar[str] = "install"

    @classmethod
    def on(cls, points: Points, each: Sequence[tuple[Money, Times]]) -> Self:
        """Installations from the price of each and its ways."""
        ways = [points.way(point) for point in range(points.number)]
        return cls(steps=tuple(
            Setup(ends=tuple(NO_LIMIT * (way in own) for way in ways), price=price, in_order=False)
            for price, own in each
        ))  # fmt: skip

    def since(self, first: int, taken: Times, steps: tuple[Step, ...]) -> Self | None:
        """The installations that were not paid yet."""
        unpaid = tuple(step for step in steps if step.start == step.beginning)
        return replace(self, steps=unpaid) if unpaid else None


@dataclass(frozen=True)
class Visits(Shared):
    """The rule that divides measurements into visits, their price, and their largest number.

    A visit begins with its first measurement. The next measurement that is not before its end
    begins another one.

    >>> Visits.on((3, 4, 5, 6, 7, 8)).parts((0, 2, 4))
    [(0, 2), (4,)]
    """

    priced: ClassVar[str] = "visits.price"
    spaced: ClassVar[str] = "visits"

    late: Times = ()  # (ways,): points from each to its moment, if values are not in order

    @classmethod
    def on(cls, ends: Times, price: Money = 0, most: int | None = None, late: Times = ()) -> Self:
        """Visits from the first moment after the visit that begins at each point."""
        visits = Setup(ends=ends, price=price, most=most, key="visits.most", things="visits")
        return cls(late, steps=(visits,))

    @property
    def setup(self) -> Setup:
        """The price, the largest number and the ends of visits."""
        return self.setups[0]

    def parts(self, times: Times) -> list[Times]:
        """The measurements of each visit; `times` are sorted."""
        order = sorted(times, key=self._moment)
        starts = map(order.index, self.setup.firsts(order, self._moment))
        bounds = pairwise(sorted({0, *starts, len(times)}))
        return [tuple(sorted(order[start:stop])) for start, stop in bounds]

    def _moment(self, time: int) -> int:
        return time + self.late[time % len(self.late)] if self.late else time

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
    return f"{dates[0]:%a} {dates[0].date()}: {', '.join(hours)}"


class Block(NamedTuple):
    """A possible visit: for each way, the points and their times after the beginning."""

    begin: float
    by_way: dict[int, tuple[NDArray[np.int64], Array]]

    def nearest(self, way: int, after: float) -> int | None:
        """The point of a way that is nearest to a time after the beginning, if there is one."""
        if way not in self.by_way:
            return None
        points, times = self.by_way[way]
        return int(points[np.abs(times - after).argmin()])


@dataclass(frozen=True)
class EvenVisits(EvenSets):
    """The sets with evenly spaced visits, which all measure at the same times after the beginning.

    These times are evenly spaced, too, with any first one and step: by one sensor, or by all in
    turn. If the measurements cannot be divided evenly among the visits, the first have one more;
    the others have the same step, or are as long.
    """

    visits: Visits

    @cached_property
    def blocks(self) -> list[Block]:
        """All visits, in order. If a visit may begin at any time, there is one for each."""
        feasible, points, ends = self.feasible, self.feasible.points, self.visits.setup.ends_here
        times, together = points.clock.times, defaultdict[int, list[int]](list)
        for point in feasible.allowed:
            together[ends[point]].append(point)
        if self._may_overlap:
            allowed = np.array(feasible.allowed)
            firsts = dict.fromkeys(points.first(points.instant(t)) for t in feasible.allowed)
            groups = {f: allowed[(allowed >= f) & (allowed < ends[f])].tolist() for f in firsts}
        else:
            first_of = dict(zip(reversed(ends), range(len(ends) - 1, -1, -1), strict=True))
            groups = {first_of[end]: own for end, own in together.items()}
        longest = max((times[points.instant(g[-1])] - times[points.instant(f)]
                       for f, g in groups.items()), default=0.0)  # fmt: skip
        blocks = []
        for first, own in groups.items():
            begin = times[points.instant(first)]
            if not first and not self._may_overlap:  # the clock may begin within a visit
                begin = min(begin, times[points.instant(own[-1])] - longest)
            by_way = {}
            for way in range(points.ways):
                of_way = np.array([t for t in own if points.way(t) == way], np.int64)
                if of_way.size:
                    after = np.array([times[points.instant(t)] - begin for t in of_way.tolist()])
                    by_way[way] = of_way, after
            blocks.append(Block(begin, by_way))
        return blocks

    @cached_property
    def _may_overlap(self) -> bool:
        """Whether a visit begins with its first measurement, at any time."""
        ends, ways = self.visits.setup.ends_here, self.feasible.points.ways
        return any(end > t + ways and ends[t + ways] != end for t, end in enumerate(ends[:-ways]))

    @property
    def numbers(self) -> range:
        """The numbers of visits of a set that can be paid for."""
        feasible, setup = self.feasible, self.visits.setup
        price = min(feasible.units) + feasible.in_units(setup.price)
        most = feasible.horizon + 1 if setup.left is None else setup.left
        return range(1, min(feasible.total // price, most, feasible.horizon + 1) + 1)

    def _families(self) -> Iterator[EvenFamily]:
        begins = np.array([block.begin for block in self.blocks])
        turns, numbers = [*self._turns], [n for n in self.numbers if n <= begins.size]
        most = max(_FEWEST_PATTERNS, _MOST_FAMILIES // max(1, len(turns) * len(numbers)))
        for turn, number in product(turns, numbers):
            times = self._most_times(turn, number)
            for each in sorted({-(-times // number), times // number} - {0}):
                all_times, ways = min(times, each * number), (turn[0],) * number
                # Visits with one measurement less leave out the last one, or are as long.
                is_uneven = all_times % number and each > 2
                stretches = (1.0, (each - 1) / (each - 2)) if is_uneven else (1.0,)
                for stretch, (first, step) in product(stretches, self._patterns(turn, each, most)):
                    inside, shorter = (
                        tuple((first + apart * k, turn[k % len(turn)]) for k in range(count))
                        for count, apart in ((each, step), (each - 1, step * stretch))
                    )
                    places = np.arange(begins.size)
                    yield EvenFamily(number, ways, places, begins, inside, shorter, all_times)

    def _most_times(self, turn: tuple[Times, ...], number: int) -> int:
        """The largest number of times at which so many visits can measure."""
        feasible, ways = self.feasible, {way for each in turn for way in each}
        units = [feasible.units[t] for t in feasible.allowed if feasible.points.way(t) in ways]
        paid = feasible.total - feasible.in_units(self.visits.setup.price) * number
        most = max(len(block.by_way.get(way, ((),))[0]) for block in self.blocks for way in ways)
        affordable = paid // (min(units) * len(turn[0])) if units else 0
        return int(min(affordable, most * len(turn) * number))

    def _patterns(
        self, turn: tuple[Times, ...], times: int, most: int
    ) -> Iterator[tuple[float, float]]:
        """The first time in a visit, and the step to the next."""
        of_each = [
            block.by_way[turn[0][0]][1] for block in self.blocks if turn[0][0] in block.by_way
        ]
        longest = max(of_each, key=len)
        family = EvenFamily(times, ((0,),) * times, np.arange(longest.size), longest)
        if len(turn) > 1 and times > 1:  # all sensors at one time
            yield from ((after, 0.0) for after in longest.tolist())
        for first, step, _ in lines_of_family(family, most):
            if not self._may_overlap or first < family.edges[1]:
                yield first, step

    def lines(self, most: int) -> list[EvenLine]:
        """About `most` lines that are spread over all families."""
        most = min(most, _MOST_LINES)
        lines = super().lines(most)
        return lines[:: max(1, len(lines) // most)]

    def near(self, line: EvenLine) -> list[EvenLine]:
        """Lines between a line and its neighbours, and the same line with other times in visits."""
        own, families = self.families[line.family], self.families
        others = range(max(0, line.family - 2), min(len(families), line.family + 3))
        alike = [n for n in others if families[n].targets == own.targets]
        return [*super().near(line), *(line._replace(family=number) for number in alike)]

    def _sets(self, family: EvenFamily, lines: list[EvenLine]) -> list[Times | None]:
        steps = np.arange(family.targets)
        targets = np.array([line.first + line.step * steps for line in lines])
        places = np.searchsorted(family.edges[1:-1], targets)
        made = {tuple(row): self._visiting(row, family) for row in places.tolist()}
        return [made[tuple(row)] for row in places.tolist()]

    def _visiting(self, places: list[int], family: EvenFamily) -> Times | None:
        """The measurements of visits at some places, as many as can be paid for."""
        feasible, visits = self.feasible, len(places)
        inside, shorter = family.inside, family.shorter
        if len({*places}) < visits:
            return None
        ways = {way for _, each in inside for way in each}
        required = {*feasible.required} - {*self._others(ways)}
        for number in range(family.most, visits * len(shorter), -1):
            chosen = [
                self.blocks[place].nearest(way, after)
                for k, place in enumerate(places)
                for after, each in (inside if k < number - visits * len(shorter) else shorter)
                for way in each
            ]
            found = {point for point in chosen if point is not None}
            times = feasible.with_required(found)
            if len(found) == len(chosen) and found >= required and feasible.accepts(times):
                return times
        return None

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
        stops = np.searchsorted(own, np.array(setup.ends_here)[own])
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
