"""Evenly spaced times: the grids of which the best one is the opponent of a plan.

A person who spaces N measurements evenly is free to choose the first time and the last. Where they
lie matters: on the paper's problem the expected MSE of 21 evenly spaced times is 31.5 from the
first instant to the last (paper, equation 13), and 28.4 with the best ends.
"""

from collections.abc import Iterator
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times
from pfdist.errors import MeasurementTimesError
from pfdist.problem.affordable import nearest
from pfdist.problem.feasible import Feasible

_ENDS, _PLACES = 7, 4
_NUMBERS = 12  # of visits, at most
_MOST = 5_000  # grids of whole steps, about
_PARTS = (0.75, 0.5, 0.25)  # of the horizon, from its beginning and up to its end


def even_grids(feasible: Feasible, *, ends: int = _ENDS, every: bool = False) -> tuple[Times, ...]:
    """Different evenly spaced sets of as many measurements as the regular times, which come first.

    Each is t = first + k * step, moved to the nearest instants, and then, if it is not feasible, to
    the nearest feasible set of instants. A set in which two times would be one instant is left out.
    With several sensors these are regular times of each sensor alone, and of all in rotation. With
    visits, these are evenly spaced, as many as possible or fewer, and so are the measurements of
    each; one sensor measures.

    `ends` is the number of first times, and that of last times, over one step from an end of the
    horizon. Whole steps, which few measurements of an oscillation may need, have four places, or
    all if `every` and these are not too many.

    >>> grids = even_grids(Feasible(horizon=11, measurement_budget=4))
    >>> grids[0], (0, 3, 6, 9) in grids, len(grids)
    ((0, 4, 7, 11), True, 41)
    """
    regular, points = feasible.regular(), feasible.points
    instants = np.array(points.clock.times, np.float64)
    if feasible.visits:
        fewer = np.geomspace(max(1, feasible.visits.number(regular)), 1, _NUMBERS).round()
        numbers = dict.fromkeys(fewer.astype(int).tolist())
        spans = ((number, span) for number in numbers for span in _spans(instants, number, ends))
        targets = [np.linspace(*span, number).tolist() for number, span in spans]
        near = (feasible.visits_near(each, way) for way in range(points.ways) for each in targets)
        return tuple(dict.fromkeys((regular, *(times for times in near if times))))
    if points.ways > 1:
        return tuple(dict.fromkeys((regular, *feasible.references.values())))
    found, number = [regular], len(regular)
    grids = [
        tuple(np.abs(instants - np.linspace(*span, number)[:, None]).argmin(axis=1).tolist())
        for span in _spans(instants, number, ends)
    ]
    longest = max(1, feasible.horizon // max(1, number - 1))
    few = np.geomspace(1, longest, 3 * ends + 3).round().astype(int).tolist()
    every = every and longest * feasible.horizon < 2 * _MOST
    for step in range(1, longest + 1) if every else {*few}:
        left = feasible.horizon - (number - 1) * step
        firsts = np.linspace(0, left, left + 1 if every else _PLACES).round().astype(int).tolist()
        grids += [tuple(range(first, first + number * step, step)) for first in firsts]
    for grid in grids:
        if len({*grid}) < number:
            continue
        if feasible.accepts(grid):
            found.append(grid)
            continue
        with suppress(MeasurementTimesError):
            moved = nearest(grid, feasible.allowed, feasible.required, feasible.spacing)
            found += [moved] if feasible.accepts(moved) else []
    return tuple(dict.fromkeys(found))


def _spans(instants: NDArray[np.float64], number: int, ends: int) -> Iterator[tuple[float, float]]:
    """The first time and the last of each grid; a single time is anywhere in the horizon."""
    begin, end = float(instants[0]), float(instants[-1])
    if number == 1:
        yield from ((time, time) for time in np.linspace(begin, end, ends).tolist())
        return
    inside = np.linspace(0.0, (end - begin) / (number - 1), ends).tolist()
    yield from ((begin + a, end - b) for a in inside for b in inside if begin + a < end - b)
    for part in _PARTS:
        length = part * (end - begin)
        yield from ((begin, begin + length), (end - length, end))
