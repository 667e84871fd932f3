"""The error of each compared set over time, on all draws of the comparison.

The table ``range_sums`` has sums of the errors at each instant over ranges of draws. The number of
draws of a range is a power of 2 and divides its first draw, and a sum is that over its first half
plus that over its second. So the table does not depend on how draws were cut into tasks. Ranges
also give standard errors, and those of differences of two sets.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.common.clock import Clock
from pfdist.common.measurement_times import Times
from pfdist.results.stored_run import StoredRun, problem_of

if TYPE_CHECKING:
    import pandas as pd

Array = NDArray[np.float64]

RANGE_SUMS = "range_sums"
"""Name of the table."""
_FEWEST = 32  # ranges of a comparison, if it has so many draws: standard errors are as good as that


class Range(NamedTuple):
    """The errors of S sets at each instant, summed over a range of draws; 0 draws: exact."""

    first: int
    draws: int
    sums: Array  # (S, T+1)

    @property
    def end(self) -> int:
        """The draw after the last."""
        return self.first + self.draws


def longest_range(draws: int) -> int:
    """The largest number of draws of a range in a comparison of so many draws."""
    return int(1 << max(0, (draws // _FEWEST).bit_length() - 1))


def read_ranges(rows: pd.DataFrame) -> list[Range]:
    """The ranges in rows of the table, in order; a range that is part of another is left out."""
    found = list[Range]()
    rows = rows.sort_values(["draw", "draws", "position"], ascending=[True, False, True])
    for (first, draws), sums in rows.groupby(["draw", "draws"], sort=False)["sums"]:
        if not found or first >= found[-1].end:
            found.append(Range(int(first), int(draws), np.stack([*sums])))
    return found


def joined_ranges(ranges: Iterable[Range], most: int) -> list[Range]:
    """The longest ranges, of at most so many draws, that successive ranges make up."""
    whole = list[Range]()
    for each in ranges:
        whole.append(each)
        while len(whole) > 1 and _are_halves(*whole[-2:], most):
            first, second = whole[-2:]
            whole[-2:] = [Range(first.first, 2 * first.draws, first.sums + second.sums)]
    return whole


def _are_halves(first: Range, second: Range, most: int) -> bool:
    draws = 2 * first.draws
    return first.draws == second.draws and draws <= most and not first.first % draws


def error_over_time(run: StoredRun) -> pd.DataFrame:
    """A row for each compared set and instant: the columns of `profile`, for all compared draws."""
    ranges, clock = read_ranges(run.table(RANGE_SUMS)), problem_of(run).clock
    sets = {name: clock.measurements(times) for name, times in run.sets.items()}
    draws = sum(each.draws for each in ranges)
    estimates = [_estimates(ranges, place) for place in range(len(sets))]
    return profile(clock, sets, estimates, draws)


def difference_over_time(run: StoredRun, name: str, reference: str) -> tuple[Array, Array]:
    """The error of a set at each instant less that of another, and its standard error, (T+1,)."""
    ranges, names = read_ranges(run.table(RANGE_SUMS)), run.names
    places = names.index(name), names.index(reference)
    return _estimates(ranges, *places)


def profile(
    clock: Clock, sets: Mapping[str, Times], estimates: Iterable[tuple[Array, Array]], draws: int
) -> pd.DataFrame:
    """A row for each set and instant, from the estimate of each set's error over time.

    The columns are name (of the set), t, measured (whether the set measures at t), draws (0: the
    error is exact), error (the expected error at t) and standard_error. Errors are weighted and
    scaled as in the MSE, and less their controls if there are any: their mean over time is the
    expected MSE.

    Parameters
    ----------
    clock : Clock
    sets : mapping of str to tuple of int
        Possible measurements of the clock, by the name of the set.
    estimates : iterable of pair of array, (T+1,)
        The error of each set at each instant, and its standard error.
    draws : int
    """
    import pandas as pd  # noqa: PLC0415  it loads when tables are made

    tables = list[Any]()
    for (name, times), (error, standard_error) in zip(sets.items(), estimates, strict=True):
        at = {time // max(1, len(clock.sensors)) for time in times}
        columns = {
            "name": name,
            "t": clock.times,
            "measured": [t in at for t in range(len(clock.times))],
            "draws": draws,
            "error": error,
            "standard_error": standard_error,
        }
        tables.append(pd.DataFrame(columns))
    table = pd.concat(tables, ignore_index=True)
    if not clock.counts:
        table.attrs["time_unit"] = clock.unit
    return table


def _estimates(
    ranges: Sequence[Range], place: int, other: int | None = None
) -> tuple[Array, Array]:
    """The error of a set at each instant, less that of another, and its standard error, (T+1,).

    Ranges count by their draws. With one draw each, this is the standard error of a mean.
    """
    sums = np.stack([each.sums[place] for each in ranges])
    if other is not None:
        sums = sums - [each.sums[other] for each in ranges]
    draws = np.array([max(1, each.draws) for each in ranges])[:, None]  # 0: exact, of one draw
    with np.errstate(invalid="ignore"):
        mean = sums.sum(axis=0) / draws.sum()
        squares = (draws * (sums / draws - mean) ** 2).sum(axis=0)
    if not ranges[0].draws:
        return mean, np.zeros_like(mean)
    with np.errstate(invalid="ignore", divide="ignore"):
        return mean, np.sqrt(squares / np.float64(len(ranges) - 1) / draws.sum())
