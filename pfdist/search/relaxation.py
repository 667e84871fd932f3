"""The relaxation for the lower bound: filters with more measurements than the set has.

For the exact filter of the true model, further measurements never increase the expected error. So
its error at t with a set M is at least its error with M and all allowed instants up to one of the
measurements. A *window* is such a filter: the last measurement times of a set, and all allowed
instants up to the first of them. The longer a window, the less it adds, and the closer its error is
to the set's own.

A relaxation contains some windows, the known ones. At each instant, a set is in the longest known
window that its measurements end with. Every beginning of a known window is known. So the next
window follows from the last one and the next time alone, and a dynamic programme finds the set with
the least relaxed error. All windows of two measurements are a good start; `pfdist.search.programme`
adds longer ones where they matter.

Sources: Aho, Corasick, "Efficient string matching: an aid to bibliographic search", Communications
of the ACM 18, 1975 (the longest known end, and how it changes with the next symbol). Vitus, Zhang,
Abate, Hu, Tomlin, "On efficient sensor scheduling for linear dynamical systems", Automatica 48,
2012 (monotone covariances). Brown, Smith, Sun, "Information relaxations and duality in stochastic
dynamic programs", Operations Research 58, 2010.
"""

import math
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import ManySets, Times
from pfdist.errors import MeasurementTimesError
from pfdist.problem.constraints import Constraints
from pfdist.search.base import Counted
from pfdist.search.setups import Indices, Setups

NOTHING = -1
"""First entry of a window before which nothing is measured: the window is a whole beginning."""

_MOST_STATES = 30_000_000  # times sums, with what was begun before the window
_TOGETHER = 4096  # windows whose times are laid out
_MOST_KEPT = 4_000_000  # moves; more are computed whenever they are needed

Window = tuple[int, ...]
"""Measurement times, sorted. Every allowed instant up to the first is measured."""

START: Window = (NOTHING,)

Array = NDArray[np.float64]
States = NDArray[np.int32]


class Moves(NamedTuple):
    """All moves from one state to the next by a measurement at one time; see `Setups`."""

    time: int
    before: States  # (n,): the state before the measurement, sorted by the state after it
    to: States  # (n,): the state after it
    begun: NDArray[np.bool_]  # (setups, n): whether it begins each, as a visit
    after: Indices  # (m,): the states after it; all differ
    starts: Indices  # (m,): the first place in `before` of each state after it


@dataclass(frozen=True)
class After:
    """The window after each window and time; most windows have the row of a shorter one.

    ``after[windows, times]`` has the indices of the windows after these; -1 if not allowed.
    """

    rows: States  # (R, T+2): the window after each time, and at the end
    row_of: Indices  # (W,): the row of each window

    def __getitem__(self, at: tuple[Any, Any]) -> Any:
        windows, times = at
        return self.rows[self.row_of[windows], times]

    def allowing(self, time: int) -> Indices:
        """The windows after which a time is allowed, sorted."""
        return np.flatnonzero((self.rows[:, time] >= 0)[self.row_of])

    @property
    def counts(self) -> Indices:
        """How many times are allowed after each window, (W,)."""
        counts: Indices = np.count_nonzero(self.rows >= 0, axis=1)[self.row_of]
        return counts


