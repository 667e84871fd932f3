"""The feasible sets of measurement times: all, random and regular ones, neighbours, and repair.

With prices, a set is feasible only if no measurement can be added to it. After some measurements,
the feasible sets of what is left are those of a shorter horizon.
"""

from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from heapq import merge
from itertools import chain, combinations, cycle, pairwise
from math import comb

import numpy as np

from pfdist.common.measurement_times import Times, random, random_below, regular
from pfdist.constraints.apart import Apart
from pfdist.constraints.kinds import PlainStep
from pfdist.errors import MeasurementTimesError
from pfdist.kernels.follows import StepLimits
from pfdist.kernels.left import Left
from pfdist.problem.affordable import Affordable, Completions, nearest
from pfdist.problem.constraints import Constraints, check_constraints

_MOST_COUNTED = 1_000_000  # sets that are counted one by one


@dataclass(frozen=True)
class Feasible(Constraints):
    """The feasible sets, all sorted: N times, or as many times as a total price pays for.

    Raises `MeasurementTimesError` if the constraints contradict each other, or if no set satisfies
    them. The message begins with the name of the wrong parameter.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        check_constraints(self)

    def accepts(self, times: Times) -> bool:
        """Whether a set is feasible."""
        if self.counted and len(times) != self.total:
            return False
        complete = set(self.required).issubset(times) and self.allows(times)
        return complete and (self.counted or self.smaller or not self.affordable(times))

    @cached_property
    def measurements(self) -> int:
        """The number N of measurements; with prices, that of the set `regular`."""
        return len(self.regular())

    @cached_property
    def size(self) -> int:
        """Number of feasible sets; for many sets with limits, an upper bound."""
        if self._free:
            return comb(len(self.optional), self.total - len(self.required))
        size = sum(completions.size for completions in self._completions)
        return size if not self.shared or size > _MOST_COUNTED else sum(1 for _ in self.every())

    def every(self) -> Iterator[Times]:
        """All feasible sets, in lexicographic order."""
        if self._free:
            chosen = combinations(self.optional, self.total - len(self.required))
            return (self.with_required(times) for times in chosen)
        sets = merge(*(completions.every() for completions in self._completions))
        return filter(self._fits, sets)

    def random(self, sets: int, rng: np.random.Generator) -> list[Times]:
        """Draw feasible sets, each with the same probability; a set may come twice.

        Sets that break limits are repaired, so the probabilities then differ.
        """
        if self.shared:
            unlimited = replace(self, shared=())
            return [self.repair(times, rng) for times in unlimited.random(sets, rng)]
        if self._free:
            number = self.total - len(self.required)
            rows = random(len(self.optional) - 1, number, sets, rng).tolist()
            return [self.with_required(self.optional[index] for index in row) for row in rows]
        return [self._at(random_below(self.size, rng)) for _ in range(sets)]

    def regular(self) -> Times:
        """The regular times, or the feasible set nearest to them.

        With N measurements these are the times of the paper's equation 13; a single time is in the
        middle. On an uneven clock they are the instants nearest to evenly spaced times. With money,
        or if they are not feasible, see `pfdist.problem.affordable.Affordable.nearest`.
        """
        return self._nearest_regular

    @cached_property
    def references(self) -> dict[str, Times]:
        """Further reference sets by name: each sensor alone at regular times, and all in rotation.

        Without sensors there are none. Sets that are not feasible are left out.
        """
        firsts = tuple(ways[0] for ways in self.points.sensor_ways)
        if len(firsts) < 2:
            return {}
        names = {way: self.points.sensors[way].removesuffix("_a") for way in firsts}
        turns: dict[str, Times] = {f"alone_{name}": (way,) for way, name in names.items()}
        turns["rotation"] = firsts
        return {
            name.lower().replace("-", "_"): times
            for name, ways in turns.items()
            if (times := self._in_turn(ways)) is not None
        }

    def canonical(self, times: Times) -> Times:
        """The set with the first of alike repeats, unless limits of single repeats forbid it."""
        alike = self.points.canonical(times)
        return alike if self.accepts(alike) else times

    def is_regular(self, times: Times) -> bool:
        """Whether times are the regular times of their number, feasible or not."""
        return times == self._regular_times(len(times))

    def additions(self, times: Times) -> list[Times]:
        """The sets with one more time that can still be completed to a feasible set."""
        if not self.allows(times):
            return []
        lacking = {*self.required} - {*times}
        new = sorted({*lacking, *self.affordable(times)})
        if self.counted and not self._free and not self.shared:
            new = self._leaving_capacity(times, new)
        larger = [tuple(sorted({*times, time})) for time in new]
        return [*filter(self._can_be_completed, larger)] if self.shared else larger

    def removals(self, times: Times) -> list[Times]:
        """The sets with one time fewer that still contain a feasible set."""
        contained = self._contained_in(times)
        if contained is None:
            return []
        smaller = {out: tuple(time for time in times if time != out) for out in times}
        return [
            smaller_set
            for out, smaller_set in smaller.items()
            if out not in contained or self._contained_in(smaller_set)
        ]

    def extensions(self, times: Times) -> Sequence[int]:
        """The times, sorted, that may follow a prefix of a feasible set.

        The prefix has the first times of the set, sorted; it may be empty.
        """
        if not self.counted:
            followers = (completions.extensions(times) for completions in self._completions)
            after = sorted(set().union(*followers))
            return [t for t in after if self.allows((*times, t))] if self.shared else after
        if self.shared:
            return [t for t in self.allowed if self._may_follow(times, t)]
        left, last = self.total - len(times), times[-1] if times else -1
        required = self.required[bisect_right(self.required, last) :]
        if left <= 0 or len(required) > left:
            return ()
        start = bisect_left(self.allowed, self.spacing.after(last))
        stop = bisect_right(self._negative_capacities, -left)
        if required:
            index = bisect_left(self.allowed, required[0])
            start, stop = (index if len(required) == left else start), min(stop, index + 1)
        return self.allowed[start:stop]

    def exchanges(
        self, times: Times, reach: int | None = None, moved: int | None = None
    ) -> list[Times]:
        """The feasible sets in which one time, or a given one, is exchanged for another.

        `reach` is the largest distance between the two; by default it is not limited. With money, a
        new time may be too expensive or lie too near to others. Then the times nearest to it are
        removed. In every case the money left buys other times, each as far from the rest as
        possible. The exchanged time may come back. If smaller sets are feasible, nothing is bought,
        and the sets with one time more or fewer follow, whatever the distance of that time, and
        the sets with a whole visit at another time.
        """
        own = {*times}
        exchanged = [
            neighbour
            for out in times
            if out not in self.required and moved in (None, out)
            for new in self.near(out, reach)
            if new not in own and (neighbour := self._exchanged(own - {out}, new)) is not None
        ]
        if self.counted:
            return exchanged
        exchanged += (*self.additions(times), *self.removals(times)) if self.smaller else ()
        exchanged += self._moved_parts(times, reach)
        return [neighbour for neighbour in dict.fromkeys(exchanged) if neighbour != times]

    def completed(self, times: Iterable[int]) -> Times:
        """A feasible set with these and the required times, which can be paid for together.

        Unless smaller sets are feasible, the money left over buys times, each as far from the rest
        as possible.
        """
        completed = self.with_required(times)
        while not self.smaller and (more := self.affordable(completed)):
            farthest = max(more, key=lambda time: self.distance(time, completed))
            completed = self.with_required({*completed, farthest})
        return completed

    def repair(self, times: Iterable[int], rng: np.random.Generator) -> Times:
        """A feasible set that shares times with a given set of times in 0..T.

        The given times are tried in random order, visit by visit. A time is kept if a feasible set
        can contain it and those kept before; another order may keep more. Then random times are
        added until the set is feasible. A feasible set is returned unchanged, without drawing a
        random number.
        """
        repaired, original = Times(), tuple(sorted(times))
        if self.accepts(original):
            return original
        order: list[int] = rng.permutation(original).tolist()
        parts = {t: part for each in self.shared for part in each.parts(original) for t in part}
        # Each visit as a whole, in the order of a random measurement of each.
        for time in dict.fromkeys(chain.from_iterable(parts.get(t, (t,)) for t in order)):
            larger = tuple(sorted({*repaired, time}))
            repaired = larger if self._can_be_completed(larger) else repaired
        while not self.accepts(repaired):
            larger_sets = self.additions(repaired)
            repaired = larger_sets[rng.integers(len(larger_sets))]
        return repaired

    @cached_property
    def step_limits(self) -> StepLimits:
        """The constraints in the order of time."""
        points, spacing, steps = self.points, self.spacing, self.steps
        if not spacing.is_free:
            firsts = range(0, self.possible, points.ways)
            after = tuple(points.instant(spacing.after(t)) for t in firsts)
            steps = (Apart(after=after), *steps)
        return StepLimits(
            tuple(map(float, self.price or (1,) * self.possible)),
            points.delays,
            self.required,
            tuple(map(PlainStep.made_from, steps)),
        )

    @property
    def budget(self) -> float:
        """The largest number of measurements, or the money."""
        return float(self.measurement_budget or self.total_price or 0)

    def left(
        self, taken: Times = (), first: int = 0, in_flight: Times = (), limit: float | None = None
    ) -> Left:
        """The measurements that may follow from an instant on, after some measurements.

        `limit` is that of `Left`, by default the budget.
        """
        most = self.budget if limit is None else limit
        given = self.step_limits, self.points.ways, self.allowed, self.horizon + 1
        left = Left(*given, most)
        left.take((*taken, *in_flight))
        left.wait(first)
        return left

    def rest(self, taken: Times, first: int, in_flight: Times = ()) -> "Feasible | None":
        """The feasible sets of what is left after the measurements that were taken.

        `taken` is sorted, and need not be the start of a feasible set. `first` is the first instant
        that may still be measured, and the times of the result count from it. The result is None if
        no measurement is left or fits. If fewer fit than are left, the sets have as many as fit. A
        required time that can no longer be measured is left out. Measurements in flight were made,
        and their values arrive from `first` on: all sets contain them.

        >>> rest = Feasible(horizon=9, measurement_budget=3, minimum_spacing=3).rest((4,), 5)
        >>> rest.allowed, rest.total  # 7, 8 and 9 may be measured, and no two of them
        ((2, 3, 4), 1)
        """
        if first > self.horizon or not (first or taken or in_flight):
            return None if first else self
        points, start = self.points, self.points.first(first)
        left = self.left(taken, first, in_flight)
        required = {*in_flight, *left.required()}
        usable = {
            time for time in range(start, self.possible) if time in required or left.may(time)
        }
        if not usable:
            return None
        made = (*taken, *in_flight)
        shared = (
            each.since(start, taken, self.steps_since(each, start, made)) for each in self.shared
        )
        make = partial(
            replace,
            self,
            horizon=self.horizon - first,
            forbidden=tuple({*range(self.possible - start)} - {time - start for time in usable}),
            required=tuple(sorted(time - start for time in required)),
            points=points.since(first),
            shared=tuple(filter(None, shared)),
            made=tuple(time - start for time in in_flight),
        )
        if self.price is not None and self.total_price is not None:
            paid = self.price_of(made)
            money = max(self.total_price, paid) - paid + sum(self.price[t] for t in in_flight)
            return make(price=self.price[start:], total_price=money)
        number = max(len(in_flight), self.total - len(taken))
        if self.smaller:
            number = min(number, len(usable))
        else:
            number = min(number, make(measurement_budget=len(required)).capacity(()))
        return make(measurement_budget=number) if number else None

    def _may_follow(self, times: Times, t: int) -> bool:
        """Whether a possible measurement may follow a prefix within the limits of sensors."""
        last, longer = times[-1] if times else -1, (*times, t)
        if not last < t <= min((r for r in self.required if r > last), default=t):
            return False
        complete = self.with_required(longer)
        if len(complete) > self.total or not self.is_within_limits(complete):
            return False
        later = [other for other in self.allowed if other > t]
        return len(complete) + len(self.fitting(complete, tuple(later))) >= self.total

    @property
    def _free(self) -> bool:
        """Whether all sets of N allowed times that contain the required times are feasible."""
        return self.counted and self.spacing.is_free and not self.shared

    @cached_property
    def _negative_capacities(self) -> list[int]:
        """For each allowed time, minus the most times that fit from it on; sorted for bisect."""
        negated = [0] * (len(self.allowed) + 1)
        for index in reversed(range(len(self.allowed))):
            after = bisect_left(self.allowed, self.spacing.after(self.allowed[index]))
            negated[index] = negated[after] - 1
        return negated[:-1]

    @cached_property
    def _completions(self) -> list[Completions]:
        return self._completions_of(self.allowed)

    def _completions_of(self, usable: Times) -> list[Completions]:
        """The parts of all feasible sets, one for each range of the money left over.

        A time is cheap if a set must not leave over the money for it. In one range the same times
        are cheap. If smaller sets are feasible, no time is cheap.
        """
        prices = () if self.smaller else sorted({self.units[time] for time in self.optional})
        bounds = [0, 1] if self.counted else [0, *prices, self.total + 1]
        return [
            Completions(
                horizon=self.possible - 1,
                usable=usable,
                required=self.required,
                cheap=tuple(time for time in self.optional if self.units[time] <= least),
                spacing=self.spacing,
                units=self.units,
                total=self.total,
                left_over=range(least, min(more, self.total + 1)),
            )
            for least, more in pairwise(bounds)
            if least <= self.total
        ]

    def _at(self, index: int) -> Times:
        for completions in self._completions:
            if index < completions.size:
                break
            index -= completions.size
        return completions.at(index)

    def _can_be_completed(self, times: Times) -> bool:
        if not self.allows(times):
            return False
        return self._free or not self.counted or self.capacity(times) >= self.total

    def _leaving_capacity(self, times: Times, new: list[int]) -> list[int]:
        """The new times that, added to a set, leave a capacity of N times in all."""
        complete = self.with_required(times)
        ends, spare = (-1, *complete, self.possible), self.capacity(times) - self.total

        def lost(time: int) -> int:
            if time in complete:
                return 0
            index = bisect_left(complete, time)
            before, after = ends[index], ends[index + 1]
            beside = self.capacity_between(before, time) + self.capacity_between(time, after)
            return self.capacity_between(before, after) - beside - 1

        return [time for time in new if lost(time) <= spare]

    def _contained_in(self, times: Times) -> Times | None:
        """A feasible set that has no other times than these; None if there is none."""
        usable = tuple(time for time in self.allowed if time in times)
        if not set(self.required).issubset(usable):
            return None
        if not self.counted:
            every = (completions.every() for completions in self._completions_of(usable))
            return next(chain.from_iterable(every), None)
        packed = self.fitting(self.required, usable)
        contained = self.with_required(packed[: self.total - len(self.required)])
        return contained if len(contained) == self.total else None

    def _regular_times(self, number: int, ways: Times = ()) -> Times:
        """Regular times, feasible or not, measured in some ways in turn.

        By default the cheapest sensor measures.
        """
        points, clock = self.points, self.points.clock
        times = regular(self.horizon, number) if clock.is_even else clock.regular_times(number)
        turn = cycle(ways or (self.cheapest,))
        return tuple(points.at(t)[way] for t, way in zip(times, turn, strict=False))

    def _in_turn(self, ways: Times) -> Times | None:
        """Some ways in turn at regular times, or a compatible set like that; None if none is."""
        own = (t for t in self.allowed if self.points.way(t) in ways)
        usable = tuple(sorted({*self.required, *own}))
        cheap = min((self.units[t] for t in usable), default=1)
        most = min(self.total // cheap, self.horizon + 1, len(usable))
        if self.counted and most < self.total:
            return None
        for number in range(most, self.total - 1 if self.counted else 0, -1):
            wanted = self._regular_times(number, ways)
            with suppress(MeasurementTimesError):
                times = nearest(wanted, usable, self.required, self.spacing)
                if self.allows(times):
                    return times
        return None

    @cached_property
    def _nearest_regular(self) -> Times:
        for each in self.shared:
            if (times := each.regular(self)) is not None:
                return times
        if self.points.ways > 1:
            times = self._in_turn((self.cheapest,))
            number = min(self.total, self.horizon + 1)
            start = self._regular_times(number) if times is None else times
            return self.repair(start, np.random.default_rng(0))
        if self.counted:  # quicker if regular times are feasible
            wanted = self._regular_times(self.total)
            if self.accepts(wanted):
                return wanted
        affordable = Affordable(self.allowed, self.required, self.spacing, self.units, self.total)
        times = affordable.nearest(self._regular_times)
        return self.repair(times, np.random.default_rng(0)) if self.steps else times

    def near(self, time: int, reach: int | None) -> Times:
        """The allowed times within so many instants of one; by default all."""
        if reach is None:
            return self.allowed
        instant = self.points.instant(time)
        first, stop = (self.points.first(instant + far) for far in (-reach, reach + 1))
        return self.allowed[bisect_left(self.allowed, first) : bisect_left(self.allowed, stop)]

    def _moved_parts(self, times: Times, reach: int | None) -> Iterator[Times]:
        """The feasible sets in which measurements that belong together move together."""
        points = self.points
        for part in chain.from_iterable(each.parts(times) for each in self.shared):
            rest = {*times} - {*part}
            for first in self.near(part[0], reach):
                if points.way(first) == points.way(part[0]) and first != part[0]:
                    moved = tuple(sorted({*rest, *(t + first - part[0] for t in part)}))
                    if moved[-1] < points.number and self.accepts(moved):
                        yield moved

    def _exchanged(self, others: set[int], new: int) -> Times | None:
        if self.counted:
            exchanged = tuple(sorted({*others, new}))
            return exchanged if self._free or self.compatible(exchanged) else None
        leaving = sorted(others - {*self.required}, key=lambda time: (-abs(time - new), time))
        while leaving and not self.allows({*others, new}):
            others = others - {leaving.pop()}
        return self.completed({*others, new}) if self.allows({*others, new}) else None
