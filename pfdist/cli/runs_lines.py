"""The lines of a table of runs, which fits a terminal if at all possible."""

import textwrap
from typing import Any

import pandas as pd

from pfdist.analysis.table_cells import keys_of, told_by_keys, told_gain, told_mse, told_value
from pfdist.cli.aligned import Column, aligned, width_of
from pfdist.cli.layout import COLUMNS
from pfdist.common.short_names import short_names
from pfdist.common.told_counts import told_seconds
from pfdist.errors import one_line

_RUN, _SET, _MSE, _GAIN, _SECONDS = "run", "set", "expected MSE", "gain %", "seconds"
_MOST_NAMES = 6  # of columns that are left out


def runs_lines(frame: pd.DataFrame) -> list[str]:
    """Give the lines of a table of runs, and below it what a gain is and what is left out.

    Columns are left out if the table does not fit: first keys that some jobs lack, then the name
    of the run where the keys tell all runs apart, then the seconds, then other keys.

    Parameters
    ----------
    frame : DataFrame
        As `pfdist.table` gives it.
    """
    keys = keys_of(frame)
    columns = _columns(frame, keys)
    shown = _fitting(frame, keys, columns)
    lines = aligned([columns[name] for name in shown])
    references = sorted(set(frame["reference"].dropna().astype(str)))
    if references:
        other = references[0] if len(references) == 1 else "the reference"
        text = f"gain %: how far the expected MSE is below that of {other} (95 %)"
        lines += ["", *textwrap.wrap(one_line(text), COLUMNS)]
    left_out = [name for name in columns if name not in shown]
    if left_out:
        names = ", ".join(left_out[:_MOST_NAMES])
        more = f" and {len(left_out) - _MOST_NAMES} more" if len(left_out) > _MOST_NAMES else ""
        text = f"--json and --out also show: {names}{more}"
        lines += textwrap.wrap(one_line(text), COLUMNS, break_on_hyphens=False)
    return lines


def _columns(frame: pd.DataFrame, keys: list[str]) -> dict[str, Column]:
    rows = frame.to_dict("records")
    short = short_names(keys)
    columns = {_RUN: Column(_RUN, [one_line(str(row["run"])) for row in rows])}
    for key in keys:
        is_number = pd.api.types.is_numeric_dtype(frame[key])
        columns[key] = Column(
            short[key], [one_line(told_value(row[key])) for row in rows], is_number
        )
    columns[_SET] = Column(_SET, [told_value(row["set"]) for row in rows])
    # A row without results says how far its run is.
    columns[_MSE] = Column(_MSE, [told_mse(row) or _state(row) for row in rows])
    columns[_GAIN] = Column(_GAIN, [told_gain(row) for row in rows])
    seconds = [told_seconds(row["worker_seconds"]) for row in rows]
    columns[_SECONDS] = Column(_SECONDS, seconds, is_number=True)
    return columns


def _state(row: dict[Any, Any]) -> str:
    return "no other set" if row["state"] == "finished" else str(row["state"])


def _fitting(frame: pd.DataFrame, keys: list[str], columns: dict[str, Column]) -> list[str]:
    """Give the names of the columns that are shown."""
    shown = list(columns)
    lacking = [key for key in reversed(keys) if "" in columns[key].cells]
    others = [key for key in reversed(keys) if key not in lacking]
    for name in [*lacking, _RUN, _SECONDS, *others]:
        if width_of([columns[each] for each in shown]) <= COLUMNS:
            break
        if name != _RUN or _tell_apart(frame, keys, shown):
            shown.remove(name)
        if _RUN not in shown and not _tell_apart(frame, keys, shown):
            shown.insert(0, _RUN)
    return shown


def _tell_apart(frame: pd.DataFrame, keys: list[str], shown: list[str]) -> bool:
    """Whether the keys that are shown tell all runs apart."""
    return told_by_keys(frame, [key for key in keys if key in shown])
