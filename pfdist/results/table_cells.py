"""The cells of a table of runs as texts, rounded to the digits that their errors allow."""

import math
from collections.abc import Mapping
from typing import Any

import pandas as pd

from pfdist.common.formatted_times import formatted_time
from pfdist.common.percent import times_100
from pfdist.common.rounding import rounded, with_error, with_interval

Row = Mapping[Any, Any]
_LEADING = ("run", "set")


def keys_of(frame: pd.DataFrame) -> list[str]:
    """The columns of a table of runs that hold differing keys."""
    columns = list(map(str, frame.columns))
    first, last = (columns.index(name) for name in _LEADING)
    return columns[first + 1 : last]


def differ_by_keys(frame: pd.DataFrame, keys: list[str]) -> bool:
    """Whether no two runs of a table have the same values of all these keys."""
    texts = [tuple(formatted_value(row[key]) for key in keys) for row in frame.to_dict("records")]
    return len(set(zip(frame["run"], texts, strict=True))) == len(set(texts))


def formatted_value(value: Any) -> str:
    """The value of a key as text; empty if the job lacks it.

    Examples
    --------
    >>> [formatted_value(value) for value in (0.25, (0, 3.5), True, math.nan)]
    ['0.25', '0 3.5', 'true', '']
    """
    if isinstance(value, tuple | list):
        return " ".join(map(formatted_value, value))
    if is_missing(value):
        return ""
    if isinstance(value, bool):
        return str(value).lower()
    return formatted_time(value) if isinstance(value, float) else str(value)


def is_missing(value: Any) -> bool:
    """Whether a cell has no value."""
    return value is None or value is pd.NA or (isinstance(value, float) and math.isnan(value))


def formatted_mse(row: Row) -> str:
    """The expected MSE of a row with its standard error; empty if nothing was compared."""
    if math.isnan(row["expected_mse"]):
        return ""
    return with_error(row["expected_mse"], row["standard_error"])


def formatted_gain(row: Row, *, interval: bool = True) -> str:
    """The gain of means of a row in per cent, with its 95 % interval if wanted."""
    ends = (row["gain_of_means"], row["gain_of_means_low"], row["gain_of_means_high"])
    if math.isnan(ends[0]):
        return ""
    if ends[1] == ends[2]:
        return rounded(times_100(ends[0]))
    value, low, high = with_interval(*map(times_100, ends))
    return f"{value} ({low} to {high})" if interval else value
