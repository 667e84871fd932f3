"""The table of points: all possible measurements of a job, and their texts.

Everything inside names a possible measurement by its number. This module alone reads a text such as
``12 x-ray`` and writes it.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

from pfdist.common.arguments import listed_argument
from pfdist.common.measurement_times import Times, validated
from pfdist.common.parsing import as_text
from pfdist.common.points import ALONE, PointNumbers
from pfdist.constraints.step import Made
from pfdist.errors import MeasurementTimesError, shown
from pfdist.problem.calendar import groups
from pfdist.problem.clock import Clock, Time, joined_times
from pfdist.problem.written import SEPARATOR, instants_written


@dataclass(frozen=True)
class Points(PointNumbers):
    """The points of a clock: one at each instant, or one for each sensor.

    >>> points = Points(Clock.counting(3), ("ct", "x-ray"))
    >>> points.read("0 3 ct, 3 x-ray"), points.written(7), points.number
    ((0, 6, 7), '3 x-ray', 8)
    """

    ways: int = field(init=False)
    clock: Clock
    sensors: tuple[str, ...] = ()
    # (ways,): the number of instants after which a value arrives; then a point is that of the
    # arrival, and users read and write the time of the measurement
    delays: tuple[int, ...] = ()
    # (ways,): the way of the first repeat of the same sensor; by default none repeats
    repeats: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "ways", max(1, len(self.sensors)))

    @property
    def number(self) -> int:
        """The number of points."""
        return len(self.clock.times) * self.ways

    def alike(self, point: int) -> range:
        """All points of the same sensor, one at each instant."""
        return range(self.way(point), self.number, self.ways)

    def delay(self, way: int) -> int:
        """The number of instants after which a value arrives."""
        return self.delays[way] if self.delays else 0

    def made_at(self, point: int) -> int:
        """The instant at which a point is measured; below 0 if its value cannot have arrived."""
        return int(self.instant(point)) - self.delay(self.way(point))

    @cached_property
    def moments(self) -> list[int]:
        """The moment of each point; see `pfdist.constraints.step.Turn`."""
        late, every = max(self.delays, default=0), range(self.number)
        return [point + self.first(late - self.delay(self.way(point))) for point in every]

    def made_in_order(self, times: Times) -> Made:
        """Some sorted points, in the order in which they are measured."""
        order: Sequence[int] = times
        if not self.is_in_order:
            order = sorted(times, key=self.moments.__getitem__)
        moments = order if self.is_in_order else [self.moments[point] for point in order]
        ways = self.ways
        if ways == 1:
            late, sensors = self.delay(0), [0] * len(order)
            instants = [point - late for point in order] if late else order
        else:
            sensors = [point % ways for point in order]
            instants = [self.made_at(point) for point in order]
        return Made(order, moments, instants, sensors, ways)

    @property
    def is_in_order(self) -> bool:
        """Whether values arrive in the order in which they are measured."""
        return len({*self.delays}) < 2

    def alone(self, *ways: int) -> Times:
        """The ends of setups that each measurement, of some ways, begins for itself alone."""
        return tuple(
            (moment + 1) * (self.way(point) in ways) for point, moment in enumerate(self.moments)
        )

    @property
    def sensor_ways(self) -> tuple[Times, ...]:
        """The ways of each sensor: several if it repeats."""
        of_first = dict[int, Times]()
        for way, first in enumerate(self.repeats or range(self.ways)):
            of_first[first] = (*of_first.get(first, ()), way)
        return tuple(of_first.values())

    def canonical(self, points: Iterable[int]) -> Times:
        """The points, sorted, at which k repeats of a sensor are its first k.

        Repeats are alike, so 3 b alone is 3 a. A point may be given as often as it repeats.

        >>> points = Points(Clock.counting(3), ("a", "b", "c"), repeats=(0, 0, 0))
        >>> points.written_of(points.canonical((3, 3, 8)))
        ['1 a', '1 b', '2 a']
        """
        if not self.repeats:
            return tuple(sorted(points))
        count, found = Counter[int](), list[int]()
        for point in sorted(points):
            way = self.repeats[self.way(point)]
            first = self.first(self.instant(point)) + way
            is_another = count[first] < self.repeats.count(way)
            found.append(first + count[first] if is_another else point)  # else it comes twice
            count[first] += 1
        return tuple(sorted(found))

    def made(self, points: Iterable[int]) -> Times:
        """The instants at which some points are measured, sorted and each once."""
        return tuple(sorted({*map(self.made_at, points)}))

    def since(self, first: int) -> "Points":
        """The points from an instant on; instants and points count from there."""
        return replace(self, clock=self.clock.since(first))

    def successors(self, spacing: float) -> Times:
        """For each point, the first point of an instant that is at least `spacing` later.

        >>> Points(Clock.counting(2), ("ct", "x-ray")).successors(2)
        (4, 4, 6, 6, 6, 6)
        """
        later = self.clock.successors(spacing)
        return tuple(self.first(t) for t in later for _ in range(self.ways))

    # --- texts ------------------------------------------------------------------------------------

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the sensors; without sensors, there is one."""
        return self.sensors or (ALONE,)

    def sensor(self, point: int) -> str:
        """The name of the sensor of a point; empty without sensors."""
        return self.sensors[self.way(point)] if self.sensors else ""

    def columns(self, point: int) -> dict[str, str]:
        """The columns of a table that say how a point measures; none without sensors."""
        return {"sensor": self.sensor(point)} if self.sensors else {}

    def written(self, point: int) -> Any:
        """A point as users read it: its time, and its sensor if there are any."""
        made_at = max(0, self.made_at(point))
        if not self.sensors:
            return self.clock.time(made_at)
        return f"{self.clock.text(self.clock.times[made_at])} {self.sensor(point)}"

    def written_of(self, points: Iterable[int]) -> list[Any]:
        """Points as users read them, in the same order."""
        return [self.written(point) for point in points]

    def read(self, written: Any, name: str = "measurement_times", *, of_all: bool = False) -> Times:
        """The points that a text or several entries list, in the order written.

        Without sensors these are instants; see `pfdist.problem.written.instants_written`. With
        sensors, the name of a sensor follows the times at which it measures. If `of_all`, times
        without a name mean all sensors. Raises `MeasurementTimesError`, which begins with `name`.
        """
        clock = self.clock
        if isinstance(written, str) and (known := self._known.get(written)) is not None:
            return (known,)
        if not self.sensors:
            instants = instants_written(written, clock, name)
            if not self.delays:
                return tuple(instants)
            return tuple(self._arriving(instants, range(1), name, of_all=of_all))
        if isinstance(written, Iterable) and not isinstance(written, str):
            parts = (self.read(each, name, of_all=of_all) for each in written)
            return tuple(joined_times(name, parts, 4 * self.number))
        ways = self._ways | ({"": range(self.ways)} if of_all else {})
        found, waiting = list[int](), list[str]()
        for word in [*self._words(str(as_text(written))), ""]:
            if word and word not in ways:
                waiting.append(word)
                continue
            strange = not clock.has_dates and any(each[0].isalpha() for each in waiting)
            if (waiting or word) and (not waiting or word not in ways or strange):
                raise MeasurementTimesError(
                    f"{name} must name times and then their sensor, as '12 {self.sensors[0]}', got "
                    f"{shown(' '.join(waiting) or word)}; sensors: {', '.join(self.sensors)}"
                )
            instants = instants_written(waiting, clock, name)
            own = ways.get(word, range(0))  # the last word is empty
            found += self._arriving(instants, own, name, of_all=of_all)
            waiting = []
        return tuple(found)

    def _arriving(
        self, instants: Iterable[int], ways: range, name: str, *, of_all: bool
    ) -> Iterator[int]:
        """The points of measurements at some instants; of all, those that arrive in time."""
        clock = self.clock
        for t in instants:
            if not 0 <= t <= clock.horizon:
                raise MeasurementTimesError(f"{name} must lie in 0..{clock.horizon}, got {t}")
            for way in ways:
                at = t + self.delay(way)
                if at <= clock.horizon:
                    yield self.first(at) + way
                elif not of_all:
                    raise MeasurementTimesError(
                        f"{name} must be measured so that values arrive by "
                        f"{clock.formatted(clock.horizon)}, got {clock.formatted(t)}, whose value "
                        f"arrives {self.delay(way)} instant{'s' * (self.delay(way) != 1)} later"
                    )

    @cached_property
    def _known(self) -> dict[str, int]:
        """The point of each text that names one sensor; tables have many such texts."""
        points = range(self.number) if self.sensors else ()
        return {self.written(each): each for each in points if self.made_at(each) >= 0}

    @cached_property
    def _ways(self) -> dict[str, range]:
        """The ways of each name; a sensor that repeats, and a bare time, mean the first repeat."""
        ways = {sensor: range(way, way + 1) for way, sensor in enumerate(self.sensors)}
        for way, sensor in enumerate(self.sensors):
            if self.repeats.count(way) > 1:
                ways.setdefault(sensor.rpartition("a")[0].removesuffix("_"), ways[sensor])
        return ways

    def _words(self, text: str) -> list[str]:
        """Times and sensors; with dates, all words of an entry that are no sensors are one."""
        if not self.clock.has_dates:
            return SEPARATOR.split(text.strip(", "))
        words = list[str]()
        for entry in groups(text):
            dates = " ".join(word for word in entry if word not in self._ways)
            words += [dates] if dates else []
            words += [word for word in entry if word in self._ways]
        return words

    def checked(
        self,
        written: Iterable[Time | str] | str,
        name: str = "measurement_times",
        where: str = "",
    ) -> Times:
        """A checked set of measurements, sorted.

        Errors are those of `read`, `pfdist.common.arguments.listed_argument` and
        `pfdist.common.measurement_times.validated`.
        """
        if not isinstance(written, Iterable):
            raise MeasurementTimesError(f"{name} must be a sequence of times, got {shown(written)}")
        entries: list[Any] = (
            [written] if isinstance(written, str) else listed_argument(name, written)
        )
        for entry in entries:
            if isinstance(entry, Iterable) and not isinstance(entry, str):
                raise MeasurementTimesError(
                    f"{name} must be a sequence of times, got {shown(entry)} among them; sets have "
                    "names, as {'mine': [0, 5]}"
                )
        counts = self.clock.counts and not self.sensors and not self.delays
        if not counts or any(isinstance(entry, str) for entry in entries):
            entries = [*self.canonical(self.read(entries, name))]
        if not counts:
            twice = [t for t, following in pairwise(sorted(entries)) if t == following]
            if twice:
                got = self.written(twice[0]) if self.sensors else self.clock.formatted(twice[0])
                raise MeasurementTimesError(
                    f"{name} must differ from each other, got {got} twice"
                    f"{f' ({where})' if where not in ('', name) else ''}"
                )
        return validated(entries, self.number - 1, where)
