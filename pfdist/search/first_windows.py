"""The first windows of a relaxation: all short ones, as many as a memory allows."""

import math
from dataclasses import replace

from pfdist.errors import JobError, MeasurementTimesError
from pfdist.problem.constraints import Constraints
from pfdist.search.relaxation import (
    NOTHING,
    START,
    Relaxation,
    Window,
    followers,
    in_order,
    keeps_limits,
)

WINDOW = 2
"""Largest number of measurements in the first windows, by default."""

MOST_UNITS = 300
"""Largest sum of money in a programme, in units; its memory grows with this sum."""

_LEAST_OF_A_SEARCH = 1.2
"""Smallest number of mean gaps between measurements that windows of a search must allow."""


def relaxation_with(constraints: Constraints, window: int, longest_gap: int) -> Relaxation:
    """The relaxation with all windows of at most `window` measurements.

    Windows with a gap longer than the longest gap are left out. The instants before the first
    measurement of a set do not count as a gap. Raises `MeasurementTimesError` if the window or the
    gap is less than 1.
    """
    if window < 1:
        raise MeasurementTimesError(f"window must be at least 1, got {window}")
    windows: set[Window] = {START, *((time,) for time in constraints.allowed)}
    new = list(windows)
    while new:
        shorter = new.pop()
        if len(shorter) == window:
            continue
        last = shorter[-1]
        instant = constraints.points.instant
        until = constraints.horizon if last == NOTHING else instant(last) + longest_gap
        longer = [
            (*shorter, time) for time in followers(constraints, last) if instant(time) <= until
        ]
        longer = [window for window in longer if keeps_limits(constraints, window)]
        new += longer
        windows.update(longer)
    return Relaxation(constraints, in_order(windows), longest_gap)


def relaxation_for(
    constraints: Constraints, window: int, measurements: int, most_cells: int
) -> Relaxation:
    """The relaxation with all windows of at most `window` measurements, within a memory.

    The longest gap is three mean gaps, or less if that needs too much memory, but at least two.
    `measurements` is the usual number of measurements of a set, which gives the mean gap; the
    relaxation holds for sets of any number. Money is counted in units of which the sum to spend has
    at most `MOST_UNITS`. Raises `JobError` if more than `most_cells` errors count.
    """
    gap = _longest_gap(constraints, window, measurements, most_cells, least=2.0)
    cells = _cells(constraints, window, gap)
    if cells > most_cells:
        raise JobError(
            f"window = {window} needs about {cells:,} numbers for each group of draws, allowed: "
            f"{most_cells:,}; take a smaller window or more memory",
            argument="window",
        )
    return _relaxation(constraints, window, gap)


def relaxation_within(constraints: Constraints, measurements: int, most_cells: int) -> Relaxation:
    """The first relaxation of a search, within a memory; it always exists.

    It has windows of `WINDOW` measurements with gaps of up to three mean gaps, or down to 1.2 if
    three need too much memory. If these are too many, because measurements are few and far apart,
    it has only windows of one measurement, and longer ones grow from them. The arguments are those
    of `relaxation_for`.
    """
    for window, least in ((WINDOW, _LEAST_OF_A_SEARCH), (1, 3.0)):
        gap = _longest_gap(constraints, window, measurements, most_cells, least)
        if window == 1 or _cells(constraints, window, gap) <= most_cells:
            break
    return _relaxation(constraints, window, gap)


def _longest_gap(
    constraints: Constraints, window: int, measurements: int, most_cells: int, least: float
) -> int:
    """The longest gap: three mean gaps, or less if memory demands it, but not below `least`."""
    instants = constraints.horizon + 1
    shortest, gap = (
        min(math.ceil(gaps * instants / (measurements + 1)), instants) for gaps in (least, 3.0)
    )
    while gap > shortest and _cells(constraints, window, gap) > most_cells:
        gap -= 1
    return gap


def _cells(constraints: Constraints, window: int, longest_gap: int) -> int:
    instants, points = constraints.horizon + 1, constraints.points
    windows = points.number * points.first(longest_gap) ** (window - 1)
    return int(windows * longest_gap) + instants * points.number


def _relaxation(constraints: Constraints, window: int, longest_gap: int) -> Relaxation:
    """The relaxation with money in coarse units."""
    unit = 1 if constraints.counted else math.ceil(constraints.total / MOST_UNITS)
    return replace(relaxation_with(constraints, window, longest_gap), unit=unit)
