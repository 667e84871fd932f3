"""What binds a set of measurement times: which times, how many or for how much, how far apart."""

from bisect import bisect_left
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import gcd

from pfdist.errors import MeasurementTimesError
from pfdist.measurement_times import Times

_MOST_UNITS = 10_000  # of money: as many sums are told from each other


@dataclass(frozen=True)
class Constraints:
    """N times in 0..T, or as many as a sum of money buys, of those that may be together.

    Parameters
    ----------
    horizon : int
        T.
    measurement_budget : int, optional
        N.
    forbidden, required : tuple of int
        Times that no set may hold, and times that every set must. Sorted.
    minimum_spacing : int
        Least difference of two times of a set.
    cost : tuple of int, (T+1,), optional
        Of a measurement at each time, at least 1, in whole units.
    total_cost : int, optional
        What all measurements together may cost; with `cost`, in the place of `measurement_budget`.

    Raises
    ------
    MeasurementTimesError
        They contradict each other, or no set satisfies them.
    """

    horizon: int
    measurement_budget: int | None = None
    forbidden: Times = ()
    required: Times = ()
    minimum_spacing: int = 1
    cost: tuple[int, ...] | None = None
    total_cost: int | None = None

    def __post_init__(self) -> None:
        self._check_times()
        self._check_what_is_paid_for()
        self._check_that_there_is_one()

    @property
    def counted(self) -> bool:
        """Whether it is the number of measurements that is given."""
        return self.measurement_budget is not None

    @cached_property
    def allowed(self) -> Times:
        """Times that a set may hold: neither forbidden, nor too near to a required one."""
        barred = {*self.forbidden}
        for time in self.required:
            near = range(time - self.minimum_spacing + 1, time + self.minimum_spacing)
            barred.update({*near} - {time})
        return tuple(time for time in range(self.horizon + 1) if time not in barred)

    @cached_property
    def place(self) -> dict[int, int]:
        """Number of each time among those allowed."""
        return {time: place for place, time in enumerate(self.allowed)}

    @cached_property
    def optional(self) -> Times:
        """Those of them that are not required."""
        return tuple(time for time in self.allowed if time not in self.required)

    @cached_property
    def price(self) -> tuple[int, ...]:
        """What a measurement at each time takes of `total`: 1, where they are counted."""
        return tuple(cost // self._unit for cost in self.cost or (1,) * (self.horizon + 1))

    @cached_property
    def total(self) -> int:
        """What there is to spend: N, or money in the largest unit in which all costs are whole."""
        if self.measurement_budget is not None:
            return self.measurement_budget
        return min((self.total_cost or 0) // self._unit, self.spent(self.allowed))

    def spent(self, times: Iterable[int]) -> int:
        """What a set takes of `total`."""
        return sum(self.price[time] for time in times)

    def with_required(self, times: Iterable[int]) -> Times:
        """Give these times and the required ones, sorted."""
        return tuple(sorted({*times, *self.required}))

    def together(self, times: Times) -> bool:
        """Whether these times are allowed and far enough from each other."""
        near = any(b - a < self.minimum_spacing for a, b in pairwise(times))
        return not near and self._allowed.issuperset(times)

    def allows(self, times: Iterable[int]) -> bool:
        """Whether these times and the required ones may be together and can be paid for."""
        kept = self.with_required(times)
        return self.spent(kept) <= self.total and self.together(kept)

    def broken(self, times: Iterable[int]) -> list[str]:
        """Give the constraints that a set of times in 0..T breaks, a sentence each.

        Parameters
        ----------
        times : iterable of int

        Returns
        -------
        list of str
            Empty if the set keeps to all of them. Money that it leaves over breaks none.

        Examples
        --------
        >>> Constraints(horizon=9, measurement_budget=2, forbidden=(4,)).broken([1, 4, 9])
        ['problem.measurement_budget is 2, got 3 times', 'problem.forbidden: 4 is measured']
        """
        chosen = sorted({*times})
        found, cost = list[str](), self.cost_of(chosen)
        if self.measurement_budget not in (None, len(chosen)):
            found.append(
                f"problem.measurement_budget is {self.measurement_budget}, got {len(chosen)} times"
            )
        if self.total_cost is not None and cost > self.total_cost:
            found.append(f"problem.total_cost is {self.total_cost}, got times that cost {cost}")
        forbidden = [time for time in chosen if time in self.forbidden]
        missing = [time for time in self.required if time not in chosen]
        for name, wrong, is_ in (("forbidden", forbidden, ""), ("required", missing, "not ")):
            if wrong:
                verb = "is" if len(wrong) == 1 else "are"
                listed = ", ".join(map(str, wrong))
                found.append(f"problem.{name}: {listed} {verb} {is_}measured")
        near = [f"{a} and {b}" for a, b in pairwise(chosen) if b - a < self.minimum_spacing]
        if near:
            spacing = self.minimum_spacing
            found.append(f"problem.minimum_spacing is {spacing}, got {', '.join(near)}")
        return found

    def cost_of(self, times: Iterable[int]) -> int:
        """Give what a set costs, in the unit of `cost`; its size where times are counted."""
        return sum(self.cost[time] if self.cost else 1 for time in times)

    def affordable(self, times: Iterable[int]) -> list[int]:
        """Give the optional times that may be together with these and the required ones."""
        kept = self.with_required(times)
        left = self.total - self.spent(kept)
        return [
            time
            for time in (self.optional if left > 0 else ())
            if self.price[time] <= left and self.distance(time, kept) >= self.minimum_spacing
        ]

    def distance(self, time: int, times: Times) -> int:
        """Give the distance to the nearest of these times; if there are none, it is far enough."""
        place = bisect_left(times, time)
        beside = times[max(0, place - 1) : place + 1]
        return min(
            (abs(time - neighbour) for neighbour in beside),
            default=self.horizon + self.minimum_spacing,
        )

    def room(self, times: Iterable[int]) -> int:
        """How many times may be together if these and the required ones, which may, are."""
        kept = self.with_required(times)
        return len(kept) + sum(self.room_between(a, b) for a, b in pairwise(self.with_ends(kept)))

    def with_ends(self, times: Times) -> Times:
        """Give these times between two that are just too early and too late to be in their way."""
        return (-self.minimum_spacing, *times, self.horizon + self.minimum_spacing)

    def room_between(self, a: int, b: int) -> int:
        """How many times may be together between two that they may be together with."""
        if (a, b) not in self._rooms:
            self._rooms[a, b] = len(self.packed(a, b, self.allowed))
        return self._rooms[a, b]

    def packed(self, a: int, b: int, among: Times) -> Times:
        """Give as many of some allowed times as may be together between two.

        Each is the earliest that may follow the one before it.
        """
        found: list[int] = []
        place = bisect_left(among, a + self.minimum_spacing)
        while place < len(among) and among[place] <= b - self.minimum_spacing:
            found.append(among[place])
            place = bisect_left(among, among[place] + self.minimum_spacing)
        return tuple(found)

    @cached_property
    def _unit(self) -> int:
        """The largest unit of money in which all costs are whole."""
        return gcd(*(self.cost or (1,)))

    @cached_property
    def _rooms(self) -> dict[tuple[int, int], int]:
        return {}

    @cached_property
    def _allowed(self) -> frozenset[int]:
        return frozenset(self.allowed)

    def _check_times(self) -> None:
        for name in ("forbidden", "required"):
            outside = [time for time in getattr(self, name) if not 0 <= time <= self.horizon]
            if outside:
                raise MeasurementTimesError(
                    f"problem.{name} must lie in 0..{self.horizon}, got {outside[0]}"
                )
        both = {*self.forbidden} & {*self.required}
        if both:
            raise MeasurementTimesError(
                "problem.forbidden and problem.required must have no time in common, "
                f"got {min(both)} in both"
            )
        for one, other in pairwise(self.required):
            if other - one < self.minimum_spacing:
                raise MeasurementTimesError(
                    "problem.required must have times that differ by at least "
                    f"problem.minimum_spacing = {self.minimum_spacing}, got {one} and {other}"
                )

    def _check_what_is_paid_for(self) -> None:
        given = (self.measurement_budget, self.cost, self.total_cost)
        if given == (None, None, None):
            raise MeasurementTimesError(
                "problem.measurement_budget must be given, or problem.cost and problem.total_cost"
            )
        if self.counted and given[1:] != (None, None):
            name = "cost" if self.total_cost is None else "total_cost"
            raise MeasurementTimesError(
                f"problem must have a measurement_budget or a total_cost, got measurement_budget "
                f"and {name}"
            )
        if None in given[1:] and not self.counted:
            got, lacks = ("cost", "total_cost") if self.cost is not None else ("total_cost", "cost")
            raise MeasurementTimesError(f"problem.{lacks} must be given where problem.{got} is")
        if self.cost is not None and len(self.cost) != self.horizon + 1:
            raise MeasurementTimesError(
                f"problem.cost must have horizon + 1 = {self.horizon + 1} numbers, "
                f"got {len(self.cost)}"
            )
        if self.cost is not None and min(self.cost) < 1:
            raise MeasurementTimesError(f"problem.cost must be at least 1, got {min(self.cost)}")

    def _check_that_there_is_one(self) -> None:
        if self.measurement_budget is None:
            self._check_money()
            return
        budget, instants = self.measurement_budget, self.horizon + 1
        if budget > instants:
            raise MeasurementTimesError(
                f"problem.measurement_budget must be at most horizon + 1 = {instants}, got {budget}"
            )
        if budget < len(self.required):
            raise MeasurementTimesError(
                f"problem.measurement_budget must be at least {len(self.required)}, the number of "
                f"problem.required, got {budget}"
            )
        room = self.room(())
        if budget > room:
            raise MeasurementTimesError(
                f"problem.measurement_budget must be at most {room}, for as many times are neither "
                f"forbidden nor nearer than minimum_spacing = {self.minimum_spacing}, got {budget}"
            )

    def _check_money(self) -> None:
        unit, money = self._unit, self.total_cost or 0
        required = self.spent(self.required) * unit
        if money < required:
            raise MeasurementTimesError(
                f"problem.total_cost must pay for problem.required, which costs {required}, "
                f"got {money}"
            )
        if not self.allowed:
            raise MeasurementTimesError("problem.forbidden must leave a time, got all")
        least = min(self.price[time] for time in self.allowed) * unit
        if money < least:
            raise MeasurementTimesError(
                f"problem.total_cost must pay for a measurement, of which the cheapest costs "
                f"{least}, got {money}"
            )
        if self.total > _MOST_UNITS:
            raise MeasurementTimesError(
                f"problem.total_cost must be at most {_MOST_UNITS:,} times the largest unit in "
                f"which every cost is whole, {unit}, got {money}: give costs in larger units"
            )
