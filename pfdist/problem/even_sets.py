"""Evenly spaced sets: the candidates of which the best one is the opponent of a plan.

A set is evenly spaced if its measurements are nearest to a, a + d, a + 2 d, ... for any real first
target a and step d. Both roundings of a tie count: they are those of targets beside it. All targets
lie within half a step of the clock of the horizon, and no two have the same nearest instant.

- With several sensors, one of them measures, or all in turn, begun by any of them. A sensor that
  repeats may measure once or several times at each target.
- Forbidden times are met in two ways: targets that fall into a gap are left out, or targets are
  spaced over the time that remains when the gaps are cut out of the clock.
- Required measurements are among the spaced ones; those of sensors that are not spaced are there
  anyway. Where no such set contains them all, regular times are the reference.
- With prices, any number of measurements that can be paid counts.

On the paper's problem these are 39,627 sets, where there are 861 pairs of a first and a last
instant; the expected MSE of the best is 3 % lower than that of the best pair.
"""

import math
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times
from pfdist.problem.feasible import Feasible

Array = NDArray[np.float64]

_MOST_SLOPES = 2_000_000  # critical steps that are computed; above, steps are taken equally
_MOST_TRIED = 20_000  # lines by which it is found out whether there is any set
_MOST_LEFT_OUT = 3  # as many targets for each measurement may fall into gaps


class EvenLine(NamedTuple):
    """The targets a + k d of a family, and the distances to its neighbours among the lines."""

    family: int
    first: float  # a
    step: float  # d
    distance: float = 0.0  # of the first targets, and of the last ones; 0 if no line lies between


class EvenFamily(NamedTuple):
    """Lines with the same number of targets, on the same ruler, with the same sensors."""

    targets: int
    ways: tuple[Times, ...]  # that measure at each target, (targets,)
    instants: NDArray[np.int64]  # (K,): the instants of the ruler
    positions: Array  # (K,)
    # of visits: the time after the beginning, and the ways, of each measurement in a visit
    inside: tuple[tuple[float, Times], ...] = ()
    shorter: tuple[tuple[float, Times], ...] = ()  # likewise in a visit with one measurement less
    most: int = 0  # of visits: the largest number of times at which all of them measure

    @property
    def edges(self) -> Array:
        """The bounds of the targets that are nearest to each instant, (K+1,)."""
        at = self.positions
        if at.size == 1:
            return np.array([at[0] - 0.5, at[0] + 0.5])
        between = (at[1:] + at[:-1]) / 2
        return np.concatenate([[2 * at[0] - between[0]], between, [2 * at[-1] - between[-1]]])


