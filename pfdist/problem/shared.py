"""Prices and limits that several measurements of a set share; visits and installations are others.

`Constraints` adds up the prices and asks for the limits of all that a job has, and knows none of
them by name.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from decimal import Decimal
from itertools import chain, pairwise
from typing import Any, Self

from pfdist.common.measurement_times import Times
from pfdist.problem.points import Points

Money = int | Decimal
"""A price, exactly as the user has written it."""


def money(number: float) -> Money:
    """A price as an exact fraction: 0.1 is one tenth, not the binary value of the float."""
    return number if isinstance(number, int) else Decimal(repr(number))


@dataclass(frozen=True)
class Shared:
    """Prices and limits that measurements share; forms of it overwrite what they have."""

    @property
    def fees(self) -> dict[str, tuple[Money, ...]]:
        """The prices, by the key of the job that gives them; none if nothing is paid."""
        return {}

    @property
    def relaxed(self) -> str:
        """The limit that the bound relaxes, as a sentence calls it; empty: none."""
        return ""

    def counts(self, points: Points, times: Times) -> Iterable[int]:
        """How often some sorted times pay each of the prices."""
        return ()

    def broken(self, points: Points, times: Times) -> Iterator[str]:
        """A sentence for each limit that some sorted times break."""
        return iter(())

    def beyond(self, points: Points, times: Times) -> Iterable[int]:
        """The points that break a limit if they follow some sorted times."""
        return ()

    def since(self, points: Points, first: int, taken: Times) -> Self | None:
        """The same from a point on, after some measurements; None if nothing of it is left."""
        return self

    def steps(self, points: Points) -> dict[str, Any]:
        """Its fields of `StepLimits`."""
        return {}


@dataclass(frozen=True)
class Together(Shared):
    """Groups of sensors, of which at most one measures at an instant."""

    groups: tuple[tuple[Times, ...], ...]  # each with its sensors, and these with their ways

    @property
    def relaxed(self) -> str:
        """The limit that the bound relaxes."""
        return "together"

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
