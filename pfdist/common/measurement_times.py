"""A set of measurement times: its check, and regular and random sets."""

from collections.abc import Iterable
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from pfdist.errors import MeasurementTimesError, shown

Times = tuple[int, ...]
Lag = int | tuple[int, ...]
"""Instants after t whose measurements the estimate of z(t) uses: of all t, or (T+1,) of each."""
REGULAR: Final = "regular"  # name of the regular times in jobs and tables
EVEN: Final = "evenly_spaced"  # name of the best evenly spaced times in tables
MOST_REGULAR: Final = 2  # so few times are always evenly spaced: their opponent is regular times
CLOCK: Final = ("time", "dt")
"""Parameters that the clock of a job gives: the time of each instant, and the time to the next."""
DATES: Final = ("day_of_year", "hour", "weekday")
"""Parameters that the dates of a job give, unless a model has its own of this name."""


def validated(measurement_times: Iterable[int], horizon: int, where: str = "") -> Times:
    """A set of measurement times in 0..horizon, sorted, after a check.

    Raises `MeasurementTimesError` if a time is not an integer, lies outside, or is given twice. Its
    message ends with `where` the times came from, for instance the option or the key.

    >>> validated([5, 0, 3], horizon=10)
    (0, 3, 5)
    """
    origin = f" ({where})" if where else ""
    if isinstance(measurement_times, str | bytes) or not isinstance(measurement_times, Iterable):
        raise MeasurementTimesError(
            f"measurement_times must be a list of integers, got {shown(measurement_times)}{origin}"
        )
    times = list(measurement_times)
    for time in times:
        if isinstance(time, bool) or not isinstance(time, (int, np.integer)):
            raise MeasurementTimesError(
                f"measurement_times must be integers, got {shown(time)}{origin}"
            )
        if not 0 <= time <= horizon:
            raise MeasurementTimesError(
                f"measurement_times must lie in 0..{horizon}, got {shown(int(time))}{origin}"
            )
    ordered = tuple(sorted(int(time) for time in times))
    for time, following in pairwise(ordered):
        if time == following:
            raise MeasurementTimesError(
                f"measurement_times must differ from each other, got {time} twice{origin}"
            )
    return ordered


def regular(horizon: int, measurement_budget: int) -> Times:
    """The regular times M_REG (paper, equation 13): Round[k T / (N-1)], halves rounded up.

    For N = 1 the formula divides by zero; the single time is in the middle, Round[T / 2]. Raises
    `MeasurementTimesError` if N does not lie in 1..T+1.

    >>> regular(horizon=60, measurement_budget=5)
    (0, 15, 30, 45, 60)
    >>> regular(horizon=5, measurement_budget=3)  # 2.5 is rounded up
    (0, 3, 5)
    >>> regular(horizon=5, measurement_budget=1)
    (3,)
    """
    if not 1 <= measurement_budget <= horizon + 1:
        raise MeasurementTimesError(
            f"regular times need a measurement_budget in 1..{horizon + 1} (horizon {horizon}), "
            f"got {measurement_budget}"
        )
    if measurement_budget == 1:
        return ((horizon + 1) // 2,)
    intervals = measurement_budget - 1
    # floor(a/b + 1/2) in integers
    return tuple((2 * k * horizon + intervals) // (2 * intervals) for k in range(intervals + 1))


def random(
    horizon: int, measurement_budget: int, sets: int, rng: np.random.Generator
) -> NDArray[np.int64]:
    """Draw sets of N measurement times with equal probability, (sets, N); each row is sorted."""
    order = rng.permuted(np.tile(np.arange(horizon + 1), (sets, 1)), axis=1)
    return np.sort(order[:, :measurement_budget], axis=1)


def random_below(bound: int, rng: np.random.Generator) -> int:
    """Draw an integer in 0..bound-1; all have the same probability. The bound may be huge."""
    bits = (bound - 1).bit_length()
    while True:
        number = int.from_bytes(rng.bytes(-(-bits // 8)), "little") >> (-bits % 8)
        if number < bound:
            return number


def last_used(lag: Lag, instants: range) -> NDArray[np.int64]:
    """The last measurement that the estimate of each instant uses, (K,); all count from the first.

    With longer steps a lag has fewer instants, but no estimate uses fewer than an earlier one.
    """
    own = lag[instants.start : instants.stop] if isinstance(lag, tuple) else lag
    last: NDArray[np.int64] = np.minimum(np.arange(len(instants)) + own, len(instants) - 1)
    return last


def first_smoothed(lag: Lag, instants: range) -> NDArray[np.int64]:
    """The first instant whose estimate uses the measurement at each instant, (K,)."""
    return np.searchsorted(last_used(lag, instants), np.arange(len(instants)))
