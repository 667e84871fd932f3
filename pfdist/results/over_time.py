"""The error of sets over time, from sums of the errors at each instant over ranges of draws.

The table ``range_sums`` has those of all draws of the comparison. The number of draws of a range is
a power of 2 and divides its first draw, and a sum is that over its first half plus that over its
second. So the table does not depend on how draws were cut into tasks. Ranges also give standard
errors. `evaluate` and `why` have ranges of their own draws.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times
from pfdist.problem.problem_section import ProblemSection
from pfdist.results.stored_run import StoredRun, measured_of, problem_of
from pfdist.store.tables import first_occurrences

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


def read_ranges(rows: pa.Table) -> list[Range]:
    """The ranges in rows of the table, in order; a range that is part of another is left out."""
    found = list[Range]()
    draw, draws, position, sums = (
        rows[name].to_numpy() for name in ("draw", "draws", "position", "sums")
    )
    order = np.lexsort((position, -draws, draw))
    draw, draws, sums = draw[order], draws[order], sums[order]
    starts = np.flatnonzero(first_occurrences(draw, draws)).tolist()
    for start, end in pairwise([*starts, len(draw)]):
        first = int(draw[start])
        if not found or first >= found[-1].end:
            found.append(Range(first, int(draws[start]), np.stack([*sums[start:end]])))
    return found


def joined_ranges(ranges: Iterable[Range], most: int) -> list[Range]:
    """The longest ranges, of at most so many draws, that successive ranges make up."""
    whole = list[Range]()
    for each in ranges:
        whole.append(each)
        while len(whole) > 1:
            first, second = whole[-2:]
            draws = 2 * first.draws
            if first.draws != second.draws or draws > most or first.first % draws:
                break
            whole[-2:] = [Range(first.first, draws, first.sums + second.sums)]
    return whole


def error_over_time(run: StoredRun) -> pd.DataFrame:
    """A row for each compared set and instant: the expected error then.

    The columns are name (of the set); t; measured (whether the set measures then); draws (0:
    exact); weight (of the instant in the MSE; the mean is 1); error and standard_error. The
    weighted mean of errors is the expected MSE.
    """
    import pandas as pd  # noqa: PLC0415  it loads when tables are made

    ranges, problem, tables = ranges_of(run), problem_of(run), list[pd.DataFrame]()
    for place, (name, times) in enumerate(measured_of(run).items()):
        tables.append(profile_of(problem, times, ranges, place))
        tables[-1].insert(0, "name", name)
    table = pd.concat(tables, ignore_index=True)
    table.attrs.update(tables[0].attrs)
    return table


def ranges_of(run: StoredRun) -> list[Range]:
    """The ranges of a comparison."""
    return read_ranges(run._store.rows(RANGE_SUMS))


def profile_of(
    problem: ProblemSection, times: Times, ranges: Sequence[Range], place: int
) -> pd.DataFrame:
    """A row for each instant, with the error of the set at a place of some ranges.

    The columns are those of `error_over_time` but the name. The times are points of the problem.
    """
    import pandas as pd  # noqa: PLC0415  it loads when tables are made

    clock = problem.clock
    error, standard_error = errors_over_time_of(ranges, place)
    at = problem.points.made(times)
    table = pd.DataFrame(
        {
            **clock.columns(range(len(clock.times))),
            "measured": [t in at for t in range(len(clock.times))],
            "draws": sum(each.draws for each in ranges),
            "weight": problem.weights or 1.0,
            "error": error,
            "standard_error": standard_error,
        }
    )
    if not clock.counts:
        table.attrs["time_unit"] = clock.time_unit
    return table


def errors_over_time_of(ranges: Sequence[Range], place: int) -> tuple[Array, Array]:
    """The error of a set at each instant, and its standard error, (T+1,).

    Ranges count by their draws. With one draw each, this is the standard error of a mean.
    """
    sums = np.stack([each.sums[place] for each in ranges])
    draws = np.array([max(1, each.draws) for each in ranges])[:, None]  # 0: exact, of one draw
    with np.errstate(invalid="ignore"):
        mean = sums.sum(axis=0) / draws.sum()
        squares = (draws * (sums / draws - mean) ** 2).sum(axis=0)
    if not ranges[0].draws:
        return mean, np.zeros_like(mean)
    with np.errstate(invalid="ignore", divide="ignore"):
        return mean, np.sqrt(squares / np.float64(len(ranges) - 1) / draws.sum())
