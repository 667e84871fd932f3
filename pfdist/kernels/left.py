"""The constraints of a job in the order of time: whether a measurement may follow those before.

The compiled filter goes by the same steps, see `pfdist.kernels.deciding`.
"""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfdist.common.measurement_times import Times
from pfdist.common.points import PointNumbers
from pfdist.kernels.follows import StepLimits

Flags = NDArray[np.bool_]


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
        # Imported here, because they load Numba.
        from pfdist.kernels.memory import in_memory  # noqa: PLC0415
        from pfdist.kernels.stepping import addresses_of  # noqa: PLC0415

        self._points, self._limit, self.instants = PointNumbers(ways), limit, instants
        self._allowed, self._required, self.now = {*allowed}, {*limits.required}, 0
        self._follows = limits.arrays(ways, range(instants), addresses_of(limits.steps))
        self._packed = in_memory(self._follows)
        # The settled records, of measurements made before `now`: what is spent, and the states.
        self._spent = np.zeros((draws, 2))
        self._states = np.tile(self._follows.start, (draws, 1))
        possible = self._points.first(instants)
        self._made = np.zeros((draws, possible), np.bool_)  # measured, and not settled
        points = np.arange(possible)
        self._made_at: NDArray[np.int64] = points // ways - self._follows.delays[points % ways]
        self._order: list[int] = np.argsort(self._made_at, kind="stable").tolist()

    @property
    def spent(self) -> NDArray[np.float64]:
        """The number of measurements of each draw, or their price, (D,)."""
        spent, states = self._spent.copy(), self._states.copy()
        for point in self._unsettled:
            self._add(spent, states, point, self._made[:, point])
        return spent[:, 0]

    def may(self, point: int) -> Flags:
        """Whether each draw may be measured at a point, (D,)."""
        if not self._is_open(point):
            return np.zeros(len(self._spent), np.bool_)
        return ~self._made[:, point] & (self._broken(point) <= self._broken())

    def may_all(self, points: Iterable[int]) -> bool:
        """Whether all draws may be measured at some points, which they take one after another."""
        for point in points:
            if not self.may(point).all():
                return False
            self.take(point)
        return True

    def take(self, points: int | Sequence[int], draws: Flags | bool = True) -> None:
        """Measure draws at points."""
        self._made.T[np.array(points, np.int64)] |= draws

    def drop(self, points: Sequence[int]) -> None:
        """Take back measurements of this instant: they were not made."""
        self._made[:, points] = False

    def breaking(self, made: Sequence[int]) -> Times:
        """The points that break a limit if they are measured after some, which come in order.

        Each draw stands for a point.
        """
        spent, states, every = self._spent.copy(), self._states.copy(), np.arange(len(self._spent))
        for point in made:
            self._add(spent, states, point, every >= 0)
        moments = self._made_at * self._points.ways + every % self._points.ways
        later = moments > max(moments[[*made]], default=-np.inf)
        later &= self._made_at >= 0  # the others are never possible
        return tuple(np.flatnonzero(self._add(spent, states, every, every < 0, later)).tolist())

    def made_at(self, instant: int) -> list[int]:
        """The points that are measured at an instant: their values may arrive later."""
        arrives = enumerate((instant + self._follows.delays).tolist())
        return [self._points.first(t) + way for way, t in arrives if t < self.instants]

    def requires(self, point: int) -> bool:
        """Whether a point is always measured."""
        return point in self._required

    def wait(self, instant: int) -> None:
        """Let time pass, so that this instant is the first that may be measured."""
        for point in self._unsettled:
            if self._made_at[point] < instant:
                self._add(self._spent, self._states, point, self._made[:, point])
                self._made[:, point] = False
        self.now = instant

    def required(self) -> Times:
        """The required points that can still be measured in each draw."""
        open_ones = (p for p, broken in self._walk() if self.requires(p) and not broken.any())
        return tuple(sorted(open_ones))

    @property
    def _unsettled(self) -> list[int]:
        some = {*np.flatnonzero(self._made.any(axis=0)).tolist()}
        return [point for point in self._order if point in some] if some else []

    def _is_open(self, point: int) -> bool:
        return bool(point in self._allowed and self._made_at[point] >= self.now)

    def _broken(self, more: int | None = None) -> NDArray[np.int64]:
        """How many measurements break a constraint: made, required, and an added one, (D,)."""
        return np.sum([np.zeros(len(self._spent)), *(each for _, each in self._walk(more))], axis=0)

    def _walk(self, more: int | None = None) -> Iterator[tuple[int, Flags]]:
        """Each point made, required or added, and where it breaks a constraint, (D,)."""
        spent, states = self._spent.copy(), self._states.copy()
        wanted = {*filter(self._is_open, self._required)} | (set() if more is None else {more})
        points = {*self._unsettled, *wanted}
        for point in sorted(points, key=lambda point: (self._made_at[point], point)):
            made = self._made[:, point]
            yield point, self._add(spent, states, point, made, made | (point in wanted))

    def _add(
        self, spent: NDArray[np.float64], states: NDArray[np.int64], point: ArrayLike, made: Flags,
        wanted: Flags | None = None,
    ) -> Flags:  # fmt: skip
        """Add a measurement, the latest so far, where it was made, or is wanted and possible.

        `point` may differ between draws. Returns the draws in which it breaks a constraint.
        """
        from pfdist.kernels.stepping import Addition, add_to_all  # noqa: PLC0415  as above

        broken, size = np.zeros(len(spent), np.uint8), self._follows.start.size
        add_to_all(
            Addition(
                self._packed.ctypes.data, self._limit, self._points.ways, len(spent),
                np.array(np.broadcast_to(point, len(spent)), np.int64), spent, states,
                size, made.astype(np.uint8), (made if wanted is None else wanted).astype(np.uint8),
                broken, np.zeros(2), np.zeros(size, np.int64),
            )
        )  # fmt: skip
        return broken > 0
