"""Constraints on a set of measurement times: allowed times, number or price, and spacing.

`check` finds constraints that contradict each other, or that no set satisfies. Every message begins
with the name of the wrong value, so that a caller can put its place before it: ``forbidden must lie
in 0..60, got 61``.
"""

from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import chain, pairwise
from math import gcd, lcm

from pfdist.common.measurement_times import Times
from pfdist.common.rounding import unrounded
from pfdist.constraints.kinds import PlainStep
from pfdist.constraints.setup import Setup
from pfdist.constraints.spacing import Spacing
from pfdist.constraints.step import Money, Step, Walk
from pfdist.errors import MeasurementTimesError
from pfdist.kernels.follows import StepLimits
from pfdist.kernels.left import Left
from pfdist.problem.clock import Clock
from pfdist.problem.points import Points
from pfdist.problem.shared import Shared


@dataclass(frozen=True)
class Constraints:
    """The constraints on a set of N times in 0..T, or on a set that a total price pays for.

    A time is a point of the table `points`: with sensors there are several at an instant.

    The constructor does not check them; `Feasible` does, by `check`.
    """

    horizon: int
    measurement_budget: int | None = None  # N
    forbidden: Times = ()  # times that no set may contain, sorted
    required: Times = ()  # times that every set must contain, sorted
    # smallest difference of two times of a set: instants, or time on the clock
    minimum_spacing: int | float = 1
    # price of a measurement at each point, above 0
    price: tuple[Money, ...] | None = None
    # largest price of all measurements together; given with `price`, in place of N
    total_price: Money | None = None
    points: Points = None  # type: ignore[assignment]  # by default instants are counted
    cheapest: int = 0  # number of the sensor that measures at regular times
    shared: tuple[Shared, ...] = ()  # prices and limits of several measurements together
    made: Times = ()  # required ones that were made before: their steps were taken
    # Whether N or the money is only the most that may be spent, even nothing. One more measurement
    # does no harm, in expectation, to a filter that knows the truth, so a best set spends what it
    # can. To a filter that is wrong it may do harm; and under limits nothing may be left to buy.
    smaller: bool = False

    def __post_init__(self) -> None:
        if self.points is None:
            object.__setattr__(self, "points", Points(Clock.counting(self.horizon)))

    @property
    def counted(self) -> bool:
        """Whether every set has the same number of measurements."""
        return self.measurement_budget is not None and not self.smaller

    @property
    def has_fewer(self) -> bool:
        """Whether N is the largest number of measurements of a set."""
        return self.measurement_budget is not None and self.smaller

    @cached_property
    def spacing(self) -> Spacing:
        """The spacing of times; 0 allows several measurements at one instant."""
        if not self.minimum_spacing:
            return Spacing.constant(1, self.possible - 1)
        return Spacing(self.points.successors(self.minimum_spacing))

    @cached_property
    def steps(self) -> tuple[Step, ...]:
        """All constraints but allowed times, number, price, and the spacing of all."""
        return tuple(chain.from_iterable(each.steps for each in self.shared))

    @cached_property
    def setups(self) -> tuple[Setup, ...]:
        """All that has a price beside those of measurements, or a largest number.

        If measurements are not made in the order of points, without those whose order matters.
        """
        every = chain.from_iterable(each.setups for each in self.shared)
        return tuple(each for each in every if self.points.is_in_order or not each.in_order)

    @cached_property
    def most(self) -> dict[int, int]:
        """The largest numbers, by the place in `setups`."""
        return {k: each.left for k, each in enumerate(self.setups) if each.left is not None}

    @property
    def spaced(self) -> str:
        """The name of all that regular sets space; empty if it is measurements."""
        return "".join(each.spaced for each in self.shared)

    @property
    def relaxed(self) -> tuple[str, ...]:
        """The constraints that the bound relaxes, so that it may be lower than necessary."""
        is_in_order = self.points.is_in_order
        each = (step.relaxed(is_in_order=is_in_order) for step in self.steps)
        return tuple(dict.fromkeys(filter(None, each)))

    @property
    def possible(self) -> int:
        """The number of possible measurements."""
        return self.points.number

    @cached_property
    def allowed(self) -> Times:
        """Times that a set may contain: neither forbidden nor too near to a required time."""
        barred = {*self.forbidden} | (self.spacing.near(self.required) - {*self.required})
        return tuple(time for time in range(self.possible) if time not in barred)

    @cached_property
    def index(self) -> dict[int, int]:
        """Index of each time in `allowed`."""
        return {time: index for index, time in enumerate(self.allowed)}

    @cached_property
    def optional(self) -> Times:
        """The allowed times that are not required."""
        return tuple(time for time in self.allowed if time not in self.required)

    @cached_property
    def units(self) -> tuple[int, ...]:
        """Price of each possible measurement, in the unit of `total`; 1 if times are counted."""
        return tuple(map(self.in_units, self.price or (1,) * self.possible))

    def in_units(self, price: Money) -> int:
        """A price in the unit of `total`."""
        return int(Fraction(price) / self.unit)

    @cached_property
    def total(self) -> int:
        """The sum to spend: N, or the money in the largest unit in which all prices are whole.

        A total price is capped at the price of all allowed times.
        """
        if self.measurement_budget is not None:
            return self.measurement_budget
        affordable = Fraction(self.total_price or 0) // self.unit
        return min(affordable, self.spent(self.allowed))

    def spent(self, times: Iterable[int]) -> int:
        """The price of some sorted times, and of what they share, in units."""
        return self._spent(chosen := tuple(times), self._walk(chosen))

    def _spent(self, chosen: Times, walks: Sequence[Walk]) -> int:
        fees = sum(fee * walks[place].pays for place, fee in self._fees)
        return sum(self.units[time] for time in chosen) + fees

    @cached_property
    def _fees(self) -> list[tuple[int, int]]:
        """Places in `steps` that have a price, and this price in units."""
        fees = enumerate(each.fee for each in self.steps)
        return [(place, self.in_units(fee)) for place, fee in fees if fee]

    def _walk(self, times: Times) -> list[Walk]:
        """Go through sorted times by each step."""
        if not self.steps:
            return []
        if self.made:
            times = tuple(time for time in times if time not in self.made)
        made = self.points.made_in_order(times)
        return [step.walk(made) for step in self.steps]

    def steps_since(self, shared: Shared, first: int, made: Iterable[int]) -> tuple[Step, ...]:
        """The steps of a limit from a point on, after measurements; points count from there."""
        new = self.points.made_in_order(tuple(sorted({*made} - {*self.made})))
        return tuple(step.since(first, new) for step in shared.steps)

    def with_required(self, times: Iterable[int]) -> Times:
        """These times and the required times, sorted."""
        return tuple(sorted({*times, *self.required}))

    def compatible(self, times: Times) -> bool:
        """Whether these sorted times are allowed and far enough apart."""
        return self._are_allowed(times) and self.is_within_limits(times)

    def _are_allowed(self, times: Times) -> bool:
        return self.spacing.allows(times) and self._allowed.issuperset(times)

    def is_within_limits(self, times: Iterable[int]) -> bool:
        """Whether these sorted times satisfy the steps of all constraints."""
        return all(walk.broken is None for walk in self._walk(tuple(times)))

    def _beyond_limits(self, times: Iterable[int]) -> Iterator[str]:
        """Yield a sentence for each limit that these sorted times break."""
        for step, walk in zip(self.steps, self._walk(tuple(times)), strict=True):
            if walk.broken is not None:
                when, sensor = self.formatted(walk.broken), self.points.sensor(walk.broken)
                yield step.sentence(walk, when, sensor)

    def beyond_limits(self, sets: Iterable[Times]) -> Iterator[Times]:
        """For each of some sets, sorted, the points that break a limit if they follow its times."""
        points, steps = self.points, tuple(map(PlainStep.made_from, self.steps))
        limits, spare = StepLimits((), points.delays, (), steps), min(s.spare for s in self.steps)
        left = Left(limits, points.ways, (), self.horizon + 1, draws=self.possible)
        for times in sets:
            may_break = len(times) >= spare
            yield left.breaking(points.made_in_order(times).points) if may_break else ()

    def allows(self, times: Iterable[int]) -> bool:
        """Whether these and the required times are compatible and can be paid for."""
        complete = self.with_required(times)
        return self._are_allowed(complete) and self._fits(complete)

    def _fits(self, times: Times) -> bool:
        """Whether some sorted times satisfy the limits and can be paid for."""
        walks = self._walk(times)
        is_kept = all(walk.broken is None for walk in walks)
        return is_kept and self._spent(times, walks) <= self.total

    def moved(self, times: Times, t: int, to: int) -> Times | None:
        """The set with the measurement at t moved to another instant; None if that is not allowed.

        A required measurement never moves, and two measurements need two instants.

        >>> apart = Constraints(
        ...     horizon=9, measurement_budget=3, forbidden=(7,), minimum_spacing=2
        ... )
        >>> apart.moved((0, 4, 6), 4, 2), apart.moved((0, 4, 6), 6, 9)
        ((0, 2, 6), (0, 4, 9))
        >>> apart.moved((0, 4, 6), 4, 5), apart.moved((0, 4, 6), 6, 7)
        (None, None)
        """
        others = {*times} - {t}
        if to in others or to not in self.optional or t in self.required:
            return None
        changed = tuple(sorted(others | {to}))
        return changed if self.allows(changed) else None

    def broken(self, times: Iterable[int], *, fewer: bool = False) -> list[str]:
        """The constraints that a set of times in 0..T breaks, one sentence each.

        Each sentence begins with the name of the constraint. A set need not spend all of the money,
        and with `fewer` not all of the number of measurements.

        >>> Constraints(horizon=9, measurement_budget=2, forbidden=(4,)).broken([1, 4, 9])
        ['measurement_budget is 2, got 3 times', 'forbidden: 4 is measured']
        """
        chosen = sorted({*times})
        sentences, price = list[str](), self.price_of(chosen)
        budget = self.measurement_budget
        exactly = self.counted and not fewer
        if budget not in (None, len(chosen)) and (exactly or len(chosen) > budget):
            sentences.append(f"measurement_budget is {budget}, got {len(chosen)} times")
        if self.total_price is not None and price > self.total_price:
            sentences.append(f"total_price is {self.total_price}, got times with the price {price}")
        forbidden = [time for time in chosen if time in self.forbidden]
        missing = [time for time in self.required if time not in chosen]
        for name, wrong, is_ in (("forbidden", forbidden, ""), ("required", missing, "not ")):
            if wrong:
                verb = "is" if len(wrong) == 1 else "are"
                listed = ", ".join(map(self.formatted, wrong))
                sentences.append(f"{name}: {listed} {verb} {is_}measured")
        near = [
            f"{self.formatted(time)} and {self.formatted(later)}"
            for time, later in pairwise(chosen)
            if not self.spacing.allows((time, later))
        ]
        if near:
            sentences.append(f"minimum_spacing is {self.minimum_spacing}, got {', '.join(near)}")
        return [*sentences, *self._beyond_limits(chosen)]

    def price_of(self, times: Iterable[int]) -> Money:
        """The price of a set, in the unit of `price`; its size if times are counted."""
        chosen, prices = tuple(sorted({*times})), self.price or self.units
        paid: Money = sum(prices[time] for time in chosen)
        for step, walk in zip(self.steps, self._walk(chosen), strict=True):
            paid += step.fee * walk.pays
        return paid

    def affordable(self, times: Iterable[int]) -> list[int]:
        """The optional times that could still be added to these and the required times."""
        complete = self.with_required(times)
        left, near = self.total - self.spent(complete), self.spacing.near(complete)
        return [
            time
            for time in (self.optional if left > 0 else ())
            if self.units[time] <= left
            and time not in near
            and (not self.shared or self._fits(tuple(sorted({*complete, time}))))
        ]

    def distance(self, time: int, times: Times) -> int:
        """The distance to the nearest of these times in instants; T + 1 if there are none."""
        index, instant = bisect_left(times, time), self.points.instant(time)
        neighbours = self.points.instants(times[max(0, index - 1) : index + 1])
        distances = (abs(instant - neighbour) for neighbour in neighbours)
        return min(distances, default=self.horizon + 1)

    def formatted(self, time: int) -> str:
        """A time as the user reads it."""
        return unrounded(self.points.written(time))

    def capacity(self, times: Iterable[int]) -> int:
        """The largest number of compatible times that contain these and the required times."""
        complete = self.with_required(times)
        if self.shared:
            return len(complete) + len(self.fitting(complete, self.allowed))
        gaps = pairwise((-1, *complete, self.possible))  # every time is far from both ends
        return len(complete) + sum(self.capacity_between(first, last) for first, last in gaps)

    def capacity_between(self, first: int, last: int) -> int:
        """The largest number of compatible times that fit between two times."""
        if (first, last) not in self._capacities:
            self._capacities[first, last] = len(self.spacing.packed(first, last, self.allowed))
        return self._capacities[first, last]

    def fitting(self, times: Times, among: Times) -> Times:
        """A largest subset of some allowed times that fits beside these; all are sorted."""
        if not self.shared:
            return self.spacing.fitting(times, among)
        if self.made:  # the steps have taken them, and nothing too near is allowed
            times, among = (tuple(t for t in own if t not in self.made) for own in (times, among))
        for each in self.shared:
            among = each.fitting(self.points, times, among)
        return among

    @cached_property
    def unit(self) -> Fraction:
        """The largest unit of money in which all prices are whole."""
        fees = (each.fee for each in self.steps if each.fee)
        prices = [Fraction(price) for price in (*(self.price or (1,)), *fees)]
        parts = lcm(*(price.denominator for price in prices))
        return Fraction(gcd(*(int(price * parts) for price in prices)), parts)

    @cached_property
    def _capacities(self) -> dict[tuple[int, int], int]:
        """The results of `capacity_between`, by its arguments."""
        return {}

    @cached_property
    def _allowed(self) -> frozenset[int]:
        return frozenset(self.allowed)


