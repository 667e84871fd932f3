"""The numbers of possible measurements, the points: instant by instant, and at each one way by way.

A way to measure is a sensor. Without sensors there is one way, and a point is its instant.
`pfdist.problem.points` has the table of the points of a job.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times

ALONE = "y"
"""The name of the only way to measure, of a model without sensors."""

Numbers = TypeVar("Numbers", int, NDArray[np.int64])


@dataclass(frozen=True)
class PointNumbers:
    """The numbers of points if there are some ways to measure at each instant.

    >>> points = PointNumbers(ways=2)
    >>> points.instant(7), points.way(7), points.first(3), [*points.at(3)]
    (3, 1, 6, [6, 7])
    >>> points.instants((0, 1, 6)), points.of_way(0, (0, 1, 6))
    ((0, 3), (0, 3))
    """

    ways: int = 1

    def instant(self, point: Numbers) -> Numbers:
        """The instant of a point, or of each point of an array."""
        return point // self.ways

    def way(self, point: int) -> int:
        """The number of the way in which a point measures."""
        return point % self.ways

    def first(self, instant: int) -> int:
        """The first point at or after an instant."""
        return instant * self.ways

    def at(self, instant: int) -> range:
        """The points at an instant, in the order of the ways."""
        return range(instant * self.ways, (instant + 1) * self.ways)

    def instants(self, points: Iterable[int]) -> Times:
        """The instants of some points, sorted and each once."""
        return tuple(sorted({point // self.ways for point in points}))

    def of_way(self, way: int, points: Iterable[int]) -> Times:
        """The instants of those points that measure in one way."""
        return tuple(point // self.ways for point in points if point % self.ways == way)