@dataclass(frozen=True)
class Relaxation:
    """The known windows of a relaxed filter, and the moves between them by measurements.

    Every path satisfies the constraints, except for the number of measurements, which is free.
    Limits are checked only for a window with the next measurement. Raises `MeasurementTimesError`
    if the longest gap is less than 1.
    """

    constraints: Constraints
    # (W,): sorted by the last time; START, each allowed time alone, and all beginnings are there
    windows: tuple[Window, ...]
    # An error of a window counts for fewer instants than this. If nothing is measured for longer,
    # the error of the window's last time alone counts.
    longest_gap: int
    far: frozenset[Window] = frozenset()  # windows whose errors count up to T
    # Windows that paths may pass; errors of others are not known. By default all windows.
    only: frozenset[Window] | None = None
    # Prices are rounded down to whole units. With prices that are too low, a path may measure more,
    # so the bound is still a lower bound.
    unit: int = 1

    def __post_init__(self) -> None:
        if self.longest_gap < 1:
            raise MeasurementTimesError(f"longest_gap must be at least 1, got {self.longest_gap}")

    @property
    def horizon(self) -> int:
        """T."""
        return self.constraints.horizon

    @property
    def end(self) -> int:
        """The number after the last possible measurement: the end of the horizon."""
        return self.constraints.possible

    @cached_property
    def prices(self) -> tuple[int, ...]:
        """Price of a measurement at each time, in units, (T+1,); 1 if measurements are counted."""
        return tuple(price // self.unit for price in self.constraints.units)

    @cached_property
    def setups(self) -> Setups:
        """The numbers of states beside windows: state w * size + s has window w and number s."""
        most = _MOST_STATES // (len(self.windows) * (self.total + 1))
        moves = np.zeros(self.end + 1, np.int64)  # the last entry is that of NOTHING
        np.add.at(moves, self.last, self.after.counts)
        return Setups.within(self.constraints.setups, most, moves)

    @cached_property
    def states(self) -> int:
        """The number of states of each window."""
        return self.setups.size

    @cached_property
    def _fees(self) -> Indices:
        """The price of each setup in units."""
        in_units, setups = self.constraints.in_units, self.constraints.setups
        return np.array([in_units(each.price) // self.unit for each in setups], np.int64)

    def priced(self, moves: Moves) -> Indices:
        """The price of each move, with all that it begins, in units, (n,)."""
        prices: Indices = self.prices[moves.time] + self._fees @ moves.begun
        return prices

    def begun(self, times: Times) -> Indices:
        """How often a set begins each setup, at least, (setups,)."""
        number, last = np.zeros(1, np.int64), np.array([NOTHING])
        begun = np.zeros(len(self.setups.ends), np.int64)
        for time in times:
            number, begins = self.setups.after(last, number, time)
            begun, last = begun + begins[:, 0], np.array([time])
        return begun

    @property
    def total(self) -> int:
        """The sum to spend, in units: N, or money."""
        return self.constraints.total // self.unit

    @property
    def number(self) -> float:
        """The sum to spend, in units, unrounded: on average, prices are at most this sum."""
        return self.constraints.total / self.unit

    @cached_property
    def most(self) -> int:
        """The highest price of measurements at all allowed times, in units."""
        fees = int(self._fees.sum())
        return sum(self.prices[time] + fees for time in self.constraints.allowed)

    def coarse(self, most: int) -> Self:
        """The relaxation in coarser units of money, of which all measurements cost at most so many.

        Measurements are counted one by one.
        """
        if self.constraints.counted:
            return self
        return replace(self, unit=self.unit * max(1, math.ceil(self.most / most)))

    @cached_property
    def index(self) -> dict[Window, int]:
        """Index of each window in `windows`."""
        return {window: index for index, window in enumerate(self.windows)}

    @cached_property
    def last(self) -> Indices:
        """The last measurement time of each window, (W,); -1 if there is none."""
        return np.array([window[-1] for window in self.windows])

    @cached_property
    def first(self) -> Indices:
        """The first instant at which the error of each window counts, (W,)."""
        return self.constraints.points.instant(np.maximum(self.last, 0))

    @cached_property
    def ends(self) -> Indices:
        """The last instant at which the error of each window counts, (W,)."""
        far = [len(window) == 1 or window in self.far for window in self.windows]
        # The window START, whose errors count from 0, ends as if its last measurement were at -1.
        since = np.where(self.last < 0, -1, self.first)
        near = np.minimum(since + self.longest_gap, self.horizon + 1) - 1
        return np.where(self.passable, np.where(far, self.horizon, near), self.first - 1)

    @cached_property
    def passable(self) -> NDArray[np.bool_]:
        """Whether paths may pass through each window, (W,)."""
        if self.only is None:
            return np.ones(len(self.windows), np.bool_)
        return np.array([window in self.only for window in self.windows])

    @cached_property
    def offsets(self) -> Indices:
        """The index of each window's first error in an array of all errors that count, (W+1,)."""
        return np.cumsum(np.concatenate([[0], self.ends - self.first + 1]))

    @property
    def sets(self) -> ManySets:
        """The measurement times of the filter of each window."""
        return self._sets(np.arange(len(self.windows)))

    def counted(self, numbers: Sequence[int]) -> Counted:
        """The filters of some windows, and the instants at which their errors count."""
        some = np.array(numbers, np.int64)
        return Counted(self._sets(some), self.first[some], self.ends[some])

    def _sets(self, numbers: Indices) -> ManySets:
        ways, bits = self.constraints.points.ways, list[NDArray[np.uint8]]()
        for first in range(0, max(1, numbers.size), _TOGETHER):
            measured = self._measured(numbers[first : first + _TOGETHER])
            bits.append(ManySets.from_points(measured[:, : self.end], ways).bits)
        return ManySets(np.concatenate(bits), ways)

    def _measured(self, numbers: Indices) -> NDArray[np.bool_]:
        """Whether the filters of some windows measure at each time, (n, T+2)."""
        windows = [self.windows[number] for number in numbers.tolist()]
        begin = np.array([window[0] for window in windows], np.int64)
        measured = self._is_allowed & (np.arange(self.end + 1) <= begin[:, None])
        for row, window in zip(measured, windows, strict=True):
            row[[*window[1:]]] = True
        return measured

    @cached_property
    def _is_allowed(self) -> NDArray[np.bool_]:
        """Whether each time is allowed, (T+2,); the end is not."""
        allowed = np.zeros(self.end + 1, np.bool_)
        allowed[[*self.constraints.allowed]] = True
        return allowed

    @cached_property
    def single(self) -> Indices:
        """For each window, (W,), the index of the window with only its last time."""
        return np.array([self.index[window[-1:]] for window in self.windows])

    def sums(self, errors: Array) -> Callable[[Indices, Indices], Array]:
        """A function that adds up errors from the last measurement of windows to the next.

        Its arguments are n windows and n times, of which `end` is the end of the horizon.
        """
        return WindowSums(self, errors)

    @cached_property
    def after(self) -> After:
        """The window after each window and time, and at the end."""
        # Short windows come first: a window takes the row of its longest known end, which is
        # shorter. Windows that continue it, if there are any, replace entries of a copy (Aho and
        # Corasick).
        following = dict[int, list[int]]()
        for number, window in enumerate(self.windows):
            if len(window) > 1:
                following.setdefault(self.index[window[:-1]], []).append(number)
        single = [self.index.get((time,), -1) for time in range(self.end + 1)]
        rows, row_of = [np.array(single, np.int32)], np.zeros(len(self.windows), np.int64)
        for number in sorted(range(row_of.size), key=lambda number: len(self.windows[number])):
            window = self.windows[number]
            row_of[number] = 0 if len(window) == 1 else row_of[self._suffix(window)]
            if longer := following.get(number):
                row = rows[row_of[number]].copy()
                row[[self.windows[each][-1] for each in longer]] = longer
                row_of[number] = len(rows)
                rows.append(row)
        # Windows with the same row, the same last time and the same times within limits are alike.
        masks, mask_of = self._within_limits
        kinds, kind_of = np.unique([row_of, self.last, mask_of], axis=1, return_inverse=True)
        row, last, mask = kinds
        after = np.array(rows)[row]
        after[~(self._follows[last + 1] & masks[mask] & self.passable[after])] = -1
        return After(after, kind_of.ravel())  # NumPy 2.0.0 gives a row

    def moves(self, time: int) -> Moves:
        """The moves by a measurement at a time from all states that allow it."""
        known = self._moves.get(time)
        return known or self._moves_at(time)

    @cached_property
    def _moves(self) -> dict[int, Moves]:
        """The moves by each time, unless they are many."""
        if self.after.counts.sum() * self.states > _MOST_KEPT:
            return {}
        return {time: self._moves_at(time) for time in self.constraints.allowed}

    def _moves_at(self, time: int) -> Moves:
        windows = self.after.allowing(time)
        before = (windows[:, None] * self.states + np.arange(self.states)).ravel()
        window, number = np.divmod(before, self.states)
        number, begun = self.setups.after(self.last[window], number, time)
        to = (self.after[window, time] * self.states + number).astype(np.int32)
        order = np.flatnonzero(number < self.states)
        order = order[np.argsort(to[order], kind="stable")]
        before, to = before[order].astype(np.int32), to[order]
        starts = np.flatnonzero(np.diff(to, prepend=-1))
        return Moves(time, before, to, begun[:, order], to[starts], starts)

    def spent(self, times: Times) -> int:
        """The sum, in units, of the bound for a set: its size, or all of the money."""
        return len(times) if self.constraints.counted else self.total

    def is_within(self, times: Times, spent: int) -> bool:
        """Whether the bound of a sum holds for a set."""
        if self.constraints.counted:
            return len(times) == spent
        return self.constraints.spent(times) // self.unit <= spent

    def windows_of(self, times: Times) -> list[int]:
        """The index of the window before the first and after each measurement of a set."""
        number = self.index[START]
        numbers = [number]
        for time in times:
            number = int(self.after[number, time])
            numbers.append(number)
        return numbers

    def grown(self, windows: Iterable[Window], far: Iterable[Window] = ()) -> Self:
        """The relaxation with these windows and their beginnings added.

        Windows that break limits are left out. The errors of the known windows `far` count up to T.
        A new window is far if the longest known window that it ends with is far; otherwise errors
        of a set could become lower.
        """
        beginnings = {window[:size] for window in windows for size in range(1, len(window) + 1)}
        beginnings = {window for window in beginnings if keeps_limits(self.constraints, window)}
        known_far = self.far | {*far}
        new = beginnings - self.index.keys()
        new_far = {window for window in new if self.windows[self._suffix(window)] in known_far}
        return replace(
            self,
            windows=in_order({*self.windows, *beginnings}),
            far=known_far | new_far,
            only=None if self.only is None else self.only | beginnings,
        )

    def restricted(self, paths: Iterable[Times]) -> Self:
        """The relaxation restricted to paths through the windows of these sets."""
        sets = list(paths)
        passed = {self.windows[number] for times in sets for number in self.windows_of(times)}
        far = {window for times in sets for window in self.overreached(times)}
        return replace(self, only=frozenset(passed), far=self.far | far)

    def overreached(self, times: Times) -> list[Window]:
        """The windows of a set whose errors do not count up to the next measurement."""
        numbers = self.windows_of(times)
        following = (*times, self.constraints.possible)
        return [
            self.windows[number]
            for number, until in zip(numbers, following, strict=True)
            if self.ends[number] + 1 < self.constraints.points.instant(until)
        ]

    def without(self, windows: Collection[Window]) -> Self:
        """The relaxation without these windows, and without windows that begin with them."""
        if not windows:
            return self
        remaining = (
            window
            for window in self.windows
            if len(window) == 1
            or not any(window[:size] in windows for size in range(2, len(window) + 1))
        )
        return replace(self, windows=tuple(remaining))

    @cached_property
    def _follows(self) -> NDArray[np.bool_]:
        """Whether a time, or the end, may follow the last time or none, (T+3, T+2)."""
        follows = np.zeros((self.end + 2, self.end + 1), np.bool_)
        for last in (NOTHING, *range(self.end)):
            follows[last + 1, [*followers(self.constraints, last), self.end]] = True
        return follows

    @cached_property
    def _within_limits(self) -> tuple[NDArray[np.bool_], Indices]:
        """Which times keep the limits, (M, T+2), and the row of the times after each window."""
        rows, row_of = dict[Times, int](), list[int]()
        windows = (measured_in(self.constraints, window) for window in self.windows)
        for beyond in self.constraints.beyond_limits(windows) if self.constraints.steps else ():
            row_of.append(rows.setdefault(beyond, len(rows)))
        within = np.ones((max(1, len(rows)), self.end + 1), np.bool_)
        for times, row in rows.items():
            within[row, [*times]] = False
        return within, np.array(row_of or [0] * len(self.windows))

    def _suffix(self, window: Window) -> int:
        """Index of the longest known end of a window that is not the window itself."""
        numbers = (self.index.get(window[begin:]) for begin in range(1, len(window)))
        return next(number for number in numbers if number is not None)


def followers(constraints: Constraints, last: int) -> Iterator[int]:
    """The times that may follow a last time, up to the next required time."""
    first = constraints.spacing.after(last)
    until = min((t for t in constraints.required if t > last), default=constraints.possible)
    return (time for time in constraints.allowed if first <= time <= until)


def keeps_limits(constraints: Constraints, window: Window) -> bool:
    """Whether the measurements of a window satisfy the limits."""
    return constraints.is_within_limits(measured_in(constraints, window))


def measured_in(constraints: Constraints, window: Window) -> Times:
    """The measurements of a window, without its beginning and the end of the horizon."""
    return tuple(time for time in window if NOTHING < time < constraints.possible)


@dataclass(frozen=True)
class WindowSums:
    """Sums of the expected errors of windows, which have E errors in all."""

    relaxation: Relaxation
    errors: Array  # (E,)

    def __call__(self, windows: Indices, times: Indices) -> Array:
        """Sums of errors from the last measurement of each window to just before a time.

        After its end, a window's error is that of its last time alone.
        """
        relaxation, until = self.relaxation, self.relaxation.constraints.points.instant(times)
        own = np.minimum(until, relaxation.ends[windows] + 1)
        total, beyond = self._before(windows, own), own < until
        single = relaxation.single[windows]
        counted = beyond & relaxation.passable[single]
        rest = self._before(single[counted], until[counted])
        total[counted] += rest - self._before(single[counted], own[counted])
        total[beyond & ~counted] = np.inf
        return total

    def _before(self, windows: Indices, until: Indices) -> Array:
        """Sums of the errors of each window from its last measurement to just before `until`."""
        begin = self.relaxation.offsets[windows] + windows - self.relaxation.first[windows]
        sums: Array = self._summed[begin + until]
        return sums

    @cached_property
    def _summed(self) -> Array:
        """Cumulative sums of each window's errors, with a 0 before its first error."""
        offsets = self.relaxation.offsets
        sizes = np.diff(offsets)
        summed = np.zeros(self.errors.size + sizes.size)
        for size in np.unique(sizes).tolist():  # a sum over all windows would round too much
            windows = np.flatnonzero(sizes == size)[:, None]
            places = offsets[windows] + np.arange(size)
            summed[places + windows + 1] = np.cumsum(self.errors[places], axis=1)
        return summed


def in_order(windows: Iterable[Window]) -> tuple[Window, ...]:
    """The windows, sorted by their last time."""
    return tuple(sorted(windows, key=lambda window: (window[-1], window)))