# --- contradictions -------------------------------------------------------------------------------

_MOST_UNITS = 10_000  # of money; the memory of the searches grows with their number


def check_constraints(constraints: Constraints) -> None:
    """Raise an error if constraints contradict each other, or if no set satisfies them.

    The message of the `MeasurementTimesError` begins with the name of the wrong value.
    """
    _check_times(constraints)
    if not constraints.allowed:
        raise MeasurementTimesError("forbidden must leave a time, got all times")
    _check_limits(constraints)
    _check_budget_or_price(constraints)
    is_number = constraints.measurement_budget is not None
    (_check_number if is_number else _check_money)(constraints)


def _check_times(constraints: Constraints) -> None:
    """Refuse forbidden and required times that are outside, both, or too near to each other."""
    for name in ("forbidden", "required"):
        times, last = getattr(constraints, name), constraints.possible - 1
        outside = [time for time in times if not 0 <= time <= last]
        if outside:
            raise MeasurementTimesError(f"{name} must lie in 0..{last}, got {outside[0]}")
    both = {*constraints.forbidden} & {*constraints.required}
    if both:
        raise MeasurementTimesError(
            f"forbidden and required must have no time in common, got "
            f"{constraints.formatted(min(both))} in both"
        )
    for time, later in pairwise(constraints.required):
        if not constraints.spacing.allows((time, later)):
            raise MeasurementTimesError(
                "required must have times that differ by at least minimum_spacing = "
                f"{constraints.minimum_spacing}, got {constraints.formatted(time)} and "
                f"{constraints.formatted(later)}"
            )


