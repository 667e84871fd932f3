"""Sets of measurement times: check, make regular ones, draw random ones."""

from collections.abc import Iterable
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pfdist.errors import MeasurementTimesError, shown

Times = tuple[int, ...]
REGULAR: Final = "regular"  # what the regular times are called in jobs and tables


def validated(measurement_times: Iterable[int], horizon: int, where: str = "") -> Times:
    """Check a set of measurement times and sort it.

    Parameters
    ----------
    measurement_times : iterable of int
    horizon : int
        T; the times lie in 0..T.
    where : str
        What to name in an error, for instance the option or the key they came from.

    Returns
    -------
    tuple of int
        Sorted.

    Raises
    ------
    MeasurementTimesError
        A time is not an integer, lies outside 0..T, or stands twice.

    Examples
    --------
    >>> validated([5, 0, 3], horizon=10)
    (0, 3, 5)
    """
    place = f" ({where})" if where else ""
    times = list(measurement_times)
    for time in times:
        if isinstance(time, bool) or not isinstance(time, (int, np.integer)):
            raise MeasurementTimesError(
                f"measurement_times must be integers, got {shown(time)}{place}"
            )
        if not 0 <= time <= horizon:
            raise MeasurementTimesError(
                f"measurement_times must lie in 0..{horizon}, got {shown(int(time))}{place}"
            )
    ordered = tuple(sorted(int(time) for time in times))
    for time, following in pairwise(ordered):
        if time == following:
            raise MeasurementTimesError(
                f"measurement_times must differ from each other, got {time} twice{place}"
            )
    return ordered


def regular(horizon: int, measurement_budget: int) -> Times:
    """Regular times M_REG (paper, equation 13): Round[k T / (N-1)], halves rounded up.

    Parameters
    ----------
    horizon : int
        T.
    measurement_budget : int
        N, 2..T+1.

    Returns
    -------
    tuple of int, (N,)

    Raises
    ------
    MeasurementTimesError
        N is 1, for which the formula divides by zero, or does not lie in 2..T+1.

    Examples
    --------
    >>> regular(horizon=60, measurement_budget=5)
    (0, 15, 30, 45, 60)
    >>> regular(horizon=5, measurement_budget=3)  # 2.5 is rounded up
    (0, 3, 5)
    """
    if not 2 <= measurement_budget <= horizon + 1:
        raise MeasurementTimesError(
            f"regular times need a measurement_budget in 2..{horizon + 1} (horizon {horizon}), "
            f"got {measurement_budget}"
        )
    intervals = measurement_budget - 1
    # floor(a/b + 1/2) in integers
    return tuple((2 * k * horizon + intervals) // (2 * intervals) for k in range(intervals + 1))


def random(
    horizon: int, measurement_budget: int, sets: int, rng: np.random.Generator
) -> NDArray[np.int64]:
    """Draw sets of measurement times, each of the same probability.

    Parameters
    ----------
    horizon : int
    measurement_budget : int
    sets : int
    rng : numpy.random.Generator

    Returns
    -------
    array of int64, (sets, N)
        Each row sorted.

    Raises
    ------
    MeasurementTimesError
        N does not lie in 0..T+1.
    """
    if not 0 <= measurement_budget <= horizon + 1:
        raise MeasurementTimesError(
            f"random times need a measurement_budget in 0..{horizon + 1} (horizon {horizon}), "
            f"got {measurement_budget}"
        )
    order = rng.permuted(np.tile(np.arange(horizon + 1), (sets, 1)), axis=1)
    return np.sort(order[:, :measurement_budget], axis=1)


def nearest(wanted: Times, usable: Times, required: Times, spacing: int) -> Times:
    """Give as many usable times as near to those wanted as can be.

    Parameters
    ----------
    wanted : tuple of int, (N,)
        Sorted.
    usable : tuple of int
        Sorted.
    required : tuple of int
        Those of them that must be taken; the others are no nearer to them than the spacing.
    spacing : int
        Least difference of two times.

    Returns
    -------
    tuple of int, (N,)
        Sorted; the sum of the distances to those wanted, one by one, is the least. Of several such
        sets, that whose last time is the earliest, then the last but one, and so on.

    Raises
    ------
    MeasurementTimesError
        There are not so many usable times that are far enough from each other.

    References
    ----------
    Bellman, "Dynamic programming", 1957.

    Examples
    --------
    >>> nearest((0, 5, 10), usable=(1, 2, 3, 4, 6, 8, 9), required=(), spacing=3)
    (1, 4, 9)
    """
    times, last = np.array(usable), len(usable) - 1
    taken = np.isin(times, required).nonzero()[0].tolist()
    # Those that may come before each: far enough away, with no required one left out between them.
    stops = np.searchsorted(times, times - spacing, side="right").tolist()
    starts = [max((i for i in taken if i < place), default=0) for place in range(len(times))]
    first_taken, last_taken = (taken[0], taken[-1]) if taken else (last, 0)
    distance = np.full(len(times), np.inf)
    before: list[list[int]] = []
    for number, time in enumerate(wanted):
        here = np.abs(times - time).astype(np.float64)
        if number == 0:
            here[first_taken + 1 :] = np.inf
        else:
            before.append([])
            for place, (start, stop) in enumerate(zip(starts, stops, strict=True)):
                best = start + int(distance[start:stop].argmin()) if start < stop else -1
                before[-1].append(best)
                here[place] += distance[best] if best >= 0 else np.inf
        distance = here
    if wanted and not np.isfinite(distance[last_taken:]).any():
        raise MeasurementTimesError(
            f"there must be {len(wanted)} usable times at least {spacing} apart, got {usable}"
        )
    places = [last_taken + int(distance[last_taken:].argmin())] if wanted else []
    for previous in reversed(before):
        places.append(previous[places[-1]])
    return tuple(int(times[place]) for place in reversed(places))
