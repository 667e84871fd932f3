"""Prices and limits of several measurements together: of sensors, visits, installations, groups.

`Constraints`, searches and the bound loop over all that a job has, and know none of them by name.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from decimal import Decimal
from itertools import chain, pairwise
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Self

from pfdist.common.measurement_times import Times
from pfdist.problem.points import Points
from pfdist.problem.spacing import Spacing

if TYPE_CHECKING:
    from pfdist.problem.even_sets import EvenSets
    from pfdist.problem.feasible import Feasible

Money = int | Decimal
"""A price, exactly as the user has written it."""


def money(number: float) -> Money:
    """A price as an exact fraction: 0.1 is one tenth, not the binary value of the float."""
    return number if isinstance(number, int) else Decimal(repr(number))


@dataclass(frozen=True)
class Setup:
    """A visit, or another thing that a measurement begins and later ones share.

    The next measurement that needs it, and is not before its end, begins another one.

    >>> Setup((3, 4, 5, 6, 7, 8)).firsts((0, 2, 4))
    (0, 4)
    """

    # (points,): the first point after what begins at each point; these never decrease. 0 at points
    # that do not need it
    ends: tuple[int, ...]
    price: Money = 0
    most: int | None = None
    open_until: int = 0  # points before this one share what has begun
    key: str = ""  # of the job, that gives the largest number
    things: str = "measurements"  # what is counted

    def firsts(self, times: Iterable[int]) -> Times:
        """The sorted times that begin it."""
        firsts, end = list[int](), self.open_until
        for time in times:
            if self.ends[time] and time >= end:
                firsts.append(time)
                end = self.ends[time]
        return tuple(firsts)

    def number(self, times: Iterable[int]) -> int:
        """How often some sorted times begin it."""
        return len(self.firsts(times))

    def end(self, times: Iterable[int]) -> int:
        """The first point after what the last of some sorted times share."""
        firsts = self.firsts(times)
        return self.ends[firsts[-1]] if firsts else self.open_until

    def beyond(self, times: Times) -> Iterator[int]:
        """The points that would begin it once too often after some sorted times."""
        if self.most is not None and self.number(times) >= self.most:
            yield from (p for p in range(self.end(times), len(self.ends)) if self.ends[p])

    def since(self, first: int, taken: Times) -> Self:
        """The same from a point on, after some measurements; points count from there."""
        most = None if self.most is None else max(0, self.most - self.number(taken))
        ends = tuple(end and end - first for end in self.ends[first:])
        return replace(self, ends=ends, most=most, open_until=max(0, self.end(taken) - first))


@dataclass(frozen=True)
class Shared:
    """Prices and limits that measurements share; forms of it overwrite what they have."""

    setups: tuple[Setup, ...] = field(default=(), kw_only=True)

    @property
    def relaxed(self) -> tuple[str, ...]:
        """The limits that the bound relaxes, as a sentence calls them."""
        return ()

    @property
    def priced(self) -> str:
        """The key of the job that gives prices of setups."""
        return ""

    def broken(self, points: Points, times: Times) -> Iterator[str]:
        """A sentence for each limit that some sorted times break."""
        for each in self.setups:
            if each.most is not None and (number := each.number(times)) > each.most:
                yield f"{each.key} is {each.most}, got {number} {each.things}"

    def beyond(self, points: Points, times: Times) -> Iterable[int]:
        """The points that break a limit if they follow some sorted times."""
        return chain.from_iterable(each.beyond(times) for each in self.setups)

    def since(self, first: int, taken: Times) -> Self | None:
        """The same from a point on, after some measurements; None if nothing of it is left."""
        return replace(self, setups=tuple(each.since(first, taken) for each in self.setups))

    def steps(self, points: Points) -> dict[str, Any]:
        """Its fields of `StepLimits`."""
        return {}

    is_exact: ClassVar[bool] = False
    """Whether sets can have exactly N measurements; then `fitting` finds the measurements."""

    def fitting(self, points: Points, times: Times, among: Times) -> Times:
        """A largest subset of some points that fits beside sorted times; all are sorted."""
        return among

    # --- measurements that belong together --------------------------------------------------------

    spaced: ClassVar[str] = ""
    """Sentences call all that evenly spaced sets space so; empty if it is measurements."""

    def parts(self, times: Times) -> list[Times]:
        """The sorted times that belong together: searches move and keep them together."""
        return []

    def in_words(self, points: Points, times: Times) -> str:
        """When a set measures, by its parts; empty without them."""
        return ""

    def regular(self, feasible: "Feasible") -> Times | None:
        """The regular set, if parts are spaced."""
        return None

    def even_sets(self, feasible: "Feasible") -> "EvenSets | None":
        """The evenly spaced sets, if parts are spaced."""
        return None


class Limit(NamedTuple):
    """Constraints on the measurements of one sensor."""

    most: int | None = None  # the largest number of its measurements in a set
    spacing: Spacing | None = None  # which instants are far enough apart for it


@dataclass(frozen=True)
class OfSensors(Shared):
    """The largest number of measurements of each sensor, and their spacing."""

    spacings: tuple[Spacing | None, ...]
    is_exact: ClassVar[bool] = True

    @classmethod
    def on(cls, points: Points, limits: Sequence[Limit]) -> Self:
        """The limits of each sensor."""
        every = range(points.number)
        setups = tuple(
            Setup(
                tuple((point + 1) * (points.way(point) == way) for point in every),
                most=limit.most,
                key=f"sensors.{points.sensor(way)}.most",
            )
            for way, limit in enumerate(limits)
            if limit.most is not None
        )
        return cls(tuple(limit.spacing for limit in limits), setups=setups)

    @property
    def relaxed(self) -> tuple[str, ...]:
        """The limits that the bound relaxes."""
        spaced = ("minimum_spacing of single sensors",) * any(self.spacings)
        return (*spaced, *("most of single sensors",) * bool(self.setups))

    def broken(self, points: Points, times: Times) -> Iterator[str]:
        """A sentence for each limit that some sorted times break."""
        yield from super().broken(points, times)
        for way, spacing in enumerate(self.spacings):
            if spacing is not None and not spacing.allows(points.of_way(way, times)):
                yield f"sensors.{points.sensor(way)}.minimum_spacing is broken"

    def beyond(self, points: Points, times: Times) -> Iterator[int]:
        """The points that break a limit if they follow some sorted times."""
        yield from super().beyond(points, times)
        for way, spacing in enumerate(self.spacings):
            own = points.of_way(way, times)
            if spacing is not None and own:
                yield from points.alike(way)[own[-1] : spacing.after(own[-1])]

    def since(self, first: int, taken: Times) -> Self:
        """The same from a point on, after some measurements; points count from there."""
        instant = first // len(self.spacings)
        spacings = tuple(each and each.since(instant) for each in self.spacings)
        setups = tuple(each.since(first, taken) for each in self.setups)
        return replace(self, setups=setups, spacings=spacings)

    def steps(self, points: Points) -> dict[str, Any]:
        """The largest number of each sensor, and its first instants after each."""
        most = (
            next((each.most or 0 for each in self.setups if each.ends[way]), points.number)
            for way in range(points.ways)
        )
        never = (0,) * len(points.clock.times)
        apart = tuple(each.successors if each else never for each in self.spacings)
        return {
            "most": tuple(most) if self.setups else (),
            "own_apart": apart if any(self.spacings) else (),
        }

    def fitting(self, points: Points, times: Times, among: Times) -> Times:
        """A largest subset of some points that fits beside sorted times; all are sorted.

        Sensors do not depend on each other, because these limits exclude a common spacing.
        """
        chosen = list[int]()
        for way, spacing in enumerate(self.spacings):
            own = spacing or Spacing.constant(1, points.clock.horizon)
            new = own.fitting(points.of_way(way, times), points.of_way(way, among))
            for each in self.setups:
                left = (each.most or 0) - each.number(times)
                new = new[: max(0, left)] if each.ends[way] else new
            chosen += [points.alike(way)[t] for t in new]
        return tuple(sorted(chosen))


@dataclass(frozen=True)
class Together(Shared):
    """Groups of sensors, of which at most one measures at an instant."""

    groups: tuple[tuple[Times, ...], ...]  # each with its sensors, and these with their ways

    @property
    def relaxed(self) -> tuple[str, ...]:
        """The limit that the bound relaxes."""
        return ("together",)

    def broken(self, points: Points, times: Times) -> Iterator[str]:
        """A sentence for each two sensors of a group that measure at an instant."""
        for group in self.groups:
            sensors = {way: number for number, ways in enumerate(group) for way in ways}
            of_group = [time for time in times if points.way(time) in sensors]
            for time, later in pairwise(of_group):
                is_same = sensors[points.way(time)] == sensors[points.way(later)]
                if points.instant(time) == points.instant(later) and not is_same:
                    yield f"sensors.{points.sensor(time)}.together is broken"

    def beyond(self, points: Points, times: Times) -> Iterator[int]:
        """The points of the last instant whose sensors exclude one that measures there."""
        for group in self.groups if times else ():
            instant = points.at(points.instant(times[-1]))
            for ways in group:
                if any(points.way(time) in ways for time in instant if time in times):
                    others = {*chain.from_iterable(group)} - {*ways}
                    yield from (time for time in instant if points.way(time) in others)

    def steps(self, points: Points) -> dict[str, Any]:
        """The number of each sensor's group."""
        group = {
            way: number
            for number, sensors in enumerate(self.groups, 1)
            for way in chain.from_iterable(sensors)
        }
        return {"group": tuple(group.get(way, 0) for way in range(points.ways))}
