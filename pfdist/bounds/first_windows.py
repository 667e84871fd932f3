"""The first relaxations: all windows up to a number of measurements, before windows grow."""

import math
from dataclasses import replace

from pfdist.bounds.relaxation import NOTHING, START, Relaxation, Window, followers, in_order
from pfdist.errors import JobError, MeasurementTimesError
from pfdist.times.constraints import Constraints

WINDOW = 2
"""Largest number of measurements of the first windows, unless another number is wanted."""

MOST_UNITS = 300
"""Largest sum of money in a programme, in units; the memory of a programme grows with the sum."""

_LEAST_OF_A_SEARCH = 1.2
"""Least number of mean gaps between measurements that windows of a search must allow."""


def relaxation_with(constraints: Constraints, window: int, longest_gap: int) -> Relaxation:
    """The relaxation with all windows of at most `window` measurements.

    Windows with a gap longer than the longest gap are left out. The instants before the first
    measurement of a set are no gap. A `MeasurementTimesError` says that the window or the gap is
    less than 1.
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
        sensors = constraints.sensors
        until = constraints.horizon if last == NOTHING else last // sensors + longest_gap
        longer = [
            (*shorter, time) for time in followers(constraints, last) if time // sensors <= until
        ]
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
    at most `MOST_UNITS`. A `JobError` says that more than `most_cells` errors count.
    """
    gap = _longest_gap(constraints, window, measurements, most_cells, least=2.0)
    cells = _cells(constraints, window, gap)
    if cells > most_cells:
        raise JobError(
            f"window = {window} needs about {cells:,} numbers for each group of draws, allowed: "
            f"{most_cells:,}",
            argument="window",
        )
    return _relaxation(constraints, window, gap)


def relaxation_within(constraints: Constraints, measurements: int, most_cells: int) -> Relaxation:
    """The relaxation with which a search begins, within a memory; none is refused.

    It has windows of `WINDOW` measurements with gaps of up to three mean gaps, or down to 1.2 if
    three need too much memory. If these are too many, it has only single measurements, and windows
    grow from them. This happens if few measurements lie far apart. The arguments are those of
    `relaxation_for`.
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
    """About how many errors count."""
    instants, sensors = constraints.horizon + 1, constraints.sensors
    windows = instants * sensors * (longest_gap * sensors) ** (window - 1)
    return int(windows * longest_gap) + instants**2 * sensors


def _relaxation(constraints: Constraints, window: int, longest_gap: int) -> Relaxation:
    """The relaxation with money in coarse units."""
    unit = 1 if constraints.counted else math.ceil(constraints.total / MOST_UNITS)
    return replace(relaxation_with(constraints, window, longest_gap), unit=unit)
