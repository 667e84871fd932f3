"""Results of many runs by the values of their keys: means of replicates, with 95 % intervals."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from pfdist.common.estimate import Estimate
from pfdist.plugins.runs.runs_table import formatted_value, is_missing, keys_of_runs, shown_names
from pfdist.store.folder import natural_key

SEED = "seed"
"""The key whose values are replicates."""
SET = "set"

_ERRORS = {"expected_mse": "standard_error", "reference_mse": "reference_standard_error"}
_Values = tuple[Any, ...]


@dataclass(frozen=True)
class Average:
    """The mean over the runs that differ only in their seeds.

    Parameters
    ----------
    point : tuple
        Values of the columns that the runs share; None if a run lacks the key.
    mean, low, high : float
        The mean with its 95 % interval: by Student's t over two or more seeds, and by the error of
        the run if the table has no replicates. NaN is unknown.
    replicates : tuple of float
        The value of each seed.
    """

    point: _Values
    mean: float
    low: float
    high: float
    replicates: tuple[float, ...]


def columns_of_study(frame: pd.DataFrame) -> list[str]:
    """The columns that distinguish the rows of a table of runs: the set, and all keys but seed.

    Columns that have the same value in all rows are left out.
    """
    return [
        name
        for name in (SET, *keys_of_runs(frame))
        if name != SEED and len(values_of_points(frame, name)) > 1
    ]


def values_of_points(frame: pd.DataFrame, name: str) -> list[Any]:
    """The different values of a column in natural order; None comes last."""
    values = dict.fromkeys(map(plain, frame[name].tolist()))
    return sorted(values, key=_order)


def is_numeric(values: Sequence[Any]) -> bool:
    """Whether all values are numbers, so that an axis has them at their places.

    Examples
    --------
    >>> is_numeric([1, 2.5]), is_numeric([1, None]), is_numeric([True, False]), is_numeric(["a"])
    (True, False, False, False)
    """
    return all(
        isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        for value in values
    )


def still_varying(frame: pd.DataFrame, names: Sequence[str]) -> list[str]:
    """The columns that distinguish rows with the same values of some columns.

    A key that changes together with these columns is left out, as it distinguishes no more rows.

    Parameters
    ----------
    frame : DataFrame
    names : sequence of str
        Columns of the table.
    """
    columns, varying = list(names), list[str]()
    for name in columns_of_study(frame):
        if name not in columns and not _is_determined(frame, name, columns):
            columns.append(name)
            varying.append(name)
    return varying


def averages(frame: pd.DataFrame, names: Sequence[str], value: str) -> list[Average]:
    """The mean of a result for each combination of values, over the seeds.

    Parameters
    ----------
    frame : DataFrame
        A table of runs, the result of `pfdist.table`.
    names : sequence of str
        Columns of the table. Together with the seed, they distinguish all rows with different
        results.
    value : str
        A column with numbers. Rows without a number are left out.

    Returns
    -------
    list of Average
        In the order in which the combinations come in the table.
    """
    groups = dict[_Values, dict[Any, Mapping[Any, Any]]]()
    for row in frame.to_dict("records"):
        if not is_missing(row[value]):
            at = tuple(plain(row[name]) for name in names)
            groups.setdefault(at, {}).setdefault(plain(row.get(SEED)), row)
    has_replicates = any(len(rows) > 1 for rows in groups.values())
    return [_average(at, list(rows.values()), value, has_replicates) for at, rows in groups.items()]


def formatted_point(names: Sequence[str], values: _Values, keys: Sequence[str]) -> str:
    """Values of columns as text, with the shortest names that are clear among all keys.

    Examples
    --------
    >>> formatted_point(["set", "filter.particles"], ("genetic", 20), ["filter.particles"])
    'genetic, particles 20'
    """
    short = shown_names(keys)
    return ", ".join(
        formatted_value(value) or "no set" if name == SET
        else f"{short.get(name, name)} {formatted_value(value) or 'none'}"
        for name, value in zip(names, values, strict=True)
    )  # fmt: skip


def _average(
    at: _Values, rows: Sequence[Mapping[Any, Any]], value: str, has_replicates: bool
) -> Average:
    each = tuple(float(row[value]) for row in rows)
    if has_replicates:
        return Average(at, float(np.mean(each)), *Estimate.of_mean(np.array(each)).interval(), each)
    return Average(at, each[0], *_own_interval(rows[0], value), each)


def _own_interval(row: Mapping[Any, Any], value: str) -> tuple[float, float]:
    error = row.get(_ERRORS.get(value, ""), math.nan)
    if not is_missing(error):
        return Estimate(row[value], error).interval()
    return row.get(f"{value}_low", math.nan), row.get(f"{value}_high", math.nan)


def _is_determined(frame: pd.DataFrame, name: str, names: Sequence[str]) -> bool:
    """Whether rows with the same values of some columns have the same value of another."""
    values = dict[_Values, Any]()
    rows = ([plain(row[each]) for each in (*names, name)] for row in frame.to_dict("records"))
    return all(values.setdefault(tuple(at), value) == value for *at, value in rows)


def plain(value: Any) -> Any:
    """The value of a cell of a table; None if there is none."""
    return None if is_missing(value) else value


def _order(value: Any) -> tuple[int, float, list[tuple[float, str]]]:
    if value is None:
        return 2, 0.0, []
    if is_numeric([value]):
        return 0, float(value), []
    return 1, 0.0, natural_key(formatted_value(value))
