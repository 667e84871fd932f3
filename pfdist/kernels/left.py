"""The constraints of a job in the order of time: whether a measurement may follow those before.

The compiled filter takes the same steps, see `pfdist.kernels.deciding`.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times
from pfdist.common.points import PointNumbers

ROUNDING = 1e-9  # share of the budget by which sums of prices may be rounded

Flags = NDArray[np.bool_]


class StepLimits(NamedTuple):
    """The constraints on what may follow a measurement, as numbers; by default there are none."""

    # (T+1,): after a measurement at each instant, the first that may be measured; the same one if
    # several sensors may measure at an instant
    apart: Times = ()
    prices: tuple[float, ...] = ()  # of each point; by default 1
    delays: Times = ()  # (sensors,): instants after which a value arrives, at its point
    required: Times = ()  # points that are always measured
    most: Times = ()  # (sensors,): the largest number of measurements
    own_apart: tuple[Times, ...] = ()  # (sensors, T+1): as `apart`, of each sensor alone
    alike: Times = ()  # (sensors,): the number of the first of its repeats
    # (sensors,): a number, 0 for none; of a group, only repeats of one sensor measure at an instant
    group: Times = ()
    install: tuple[float, ...] = ()  # (sensors,): price of its first measurement, beside its own
    visit_ends: Times = ()  # of each point: the first point after a visit that begins there
    visit_price: float = 0.0
    most_visits: int = 0  # with `visit_ends`
    open_until: int = 0  # points before this one belong to a visit that has begun

    @property
    def recorded(self) -> dict[str, Any]:
        """The fields that are not empty."""
        return {name: value for name, value in self._asdict().items() if value}

    def arrays(self, sensors: int, instants: range) -> "StepArrays":
        """The constraints as arrays, with instants and points counted from the first instant."""
        points = PointNumbers(sensors)
        start, first, possible = (
            instants.start,
            points.first(instants.start),
            points.first(instants.stop),
        )

        def filled(values: Any, default: Any, used: slice = slice(None), before: int = 0) -> Any:
            return np.ascontiguousarray(
                (np.array(values) if values else default)[..., used] - before
            )

        here, every = slice(start, None), np.arange(sensors)
        setups = [*self._setups(sensors, np.arange(possible))]
        ends = np.array([each.ends for each in setups], np.int64).reshape(-1, possible)
        required = np.isin(range(first, possible), self.required)
        return StepArrays(
            apart=filled(self.apart, np.arange(instants.stop), here, start),
            prices=filled(self.prices, np.ones(possible), slice(first, None)),
            delays=filled(self.delays, 0 * every),
            longest_delay=max(self.delays, default=0),
            required=required.astype(np.uint8),
            last_required=points.instant(max(self.required, default=-1)) - start,
            own_apart=filled(
                self.own_apart, np.zeros((sensors, instants.stop), np.int64), here, start
            ),
            alike=filled(self.alike, every),
            group=filled(self.group, 0 * every),
            setups=len(setups),
            ends=np.maximum(ends[:, first:] - first, 0),
            fees=np.array([each.price for each in setups], np.float64),
            most=np.array([each.most for each in setups], np.int64),
            open_until=np.array([max(0, each.open_until - first) for each in setups], np.int64),
        )

    def _setups(self, sensors: int, points: NDArray[np.int64]) -> Iterator["StepSetup"]:
        """All that a measurement begins, with a price or a largest number."""
        way, never = points % sensors, points.size
        alike = np.array(self.alike or range(sensors))[way]
        for sensor, most in enumerate(self.most):
            if most < never:
                yield StepSetup(np.where(way == sensor, points + 1, 0), 0.0, most)
        for sensor, price in enumerate(self.install):
            if price and sensor in alike:
                yield StepSetup(np.where(alike == sensor, never, 0), price, never)
        if self.visit_ends:
            ends, most = np.array(self.visit_ends)[: points.size], self.most_visits
            yield StepSetup(ends, self.visit_price, most, self.open_until)


UNLIMITED = StepLimits()


class StepSetup(NamedTuple):
    """A `pfdist.problem.shared.Setup`, such as a visit, as numbers."""

    ends: NDArray[np.int64]
    price: float
    most: int
    open_until: int = 0


class StepArrays(NamedTuple):
    """The fields of `StepLimits` for compiled functions."""

    apart: NDArray[np.int64]
    prices: NDArray[np.float64]  # 0 where nothing may be measured
    delays: NDArray[np.int64]
    longest_delay: int
    required: NDArray[np.uint8]  # (points,): whether each point is
    last_required: int  # instant; below 0: none
    own_apart: NDArray[np.int64]
    alike: NDArray[np.int64]
    group: NDArray[np.int64]
    setups: int  # number S of what a measurement may begin, as a visit
    ends: NDArray[np.int64]  # (S, points)
    fees: NDArray[np.float64]  # (S,)
    most: NDArray[np.int64]  # (S,)
    open_until: NDArray[np.int64]  # (S,)


class Left:
    """The measurements that may still follow in each of D draws, which differ in those before.

    A measurement may follow if it, those that were made, and the required ones to come satisfy all
    constraints and can be paid for. So what is measured on the way always satisfies them, and each
    set that does can be reached.

    Parameters
    ----------
    limits : StepLimits
    ways : int
        Number of sensors.
    allowed : sequence of int
        Points that may be measured.
    instants : int
        T + 1.
    limit : float
        The most that each draw may cost; 0 if there is no limit.
    draws : int
    """

    def __init__(
        self,
        limits: StepLimits,
        ways: int,
        allowed: Iterable[int],
        instants: int,
        limit: float = 0.0,
        draws: int = 1,
    ) -> None:
        self._points, self._limit, self.instants = PointNumbers(ways), limit, instants
        self._allowed, self._arrays = {*allowed}, limits.arrays(ways, range(instants))
        self._required, self.now = {*limits.required}, 0
        setups = self._arrays.setups
        state: Any = [("spent", np.float64), ("following", np.int64), ("last", np.int64, ways)]
        state += [("open", np.int64, setups), ("number", np.int64, setups)]
        self._state = np.zeros(draws, state)  # after the measurements before `now`
        self._state["last"], self._state["open"] = -1, self._arrays.open_until
        self._waiting = np.zeros((draws, self._points.first(instants)), np.bool_)  # in flight

    @property
    def spent(self) -> NDArray[np.float64]:
        """The number of measurements of each draw, or their price, (D,)."""
        state = self._state.copy()
        for point in self._in_flight:
            self._add(state, point, self._waiting[:, point])
        spent: NDArray[np.float64] = state["spent"]
        return spent

    def may(self, point: int) -> Flags:
        """Whether each draw may be measured at a point, (D,)."""
        if not self._is_open(point):
            return np.zeros(len(self._state), np.bool_)
        return ~self._waiting[:, point] & (self._broken(point) <= self._broken())

    def may_all(self, points: Iterable[int]) -> bool:
        """Whether all draws may be measured at some points, which they take one after another."""
        for point in points:
            if not self.may(point).all():
                return False
            self.take(point)
        return True

    def take(self, points: int | Sequence[int], draws: Flags | bool = True) -> None:
        """Measure draws at points. They are in flight until time has passed these."""
        self._waiting.T[np.array(points, np.int64)] |= draws

    def drop(self, points: Sequence[int]) -> None:
        """Take back measurements that are still in flight: they were not made."""
        self._waiting[:, points] = False

    def made_at(self, instant: int) -> list[int]:
        """The points that are measured at an instant: their values may arrive later."""
        arrives = enumerate((instant + self._arrays.delays).tolist())
        return [self._points.first(t) + way for way, t in arrives if t < self.instants]

    def requires(self, point: int) -> bool:
        """Whether a point is always measured."""
        return point in self._required

    def wait(self, instant: int) -> None:
        """Let time pass, so that this instant is the first that may be measured."""
        for point in self._in_flight:
            if self._points.instant(point) < instant:
                self._add(self._state, point, self._waiting[:, point])
                self._waiting[:, point] = False
        self.now = instant

    def required(self) -> Times:
        """The required points that can still be measured in each draw."""
        return tuple(p for p, broken in self._walk() if self.requires(p) and not broken.any())

    @property
    def _in_flight(self) -> list[int]:
        points: list[int] = np.flatnonzero(self._waiting.any(axis=0)).tolist()
        return points

    def _is_open(self, point: int) -> bool:
        made_at = self._points.instant(point) - self._arrays.delays[self._points.way(point)]
        return bool(point in self._allowed and made_at >= self.now)

    def _broken(self, more: int | None = None) -> NDArray[np.int64]:
        """How many measurements break a constraint: in flight, required, and an added one, (D,)."""
        return np.sum([np.zeros(len(self._state)), *(each for _, each in self._walk(more))], axis=0)

    def _walk(self, more: int | None = None) -> Iterator[tuple[int, Flags]]:
        """Each point in flight, required or added, and where it breaks a constraint, (D,)."""
        state, wanted = self._state.copy(), {*filter(self._is_open, self._required)}
        wanted |= set() if more is None else {more}
        for point in sorted({*self._in_flight, *wanted}):
            made = self._waiting[:, point]
            yield point, self._add(state, point, made, made | (point in wanted))

    def _add(self, state: Any, point: int, made: Flags, wanted: Flags | None = None) -> Flags:
        """Add a measurement, the latest so far, where it was made, or is wanted and possible.

        Returns the draws in which it breaks a constraint.
        """
        limits, t, way = self._arrays, self._points.instant(point), self._points.way(point)
        last, ends, alike = state["last"], limits.ends[:, point], limits.alike == limits.alike[way]
        begins = (ends > 0) & (point >= state["open"])
        paid = limits.prices[point] + begins @ limits.fees
        broken = (t < state["following"]) | (begins & (state["number"] >= limits.most)).any(axis=1)
        broken |= (last[:, way] >= 0) & (t < limits.own_apart[way, last[:, way]])
        excludes = (limits.group == limits.group[way]) & (limits.group > 0) & ~alike
        broken |= (last[:, excludes] == t).any(axis=1)
        if self._limit:
            broken |= paid > self._limit - state["spent"] + ROUNDING * self._limit
        made = made if wanted is None else made | (wanted & ~broken)
        state["spent"] += paid * made
        state["following"][made], last[made, way] = limits.apart[t], t
        begun = begins & made[:, None]
        state["number"] += begun
        state["open"] = np.where(begun, ends, state["open"])
        return broken if wanted is None else broken & wanted
