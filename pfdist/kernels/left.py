"""What may still be measured, in the order of time: the constraints of a job, step by step.

The compiled filter takes the same steps, see `pfdist.kernels.filter`.
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

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


class Left:
    """What may still be measured of each of D draws, which differ in what was measured.

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
        What may be spent on each draw; 0 if there is no limit.
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
        self._points, self._limit = PointNumbers(ways), limit
        possible = self._points.first(instants)
        self._allowed = np.isin(range(possible), [*allowed])
        own = limits.own_apart or np.zeros((ways, instants), np.int64)
        self._own_apart = np.pad(own, ((0, 0), (0, 1)))  # at index -1: nothing was measured
        every = np.arange(ways)
        alike, group = np.array(limits.alike or every), np.array(limits.group or 0 * every)
        self._alike = alike[:, None] == alike
        self._excludes = (group[:, None] == group) & (group > 0) & ~self._alike
        self._prices = np.array(limits.prices or np.ones(possible))
        self._delays = np.array(limits.delays or 0 * every)
        self._limits, self.now = limits, 0
        sizes = [("spent", np.float64), *((n, np.int64) for n in ("following", "open", "visits"))]
        state: Any = [*sizes, ("number", np.int64, ways), ("last", np.int64, ways)]
        self._state = np.zeros(draws, state)  # after the measurements before `now`
        self._state["last"], self._state["open"] = -1, limits.open_until
        self._waiting = np.zeros((draws, possible), np.bool_)  # was measured, not in the state

    @property
    def spent(self) -> NDArray[np.float64]:
        """What was spent on each draw, (D,): a number, or a price."""
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

    def take(self, points: int | Sequence[int], draws: ArrayLike = True) -> None:
        """Measure draws at points. They are in flight until time has passed these."""
        self._waiting.T[np.array(points, np.int64)] |= draws

    def wait(self, instant: int) -> None:
        """Let time pass, so that this instant is the first that may be measured."""
        for point in self._in_flight:
            if self._points.instant(point) < instant:
                self._add(self._state, point, self._waiting[:, point])
                self._waiting[:, point] = False
        self.now = instant

    def required(self) -> Times:
        """The required points that can still be measured in each draw."""
        return tuple(
            p for p, broken in self._walk() if p in self._limits.required and not broken.any()
        )

    @property
    def _in_flight(self) -> list[int]:
        points: list[int] = np.flatnonzero(self._waiting.any(axis=0)).tolist()
        return points

    def _is_open(self, point: int) -> bool:
        made_at = self._points.instant(point) - self._delays[self._points.way(point)]
        return bool(self._allowed[point] and made_at >= self.now)

    def _broken(self, more: int | None = None) -> NDArray[np.int64]:
        """How many measurements break a constraint: in flight, required, and an added one, (D,)."""
        return sum((broken for _, broken in self._walk(more)), np.zeros(len(self._state), np.int64))

    def _walk(self, more: int | None = None) -> Iterator[tuple[int, Flags]]:
        """Each point in flight, required or added, and the draws in which it breaks a constraint."""
        state, added = self._state.copy(), filter(self._is_open, self._limits.required)
        for point in sorted({*self._in_flight, *added, *([] if more is None else [more])}):
            made = self._waiting[:, point]
            is_added = point == more or (point in self._limits.required and self._is_open(point))
            yield point, self._add(state, point, made, made | is_added)

    def _add(self, state: Any, point: int, made: Flags, wanted: Flags | None = None) -> Flags:
        """Add a measurement, the latest so far, where it was made, or is wanted and possible.

        Returns the draws in which it breaks a constraint.
        """
        limits, t, way = self._limits, self._points.instant(point), self._points.way(point)
        number, last = state["number"], state["last"]
        paid = np.full(len(state), self._prices[point])
        if limits.install:
            paid += limits.install[way] * (number[:, self._alike[way]].sum(axis=1) == 0)
        begins = np.zeros(len(state), np.bool_)
        if limits.visit_ends:
            begins = point >= state["open"]
            paid += limits.visit_price * begins
        broken = (t < state["following"]) | (t < self._own_apart[way, last[:, way]])
        broken |= (last[:, self._excludes[way]] == t).any(axis=1)
        if self._limit:
            broken |= paid > self._limit - state["spent"] + ROUNDING * self._limit
        if limits.most:
            broken |= number[:, way] >= limits.most[way]
        if limits.visit_ends:
            broken |= begins & (state["visits"] >= limits.most_visits)
        made = made if wanted is None else made | (wanted & ~broken)
        state["spent"] += paid * made
        state["following"][made] = limits.apart[t] if limits.apart else t
        number[:, way] += made
        last[made, way] = t
        if limits.visit_ends:
            state["visits"] += begins & made
            state["open"][begins & made] = limits.visit_ends[point]
        return broken if wanted is None else broken & wanted
