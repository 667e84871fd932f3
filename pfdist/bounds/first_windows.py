"""The relaxation before its windows grow: all windows up to a number of measurements."""

import math

from pfdist.bounds.relaxation import NOTHING, START, Relaxation, Window, followers, in_order
from pfdist.errors import JobError, MeasurementTimesError
from pfdist.times.constraints import Constraints


def relaxation_with(constraints: Constraints, window: int, longest_gap: int) -> Relaxation:
    """Give the relaxation that knows all windows of at most so many measurements.

    Windows with a gap longer than the longest gap are not known. The instants before the first
    measurement of a set are no gap.

    Raises
    ------
    MeasurementTimesError
        The window or the longest gap is less than 1.
    """
    if window < 1:
        raise MeasurementTimesError(f"window must be at least 1, got {window}")
    found: set[Window] = {START, *((time,) for time in constraints.allowed)}
    new = list(found)
    while new:
        shorter = new.pop()
        if len(shorter) == window:
            continue
        last = shorter[-1]
        until = constraints.horizon if last == NOTHING else last + longest_gap
        longer = [(*shorter, time) for time in followers(constraints, last) if time <= until]
        new += longer
        found.update(longer)
    return Relaxation(constraints, in_order(found), longest_gap)


def relaxation_for(
    constraints: Constraints, window: int, measurements: int, most_cells: int
) -> Relaxation:
    """Give the relaxation that knows all windows of at most so many measurements, within a memory.

    The longest gap is three mean gaps, or less if that needs too much memory, but at least two.

    Parameters
    ----------
    constraints : Constraints
    window : int
        Largest number of measurements of a window.
    measurements : int
        Usual number of measurements of a set, which gives the mean gap. The relaxation holds for
        sets of any number.
    most_cells : int
        Largest number of errors that count.

    Raises
    ------
    JobError
        The relaxation has more errors than allowed.
    """
    instants = constraints.horizon + 1
    two, three = (min(math.ceil(gaps * instants / (measurements + 1)), instants) for gaps in (2, 3))

    def cells(longest_gap: int) -> int:
        return int(instants * longest_gap ** (window - 1) * longest_gap) + instants**2

    longest_gap = three
    while longest_gap > two and cells(longest_gap) > most_cells:
        longest_gap -= 1
    if cells(longest_gap) > most_cells:
        raise JobError(
            f"window = {window} needs about {cells(longest_gap):,} numbers for each group of "
            f"draws, allowed: {most_cells:,}; try pfdist bound --window 1, or more --memory",
            argument="window",
        )
    return relaxation_with(constraints, window, longest_gap)