@dataclass(frozen=True)
class EvenSets:
    """The evenly spaced sets of a problem.

    >>> even = EvenSets(Feasible(horizon=11, measurement_budget=4))
    >>> found = even.sets_of(even.lines(1000))
    >>> (0, 4, 7, 11) in found, (0, 3, 6, 9) in found, (0, 1, 6, 9) in found, len(found)
    (True, True, False, 99)
    """

    feasible: Feasible

    def lines(self, most: int) -> list[EvenLine]:
        """One line of each set, or about `most` lines that are spread over all of them."""
        own = max(1, most // max(1, len(self.families)))
        points, required = self.feasible.points, {*self.feasible.required}
        return [
            EvenLine(number, *values)
            for number, family in enumerate(self.families)
            for spaced in [required - {*self._others({*chain.from_iterable(family.ways)})}]
            for values in lines_of_family(family, own, points.made(spaced))
        ]

    def near(self, line: EvenLine) -> list[EvenLine]:
        """Lines between a line and its neighbours, with a third of their distance."""
        number, first, step, distance = line
        family = self.families[number]
        last, steps = first + (family.targets - 1) * step, max(1, family.targets - 1)
        low, high = family.edges[[0, -1]]
        moved = distance / 3 * np.arange(-2, 3)
        return [
            EvenLine(number, a, (b - a) / steps, distance / 3)
            for a in (first + moved).tolist()
            for b in ((last + moved).tolist() if family.targets > 1 else [a])
            if distance and low < a <= b < high
        ]

    def sets_of(self, lines: list[EvenLine]) -> dict[Times, EvenLine]:
        """The set of each line, once; a line without one is left out."""
        found = dict[Times, EvenLine]()
        families = np.array([line.family for line in lines])
        for number, family in enumerate(self.families):
            own = [lines[place] for place in np.flatnonzero(families == number)]
            if own:
                for line, times in zip(own, self._sets(family, own), strict=True):
                    if times:
                        found.setdefault(times, line)
        return found

    @cached_property
    def families(self) -> list[EvenFamily]:
        """All families that may have a set."""
        return [*self._families()]

    def _families(self) -> Iterator[EvenFamily]:
        points = self.feasible.points
        times = np.array(points.clock.times, np.float64)
        every = np.arange(times.size)
        for turn in self._turns:
            ways = sorted({way for each in turn for way in each})
            usable = np.array([t for t in self._possible if points.way(t) in ways], np.int64)
            made = np.unique([points.made_at(t) for t in usable.tolist()])
            rulers = [(every, times)]
            if 0 < made.size < times.size:
                rulers.append((made, _cut(times, made)))
            for number in self._numbers(ways):
                targets, rest = divmod(number, len(turn[0]))
                if rest:
                    continue
                for instants, positions in rulers:
                    # Only targets between measurements are left out.
                    most = min(instants.size, _MOST_LEFT_OUT * targets)
                    is_cut = instants.size == made.size
                    for all_targets in range(targets, (targets if is_cut else most) + 1):
                        in_turn = tuple(turn[k % len(turn)] for k in range(all_targets))
                        yield EvenFamily(all_targets, in_turn, instants, positions)

    @property
    def _turns(self) -> Iterator[tuple[Times, ...]]:
        """The ways that measure at one target after another, again and again."""
        sensors = self.feasible.points.sensor_ways
        for ways in sensors:
            yield from ((ways[:number],) for number in range(1, len(ways) + 1))
        if len(sensors) > 1:
            for phase in range(len(sensors)):
                yield tuple((ways[0],) for ways in (*sensors[phase:], *sensors[:phase]))

    def _numbers(self, ways: Collection[int]) -> range:
        """The numbers of measurements that are spaced, of sensors with these ways."""
        feasible, others = self.feasible, self._others(ways)
        if feasible.counted:
            number = feasible.total - len(others)
            return range(number, number + 1)
        left = feasible.total - feasible.spent(others)
        cheapest = min((feasible.units[t] for t in feasible.allowed), default=1)
        most = min(left // cheapest, len(feasible.allowed) - len(others))
        return range(max(1, len(feasible.required) - len(others)), most + 1)

    def _others(self, ways: Collection[int]) -> Times:
        """The required measurements of all sensors but those with these ways."""
        points = self.feasible.points
        return tuple(t for t in self.feasible.required if points.way(t) not in ways)

    @cached_property
    def _possible(self) -> Times:
        return tuple(t for t in self.feasible.allowed if self.feasible.points.made_at(t) >= 0)

    def _sets(self, family: EvenFamily, lines: list[EvenLine]) -> list[Times | None]:
        """The set of each line of a family; None if it is none."""
        feasible, points = self.feasible, self.feasible.points
        first, step = (
            np.array([getattr(each, key) for each in lines]) for key in ("first", "step")
        )
        targets = first[:, None] + step[:, None] * np.arange(family.targets)
        instants = family.instants[np.searchsorted(family.edges[1:-1], targets)]
        ways = np.array(family.ways)  # (targets, repeats)
        arrives = (
            instants[:, :, None] + np.array([points.delay(w) for w in range(points.ways)])[ways]
        )
        chosen = (points.first(1) * arrives + ways).reshape(len(lines), -1)
        possible = np.zeros(points.number + 1, np.bool_)
        possible[[*self._possible]] = True
        kept = possible[np.minimum(chosen, points.number)]
        differ = (np.diff(instants, axis=1) > 0).all(axis=1)
        whole = differ & kept[:, 0] & kept[:, -1]
        others = self._others({*ways.ravel().tolist()})
        for each in {*feasible.required} - {*others}:
            whole &= (chosen == each).any(axis=1)
        if feasible.counted:
            whole &= kept.sum(axis=1) == feasible.total - len(others)
        is_free = feasible.counted and feasible.spacing.is_free and not feasible.shared
        found: list[Times | None] = [None] * len(lines)
        for place in np.flatnonzero(whole).tolist():
            times = tuple(sorted((*others, *chosen[place, kept[place]].tolist())))
            if is_free or (feasible.accepts(times) if feasible.counted else feasible.allows(times)):
                found[place] = times
        return found


def even_sets(feasible: Feasible) -> EvenSets:
    """The evenly spaced sets of a problem: of measurements, or of what they share."""
    shared = (each.even_sets(feasible) for each in feasible.shared)
    return next(filter(None, shared), EvenSets(feasible))


def has_even_sets(feasible: Feasible) -> bool:
    """Whether an evenly spaced set contains all required measurements."""
    even = even_sets(feasible)
    return not feasible.required or bool(even.sets_of(even.lines(_MOST_TRIED)))


def _cut(times: Array, instants: NDArray[np.int64]) -> Array:
    """Positions of instants on a clock from which the time of all other instants is cut out."""
    steps = np.diff(times, prepend=times[0] - (times[1] - times[0] if times.size > 1 else 1.0))
    after = np.append(steps[1:], steps[-1])
    own = (steps[instants] + after[instants]) / 2
    positions: Array = np.cumsum(own) - own / 2
    return positions


def lines_of_family(
    family: EvenFamily, most: float, required: Times = ()
) -> list[tuple[float, float, float]]:
    """The first target and the step of lines of a family, and their distance from others.

    If there are too many, and some instants are required, they go through one of these.
    """
    edges, targets = family.edges, family.targets
    if not 1 <= targets <= family.positions.size:
        return []
    if targets == 1:
        return [(a, 0.0, 0.0) for a in family.positions.tolist()]
    steps = targets - 1
    # Different instants need so long a step:
    shortest = max(0.0, float((edges[targets - 1 : -1] - edges[1:-steps]).min()) / steps)
    longest = (edges[-1] - edges[0]) / steps
    slopes, lines = _slopes(edges, targets, shortest, longest), list[tuple[float, float, float]]()
    for step in slopes.tolist():
        bounds = np.sort((edges[:, None] - step * np.arange(targets)).ravel())
        bounds = bounds[(bounds >= edges[0]) & (bounds <= edges[-1] - steps * step)]
        gaps = np.diff(bounds)
        middles = bounds[:-1] + gaps / 2
        lines += [(a, step, 0.0) for a in middles[gaps > 1e-9 * longest].tolist()]
        if len(lines) > most:
            break
    if lines and len(lines) <= most:
        return lines
    return _through(family, most, required) if required else _spread(family, most, shortest)


def _through(family: EvenFamily, most: float, required: Times) -> list[tuple[float, float, float]]:
    """About `most` lines whose targets include the first required instant, and the last if more."""
    places = np.flatnonzero(np.isin(family.instants, required))
    if not places.size:
        return []
    edges, targets = family.edges, family.targets
    thirds = np.array([1, 3, 5]) / 6  # of the time that is nearest to an instant
    first, last = (edges[p] + (edges[p + 1] - edges[p]) * thirds for p in places[[0, -1]])
    lines = list[tuple[float, float, float]]()
    count = max(3, int(most // (3 * targets)))
    for k in range(targets):
        after = targets - 1 - k
        for at in first.tolist():
            if places.size > 1:
                steps = [(b - at) / j for j in range(1, after + 1) for b in last.tolist()]
            else:
                room = min((at - edges[0]) / max(k, 1e-9), (edges[-1] - at) / max(after, 1e-9))
                steps = (room * (np.arange(count) + 0.5) / count).tolist()
            lines += [
                (at - k * step, step, 0.0)
                for step in steps
                if at - k * step >= edges[0] and at + after * step <= edges[-1]
            ]
    return lines


def _spread(family: EvenFamily, most: float, shortest: float) -> list[tuple[float, float, float]]:
    """About `most` lines whose first and last targets lie at equal distances."""
    low, high = family.edges[[0, -1]].tolist()
    steps = family.targets - 1
    room = high - low - steps * shortest
    distance = room / math.sqrt(2 * most)
    count = max(1, math.ceil(room / distance))
    at = (np.arange(count) + 0.5) * room / count
    return [
        (low + a, (high - low - a - b) / steps, room / count)
        for a in at.tolist()
        for b in at.tolist()
        if a + b <= room
    ]


def _slopes(edges: Array, targets: int, shortest: float, longest: float) -> Array:
    """A step between each two at which targets' bounds change their order; none of very many."""
    steps = np.arange(1, targets)
    if edges.size**2 * steps.size / 2 > _MOST_SLOPES:
        return np.empty(0)
    distances = np.unique((edges[None, :] - edges[:, None])[np.triu_indices(edges.size, 1)])
    critical = (distances[:, None] / steps).ravel()
    critical = np.sort(critical[(critical > shortest) & (critical < longest)])
    critical = np.concatenate([[shortest], critical, [longest]])
    differ = np.diff(critical) > 1e-9 * longest
    between: Array = (critical[:-1] + critical[1:])[differ] / 2
    return between
