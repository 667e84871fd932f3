"""Sets of measurement times: check, make regular ones, draw random ones."""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from pfdist.errors import MeasurementTimesError

Times = tuple[int, ...]


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
            raise MeasurementTimesError(f"measurement_times must be integers, got {time!r}{place}")
        if not 0 <= time <= horizon:
            raise MeasurementTimesError(
                f"measurement_times must lie in 0..{horizon}, got {time}{place}"
            )
    twice = {time for time in times if times.count(time) > 1}
    if twice:
        raise MeasurementTimesError(
            f"measurement_times must differ from each other, got {min(twice)} twice{place}"
        )
    return tuple(sorted(int(time) for time in times))


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
