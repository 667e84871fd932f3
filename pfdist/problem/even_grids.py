"""Evenly spaced times: the grids of which the best one is the opponent of a plan.

A person who spaces N measurements evenly is free to choose the first time and the last. Where they
lie matters: on the paper's problem the expected MSE of 21 evenly spaced times is 31.2 from the
first instant to the last (paper, equation 13), and 27.1 with the best ends.
"""

import math
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times
from pfdist.errors import MeasurementTimesError
from pfdist.problem.affordable import nearest
from pfdist.problem.feasible import Feasible

MOST = 1000  # grids, so that the paper's problem has all of them
_OF_VISITS = 60  # grids of a number of visits
_NUMBERS = 12  # of visits, at most


def even_grids(feasible: Feasible, most: int = MOST) -> tuple[Times, ...]:
    """Different evenly spaced sets of as many measurements as the regular times, which come first.

    They begin and end at any two instants, or at every k-th one if these are more than `most`
    pairs. Times between are moved to the nearest instants, and a set that is not feasible to the
    nearest feasible one. A set in which two times would be one instant is left out. With several
    sensors these are regular times of each sensor alone, and of all in rotation. With visits, these
    are evenly spaced, as many as possible or fewer, and so are the measurements of each; one sensor
    measures.

    >>> grids = even_grids(Feasible(horizon=11, measurement_budget=4))
    >>> grids[0], (0, 3, 6, 9) in grids, len(grids)
    ((0, 4, 7, 11), True, 45)
    """
    regular, points = feasible.regular(), feasible.points
    instants = np.array(points.clock.times, np.float64)
    if feasible.visits:
        fewer = np.geomspace(max(1, feasible.visits.number(regular)), 1, _NUMBERS).round()
        numbers = dict.fromkeys(fewer.astype(int).tolist())
        targets = [
            np.linspace(first, last, number).tolist()
            for number in numbers
            for first, last in instants[_ends(len(instants), number, _OF_VISITS)]
        ]
        near = (feasible.visits_near(each, way) for way in range(points.ways) for each in targets)
        return tuple(dict.fromkeys((regular, *(times for times in near if times))))
    if points.ways > 1:
        return tuple(dict.fromkeys((regular, *feasible.references.values())))
    found, number = [regular], len(regular)
    for first, last in instants[_ends(len(instants), number, most)]:
        even = np.linspace(first, last, number)
        grid = tuple(np.abs(instants - even[:, None]).argmin(axis=1).tolist())
        if len({*grid}) < number:
            continue
        if feasible.accepts(grid):
            found.append(grid)
            continue
        with suppress(MeasurementTimesError):
            moved = nearest(grid, feasible.allowed, feasible.required, feasible.spacing)
            found += [moved] if feasible.accepts(moved) else []
    return tuple(dict.fromkeys(found))


def _ends(instants: int, number: int, most: int) -> NDArray[np.int64]:
    """The first and the last instant of each grid, (G, 2)."""
    last, shortest = instants - 1, number - 1
    if number == 1:
        return np.linspace(0, last, min(most, instants)).round().astype(int)[:, None].repeat(2, 1)
    stride = max(1, math.ceil((last - shortest) / math.sqrt(2 * most)))
    while True:
        first, end = np.arange(0, instants, stride), np.arange(last, -1, -stride)
        pairs = np.stack(np.meshgrid(first, end, indexing="ij"), axis=-1).reshape(-1, 2)
        pairs = pairs[pairs[:, 1] - pairs[:, 0] >= shortest]
        if len(pairs) <= most:
            return pairs
        stride += 1
