"""The gaps programme: the relaxation for estimates that use later measurements.

The estimate of z(t) depends on the measurements before t and after it. If everything outside of the
gap between two consecutive measurements counts as measured, the errors in the gap depend on these
two alone. For the exact smoother of the true model, further measurements never increase the
expected error, so the sum over all gaps of a set is at most its own error.

A *window* is such a smoother: the last measurement times of a set, all allowed instants up to the
first of them, and all from the last one on. Its errors count in the gap before its last
measurement; in the relaxation for filters they count after it. The end of the horizon follows the
last gap of a set. Windows grow in the same way, and the same programme finds the best set.

A gap that is not known consists of known gaps: if everything outside of a part counts as measured,
the errors in the part are still at most their own.

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
        sizes, last = self._sizes[after], self.relaxation.last[windows]
        sums = np.where(sizes > 1, self._own[after], self._of_pairs[last + 1, times])
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

    @cached_property
    def _of_pairs(self) -> Array:
        """The sum of errors between a last time, or none, and each time and the end, (T+3, T+2).

        It is the largest sum over parts of the gap, each a known gap or measured throughout.
        """
        relaxation, end = self.relaxation, self.relaxation.end
        instants = relaxation.constraints.points.instant(np.arange(end + 1))
        start = relaxation.index[START]
        if_all = np.split(self.errors, relaxation.offsets[start : start + 2])[1]  # is measured
        measured = np.concatenate([[0.0], np.cumsum(if_all)])[instants]
        known = np.full((end + 2, end + 1), -np.inf)
        for number, window in enumerate(relaxation.windows):
            if len(window) == 2 and relaxation.passable[number]:
                known[window[0] + 1, window[1]] = self._own[number]
        sums = np.full((end + 2, end + 1), -np.inf)
        sums[0, 0] = 0.0
        for time in range(end + 1):
            if time > 0:
                sums[:, time] = sums[:, time - 1] + measured[time] - measured[time - 1]
            sums[[0, time + 1], time] = np.maximum(sums[[0, time + 1], time], [known[0, time], 0.0])
            last = np.flatnonzero(known[1:, time] > -np.inf)
            parts = sums[:, last] + known[last + 1, time]
            sums[:, time] = np.maximum(sums[:, time], parts.max(axis=1, initial=-np.inf))
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
