"""Sets of times in which a run of successive times moves by one allowed time."""

from pfdist.times.feasible import Feasible
from pfdist.times.measurement_times import Times

_LONGEST_RUN = 48
"""The most times of a run that is shifted, so that a set of N times has at most 96 N shifts.

A shift changes only the gaps at the ends of a run. The ends of a longer run lie so far apart that
the error around one end tells nothing about the other. Shifts of shorter runs then do as well.
"""


def shifts(feasible: Feasible, times: Times) -> list[Times]:
    """The feasible sets in which a run of at most 48 successive times moves by one allowed time."""
    allowed, places = feasible.allowed, [feasible.index[time] for time in times]
    shifted = dict[Times, None]()
    runs = (
        (first, stop)
        for first in range(len(times))
        for stop in range(first + 1, min(first + _LONGEST_RUN, len(times)) + 1)
    )
    for first, stop in runs:
        for step in (-1, 1):
            moved = [place + step for place in places[first:stop]]
            if moved[0] >= 0 and moved[-1] < len(allowed):
                run = (allowed[place] for place in moved)
                shifted[(*times[:first], *run, *times[stop:])] = None
    return [new for new in shifted if len({*new}) == len(new) and feasible.accepts(new)]