def _check_limits(constraints: Constraints) -> None:
    """Refuse N measurements under limits and a spacing of all, and required times beyond limits.

    How many measurements fit beside others would depend on all sensors together. Money needs no
    such number, because it may be left over.
    """
    if constraints.shared and constraints.counted and not constraints.spacing.is_free:
        raise MeasurementTimesError(
            "minimum_spacing must be left out if a sensor has most or minimum_spacing, unless "
            f"total_price is given, got {constraints.minimum_spacing}: give each sensor its own"
        )
    if not constraints.is_within_limits(constraints.required):
        (sentence, *_) = constraints.broken(constraints.required, fewer=True)
        raise MeasurementTimesError(f"required must keep all limits: {sentence}")
    if constraints.steps and not any(
        constraints.is_within_limits(constraints.with_required((time,)))
        for time in constraints.allowed
    ):
        (sentence, *_) = constraints.broken(constraints.allowed[:1], fewer=True)
        raise MeasurementTimesError(f"{sentence}: no measurement is possible")


def _check_budget_or_price(constraints: Constraints) -> None:
    """Refuse a budget with prices, and prices without a sum, not above 0 or of a wrong number."""
    given = {
        name: getattr(constraints, name) is not None
        for name in ("measurement_budget", "price", "total_price")
    }
    if [*given.values()] not in ([True, False, False], [False, True, True]):
        got = " and ".join(name for name, is_given in given.items() if is_given) or "none of them"
        raise MeasurementTimesError(
            f"measurement_budget must be given, or instead price and total_price, got {got}"
        )
    price, instants = constraints.price, constraints.possible
    if price is not None and len(price) != instants:
        raise MeasurementTimesError(
            f"price needs {instants} values, one for each instant, got {len(price)}"
        )
    if price is not None and min(price) <= 0:
        raise MeasurementTimesError(
            f"price must be above 0, got {min(price)}: give what costs nothing a small price, and "
            "total_price as much more"
        )


