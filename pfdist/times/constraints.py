"""Constraints on a set of measurement times: which times, how many or at what cost, how far apart.

Every error and every sentence begins with the name of the value that is wrong, so that a caller
can say where the value came from: ``forbidden must lie in 0..60, got 61``.
"""

from bisect import bisect_left
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import gcd

from pfdist.errors import MeasurementTimesError
from pfdist.times.measurement_times import Times

_MOST_UNITS = 10_000  # of money; the memory of the searches grows with their number


@dataclass(frozen=True)
class Constraints:
    """The constraints on a set of N times in 0..T, or of as many times as a sum of money buys.

    Parameters
    ----------
    horizon : int
        T.
    measurement_budget : int, optional
        N.
    forbidden, required : tuple of int
        Times that no set may contain, and times that every set must contain. Sorted.
    minimum_spacing : int
        Smallest allowed difference of two times of a set.
    cost : tuple of int, (T+1,), optional
        Cost of a measurement at each time, at least 1, in whole units.
    total_cost : int, optional
        Largest allowed cost of all measurements together. It is given with `cost`, and replaces
        `measurement_budget`.

    Raises
    ------
    MeasurementTimesError
        The constraints contradict each other, or no set satisfies them. The message begins with
        the name of the wrong parameter.
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
        self._check_budget_or_cost()
        self._check_that_a_set_exists()

    @property
    def counted(self) -> bool:
        """Whether the number of measurements is given, and not their total cost."""
        return self.measurement_budget is not None

    @cached_property
    def allowed(self) -> Times:
        """Times that a set may contain: neither forbidden nor too near to a required time."""
        barred = {*self.forbidden}
        for time in self.required:
            near = range(time - self.minimum_spacing + 1, time + self.minimum_spacing)
            barred.update({*near} - {time})
        return tuple(time for time in range(self.horizon + 1) if time not in barred)

    @cached_property
    def index(self) -> dict[int, int]:
        """Index of each time in `allowed`."""
        return {time: index for index, time in enumerate(self.allowed)}

    @cached_property
    def optional(self) -> Times:
        """Allowed times that are not required."""
        return tuple(time for time in self.allowed if time not in self.required)

    @cached_property
    def price(self) -> tuple[int, ...]:
        """Price of a measurement at each time, in units of `total`; 1 if times are counted."""
        return tuple(cost // self._unit for cost in self.cost or (1,) * (self.horizon + 1))

    @cached_property
    def total(self) -> int:
        """The sum to spend: N, or money in the largest unit in which all costs are whole."""
        if self.measurement_budget is not None:
            return self.measurement_budget
        return min((self.total_cost or 0) // self._unit, self.spent(self.allowed))

    def spent(self, times: Iterable[int]) -> int:
        """Give the sum of the prices of some times."""
        return sum(self.price[time] for time in times)

    def with_required(self, times: Iterable[int]) -> Times:
        """Give these times and the required times, sorted."""
        return tuple(sorted({*times, *self.required}))

    def compatible(self, times: Times) -> bool:
        """Whether these sorted times are allowed and far enough apart."""
        near = any(later - time < self.minimum_spacing for time, later in pairwise(times))
        return not near and self._allowed.issuperset(times)

    def allows(self, times: Iterable[int]) -> bool:
        """Whether these and the required times are compatible and can be paid for."""
        kept = self.with_required(times)
        return self.spent(kept) <= self.total and self.compatible(kept)

    def broken(self, times: Iterable[int]) -> list[str]:
        """Give the constraints that a set of times in 0..T breaks, one sentence each.

        Parameters
        ----------
        times : iterable of int

        Returns
        -------
        list of str
            Each begins with the name of the constraint. Empty if the set satisfies all of them.
            A set may leave money over.

        Examples
        --------
        >>> Constraints(horizon=9, measurement_budget=2, forbidden=(4,)).broken([1, 4, 9])
        ['measurement_budget is 2, got 3 times', 'forbidden: 4 is measured']
        """
        chosen = sorted({*times})
        found, cost = list[str](), self.cost_of(chosen)
        if self.measurement_budget not in (None, len(chosen)):
            found.append(
                f"measurement_budget is {self.measurement_budget}, got {len(chosen)} times"
            )
        if self.total_cost is not None and cost > self.total_cost:
            found.append(f"total_cost is {self.total_cost}, got times that cost {cost}")
        forbidden = [time for time in chosen if time in self.forbidden]
        missing = [time for time in self.required if time not in chosen]
        for name, wrong, is_ in (("forbidden", forbidden, ""), ("required", missing, "not ")):
            if wrong:
                verb = "is" if len(wrong) == 1 else "are"
                listed = ", ".join(map(str, wrong))
                found.append(f"{name}: {listed} {verb} {is_}measured")
        spacing = self.minimum_spacing
        near = [f"{time} and {later}" for time, later in pairwise(chosen) if later - time < spacing]
        if near:
            found.append(f"minimum_spacing is {spacing}, got {', '.join(near)}")
        return found

    def cost_of(self, times: Iterable[int]) -> int:
        """Give the cost of a set, in the unit of `cost`; its size if times are counted."""
        return sum(self.cost[time] if self.cost else 1 for time in times)

    def affordable(self, times: Iterable[int]) -> list[int]:
        """Give the optional times that could still be added to these and the required times."""
        kept = self.with_required(times)
        left = self.total - self.spent(kept)
        return [
            time
            for time in (self.optional if left > 0 else ())
            if self.price[time] <= left and self.distance(time, kept) >= self.minimum_spacing
        ]

    def distance(self, time: int, times: Times) -> int:
        """Give the distance to the nearest of these times; if there are none, it is far enough."""
        index = bisect_left(times, time)
        neighbours = times[max(0, index - 1) : index + 1]
        return min(
            (abs(time - neighbour) for neighbour in neighbours),
            default=self.horizon + self.minimum_spacing,
        )

    def capacity(self, times: Iterable[int]) -> int:
        """Give the largest number of compatible times that contain these and the required times."""
        kept = self.with_required(times)
        gaps = pairwise(self.with_ends(kept))
        return len(kept) + sum(self.capacity_between(first, last) for first, last in gaps)

    def with_ends(self, times: Times) -> Times:
        """Give these times between two others, which lie just early and just late enough."""
        return (-self.minimum_spacing, *times, self.horizon + self.minimum_spacing)

    def capacity_between(self, first: int, last: int) -> int:
        """Give the largest number of compatible times that fit between two times."""
        if (first, last) not in self._capacities:
            self._capacities[first, last] = len(self.packed(first, last, self.allowed))
        return self._capacities[first, last]

    def packed(self, first: int, last: int, among: Times) -> Times:
        """Give as many of some allowed times as fit between two times, each as early as can be."""
        found: list[int] = []
        index = bisect_left(among, first + self.minimum_spacing)
        while index < len(among) and among[index] <= last - self.minimum_spacing:
            found.append(among[index])
            index = bisect_left(among, among[index] + self.minimum_spacing)
        return tuple(found)

    @cached_property
    def _unit(self) -> int:
        """The largest unit of money in which all costs are whole."""
        return gcd(*(self.cost or (1,)))

    @cached_property
    def _capacities(self) -> dict[tuple[int, int], int]:
        """Results of `capacity_between`."""
        return {}

    @cached_property
    def _allowed(self) -> frozenset[int]:
        return frozenset(self.allowed)

    def _check_times(self) -> None:
        for name in ("forbidden", "required"):
            outside = [time for time in getattr(self, name) if not 0 <= time <= self.horizon]
            if outside:
                raise MeasurementTimesError(
                    f"{name} must lie in 0..{self.horizon}, got {outside[0]}"
                )
        both = {*self.forbidden} & {*self.required}
        if both:
            raise MeasurementTimesError(
                f"forbidden and required must have no time in common, got {min(both)} in both"
            )
        for time, later in pairwise(self.required):
            if later - time < self.minimum_spacing:
                raise MeasurementTimesError(
                    "required must have times that differ by at least minimum_spacing = "
                    f"{self.minimum_spacing}, got {time} and {later}"
                )

    def _check_budget_or_cost(self) -> None:
        given = (self.measurement_budget, self.cost, self.total_cost)
        if given == (None, None, None):
            raise MeasurementTimesError(
                "measurement_budget must be given, or cost and total_cost in its place"
            )
        if self.counted and given[1:] != (None, None):
            name = "cost" if self.total_cost is None else "total_cost"
            raise MeasurementTimesError(
                "measurement_budget must be given without cost and total_cost, "
                f"got measurement_budget and {name}"
            )
        if None in given[1:] and not self.counted:
            got, lacks = ("cost", "total_cost") if self.cost is not None else ("total_cost", "cost")
            raise MeasurementTimesError(f"{lacks} must be given with {got}")
        if self.cost is not None and len(self.cost) != self.horizon + 1:
            raise MeasurementTimesError(
                f"cost must have horizon + 1 = {self.horizon + 1} numbers, got {len(self.cost)}"
            )
        if self.cost is not None and min(self.cost) < 1:
            raise MeasurementTimesError(f"cost must be at least 1, got {min(self.cost)}")

    def _check_that_a_set_exists(self) -> None:
        if self.measurement_budget is None:
            self._check_money()
            return
        budget, instants = self.measurement_budget, self.horizon + 1
        if budget > instants:
            raise MeasurementTimesError(
                f"measurement_budget must be at most horizon + 1 = {instants}, got {budget}"
            )
        if budget < len(self.required):
            raise MeasurementTimesError(
                f"measurement_budget must be at least {len(self.required)}, the number of required "
                f"times, got {budget}"
            )
        capacity = self.capacity(())
        if budget > capacity:
            raise MeasurementTimesError(
                f"measurement_budget must be at most {capacity}, the number of times that fit with "
                f"forbidden, required and minimum_spacing = {self.minimum_spacing}, got {budget}"
            )

    def _check_money(self) -> None:
        unit, money = self._unit, self.total_cost or 0
        required = self.spent(self.required) * unit
        if money < required:
            raise MeasurementTimesError(
                f"total_cost must pay for the required times, which cost {required}, got {money}"
            )
        if not self.allowed:
            raise MeasurementTimesError("forbidden must leave a time, got all times")
        least = min(self.price[time] for time in self.allowed) * unit
        if money < least:
            raise MeasurementTimesError(
                f"total_cost must pay for a measurement, and the cheapest costs {least}, "
                f"got {money}"
            )
        if self.total > _MOST_UNITS:
            raise MeasurementTimesError(
                f"total_cost must be at most {_MOST_UNITS:,} times the largest unit in which every "
                f"cost is whole, {unit}, got {money}: give costs in larger units"
            )
