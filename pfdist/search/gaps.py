"""The gaps programme: the relaxation for estimates that use later measurements.

The estimate of z(t) depends on the measurements before t and after it. If everything outside of the
gap between two consecutive measurements counts as measured, the errors in the gap depend on these
two alone. For the exact smoother of the true model, further measurements never increase the
expected error, so the sum over all gaps of a set is at most its own error.

A *window* is such a smoother: the last measurement times of a set, all allowed instants up to the
first of them, and all from the last one on. Its errors count in the gap before its last
measurement; in the relaxation for filters they count after it. The end of the horizon follows the
last gap of a set. Windows grow in the same way, and the same programme finds the best set.

In a gap that is not known, each instant has its error in a known gap around it: if everything
outside of a part counts as measured, the errors in the part are still at most their own.

The sources are those of `pfdist.search.relaxation`; see also `pfdist.kernels.lines`.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import Self

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Lag, Times, last_used
from pfdist.errors import JobError
from pfdist.problem.constraints import Constraints
from pfdist.search.first_windows import MOST_UNITS
from pfdist.search.relaxation import (
    NOTHING,
    START,
    Array,
    Relaxation,
    Window,
    followers,
    in_order,
    keeps_limits,
)
from pfdist.search.setups import Indices

LOOKAHEAD = 6
"""Instants after a gap that a search filters. A bound that leaves measurements out is none."""


@dataclass(frozen=True)
class GapRelaxation(Relaxation):
    """The known windows of a relaxed smoother, whose errors count in their last gap."""

    lag: Lag = 0  # in instants; T for an estimate from all measurements
    lookahead: int | None = None  # instants after a gap; None for all that the lag allows

    @cached_property
    def first(self) -> Indices:
        """The first instant of the last gap of each window, (W,)."""
        before = [window[-2] if len(window) > 1 else 0 for window in self.windows]
        return self.constraints.points.instant(np.maximum(before, 0))

    @cached_property
    def until(self) -> Indices:
        """The first instant after the last gap of each window, (W,)."""
        return self.constraints.points.instant(np.maximum(self.last, 0))

    @cached_property
    def ends(self) -> Indices:
        """The last instant that each window filters, (W,)."""
        ends = last_used(self.lag, range(self.horizon + 1))[self.until - 1]
        if self.lookahead is not None:
            ends = np.minimum(ends, self.until + self.lookahead)
        ends[self.index[START]] = self.horizon
        has_errors = np.array([len(window) > 1 for window in self.windows])
        has_errors &= self.passable & (self.until > self.first)
        has_errors[self.index[START]] = True
        return np.where(has_errors, ends, self.first - 1)

    def _measured(self, numbers: Indices) -> NDArray[np.bool_]:
        """Whether the smoothers of some windows measure at each time, (n, T+2)."""
        times, is_start = np.arange(self.end + 1), numbers == self.index[START]
        last = np.where(is_start, 0, self.last[numbers])
        until = self.constraints.points.first(1) * (self.ends[numbers] + 1)
        later = self._is_allowed & (times >= last[:, None])
        return (super()._measured(numbers) | later) & (times < until[:, None])

    def windows_of(self, times: Times) -> list[int]:
        """The index of the window before the first and after each measurement, and at the end."""
        return super().windows_of((*times, self.end))

    def grown(self, windows: Iterable[Window], far: Iterable[Window] = ()) -> Self:
        """The relaxation with these windows; paths may pass no more gaps that are not known."""
        grown = super().grown(windows, far)
        if self.only is None or grown.only is None:
            return grown
        return replace(grown, only=self.only | {each for each in grown.only if len(each) > 1})

    def overreached(self, times: Times) -> list[Window]:
        """None: a window has all errors that count."""
        return []

    def sums(self, errors: Array) -> "GapSums":
        """A function that adds up errors of gaps; see `Relaxation.sums`."""
        return GapSums(self, errors)


@dataclass(frozen=True)
class GapSums:
    """Sums of the expected errors of gaps, from the E errors of all windows."""

    relaxation: GapRelaxation
    errors: Array  # (E,)

    def __call__(self, windows: Indices, times: Indices) -> Array:
        """Sums of errors from the last measurement of each window to just before a time."""
        after = self.relaxation.after[windows, times]
        last = np.broadcast_to(self.relaxation.last[windows], after.shape)
        sums, unknown = self._own[after], self._sizes[after] == 1
        times = np.broadcast_to(times, after.shape)
        sums[unknown] = self._unknown(last[unknown], times[unknown])
        return np.where(after >= 0, sums, np.inf)

    @cached_property
    def _sizes(self) -> Indices:
        return np.array([len(window) for window in self.relaxation.windows])

    @cached_property
    def _own(self) -> Array:
        """The sum of each window's errors in its last gap, (W,); 0 for a window without errors."""
        relaxation, start = self.relaxation, self.relaxation.offsets[:-1]
        sizes = np.diff(relaxation.offsets)
        counted = np.minimum(relaxation.until - relaxation.first, sizes)
        sums = [
            self.errors[first : first + count].sum()
            for first, count in zip(start.tolist(), counted.tolist(), strict=True)
        ]
        return np.array(sums)

    def _unknown(self, last: Indices, times: Indices) -> Array:
        """Sums of errors in n gaps that are not known, between last times, or none, and times.

        Each instant counts with its error in a known gap that is a part of the gap: in that around
        the instant, or near an end in the longest one from there.
        """
        parts, instant = self._parts, self.relaxation.constraints.points.instant
        begin, end = instant(np.maximum(last, 0)), instant(times)
        middle = np.searchsorted(parts.before, last), np.searchsorted(parts.after, times, "right")
        left, right = (np.clip(each, begin, end) for each in middle)
        half = np.clip((begin + end) // 2, right, np.maximum(left, right))
        left, right = (np.where(left > right, half, each) for each in (left, right))
        beside = parts.from_last(last, times, left) + parts.to_time(last, times, right)
        sums: Array = parts.around[right] - parts.around[left] + beside
        return sums

    @cached_property
    def _parts(self) -> "_KnownGaps":
        return _KnownGaps(self.relaxation, self.errors)


class _KnownGaps:
    """The errors of known gaps that are not too long, of which unknown gaps consist.

    These gaps do not grow, so an unknown gap keeps its sum. `around` has the sum of errors before
    each instant, where an instant has its error in the gap around it, from `before` to `after`.
    """

    def __init__(self, relaxation: GapRelaxation, errors: Array) -> None:
        instants, points = relaxation.horizon + 1, relaxation.constraints.points
        self._instant = points.instant
        errors_of = np.split(errors, relaxation.offsets[1:-1])
        measured = errors_of[relaxation.index[START]]
        self._measured = np.concatenate([[0.0], np.cumsum(measured)])  # before each instant
        longest = min(relaxation.longest_gap, instants)
        self._last = np.full(relaxation.end + 1, relaxation.end)  # from where the longest gap comes
        self._next = np.full(relaxation.end + 2, NOTHING)  # where the longest gap ends
        self._from_last = np.zeros((relaxation.end + 2, longest + 1))
        self._to_time = np.zeros((relaxation.end + 1, longest + 1))
        sizes, lasts = relaxation.until - relaxation.first, list[int]()
        for number, window in enumerate(relaxation.windows):  # by the end; of each, the first wins
            size = int(sizes[number])
            if len(window) != 2 or not 0 < size <= longest or not relaxation.passable[number]:
                continue
            (last, time), own = window, errors_of[number][:size]
            if not np.isfinite(own).all():
                continue
            self._next[last + 1] = time
            self._from_last[last + 1] = _added_up(own, longest)
            if last < self._last[time]:
                self._last[time] = last
                self._to_time[time] = _added_up(own[::-1], longest)
        # Gaps that are part of no other, in order: both of their ends ascend.
        found = NOTHING
        for last in range(NOTHING, relaxation.end):
            if self._next[last + 1] > found:
                found = self._next[last + 1]
                lasts.append(last)
        begins, ends = self._ends(np.array(lasts, np.int64))
        self.after = points.first(1) * np.arange(1, instants + 1)
        self.before = self.after - 1
        around, reached = measured.copy(), 0
        for place, (last, first, until) in enumerate(zip(lasts, begins, ends, strict=True)):
            reached, stop = max(reached, first), until
            if place + 1 < len(lasts):  # up to the middle between the middles of both gaps
                middle = (first + until + begins[place + 1] + ends[place + 1] + 3) // 4
                stop = min(stop, max(middle, begins[place + 1]))
            if reached < stop:
                here = slice(reached, stop)
                self.before[here], self.after[here] = last, self._next[last + 1]
                around[here] = np.diff(self._from_last[last + 1])[reached - first : stop - first]
                reached = stop
        self.around = np.concatenate([[0.0], np.cumsum(around)])

    def _ends(self, lasts: Indices) -> tuple[list[int], list[int]]:
        begins = self._instant(np.maximum(lasts, 0))
        return begins.tolist(), self._instant(self._next[lasts + 1]).tolist()

    def from_last(self, last: Indices, times: Indices, until: Indices) -> Array:
        """The sums from last times, or none, to instants, in the longest gaps from there, (n,)."""
        begin, following = self._instant(np.maximum(last, 0)), self._next[last + 1]
        is_part = (following > NOTHING) & (following <= times)
        reached = np.where(is_part, np.minimum(self._instant(following), until), begin)
        rest = self._measured[until] - self._measured[reached]
        sums: Array = self._from_last[last + 1, reached - begin] + rest
        return sums

    def to_time(self, last: Indices, times: Indices, since: Indices) -> Array:
        """The sums from instants to times, in the longest gaps that end there, (n,)."""
        end, before = self._instant(times), self._last[times]
        is_part = (before < times) & (before >= last)
        reached = np.where(is_part, np.maximum(self._instant(np.maximum(before, 0)), since), end)
        rest = self._measured[reached] - self._measured[since]
        sums: Array = self._to_time[times, end - reached] + rest
        return sums


def _added_up(errors: Array, size: int) -> Array:
    """The sum of the first 0, 1, ... errors, (size+1,)."""
    sums = np.zeros(size + 1)
    sums[1 : errors.size + 1] = np.cumsum(errors)
    sums[errors.size + 1 :] = sums[errors.size]
    return sums


def gaps_with(
    constraints: Constraints, longest_gap: int, lag: Lag, lookahead: int | None = None
) -> GapRelaxation:
    """The relaxation with all gaps between two measurements that are not too long."""
    instant, end = constraints.points.instant, constraints.possible
    windows: set[Window] = {START, (end,), *((time,) for time in constraints.allowed)}
    for last in (NOTHING, *constraints.allowed):
        until = longest_gap + max(instant(last), 0)
        every = chain(followers(constraints, last), [end])
        windows |= {(last, time) for time in every if instant(time) <= until}
    kept = (window for window in windows if keeps_limits(constraints, window))
    return GapRelaxation(constraints, in_order(kept), longest_gap, lag=lag, lookahead=lookahead)


def gaps_for(
    constraints: Constraints,
    measurements: int,
    lag: Lag,
    most_cells: int,
    lookahead: int | None = None,
) -> GapRelaxation:
    """The relaxation with gaps of up to three mean gaps, or less if memory demands it.

    The arguments are those of `pfdist.search.relaxation.relaxation_for`, the lag in instants, and
    the lookahead of `GapRelaxation`. Without a lookahead, raises `JobError` if the gaps of one
    instant need more memory.
    """
    instants, points = constraints.horizon + 1, constraints.points
    gap = min(math.ceil(3.0 * instants / (measurements + 1)), instants)
    ahead = instants if lookahead is None else lookahead

    def cells() -> int:
        return int(points.number * points.first(gap) * min(gap + ahead, instants))

    while gap > 1 and cells() > most_cells:
        gap -= 1
    if lookahead is None and cells() > most_cells:
        raise JobError(
            f"a bound for estimates that use later measurements needs about {cells():,} numbers "
            f"for each group of draws, allowed: {most_cells:,}; take more memory",
            argument="memory",
        )
    unit = 1 if constraints.counted else math.ceil(constraints.total / MOST_UNITS)
    return replace(gaps_with(constraints, gap, lag, lookahead), unit=unit)