def _check_number(constraints: Constraints) -> None:
    """Refuse a number of measurements that no set has."""
    budget, possible = constraints.total, constraints.possible
    if budget > possible:
        what = "instants" if constraints.points.ways == 1 else "possible measurements"
        raise MeasurementTimesError(
            f"measurement_budget must be at most the number of {what}, {possible}, got {budget}"
        )
    required = len(constraints.required)
    if budget < required:
        raise MeasurementTimesError(
            f"measurement_budget must be at least {required}, the number of required times, got "
            f"{budget}"
        )
    capacity = constraints.capacity(()) if constraints.counted else budget
    if budget > capacity:
        raise MeasurementTimesError(
            f"measurement_budget must be at most {capacity}, the number of times that fit with "
            f"forbidden, required and minimum_spacing = {constraints.minimum_spacing}, got {budget}"
        )


def _check_money(constraints: Constraints) -> None:
    """Refuse money that pays for no set, or that has too many units."""
    money, required = constraints.total_price or 0, constraints.price_of(constraints.required)
    if money < required:
        raise MeasurementTimesError(
            f"total_price must pay for the required times, whose price is {required}, got {money}"
        )
    least = min(constraints.price_of((time,)) for time in constraints.allowed)
    if money < least:
        raise MeasurementTimesError(
            f"total_price must pay for a measurement, and the cheapest has the price {least}, "
            f"got {money}"
        )
    if constraints.total > _MOST_UNITS:
        raise MeasurementTimesError(
            f"total_price must be at most {_MOST_UNITS:,} times the largest unit in which every "
            f"price is whole, {float(constraints.unit):.15g}, got {money}: give rounder prices"
        )
