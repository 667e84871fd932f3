"""The lines of a list of runs."""

from datetime import UTC, datetime
from typing import Any

import pandas as pd

from pfdist.analysis.listed_run import FINISHED
from pfdist.cli.aligned import Column, aligned, width_of
from pfdist.cli.layout import COLUMNS
from pfdist.common.percent import times_100
from pfdist.common.rounding import rounded
from pfdist.common.told_counts import told_age, told_size
from pfdist.errors import one_line

_LEAST = 24  # characters of the last column, however long the names of the runs are


def list_lines(frame: pd.DataFrame, folder: str) -> list[str]:
    """Give a line for each run: its folder, state, age and size, and what it found.

    Parameters
    ----------
    frame : DataFrame
        As `pfdist.list_runs` gives it.
    folder : str
        The listed folder.
    """
    if frame.empty:
        return [one_line(f"{folder}: no runs")]
    rows, now = frame.to_dict("records"), datetime.now(UTC)
    columns = [
        Column("run", [one_line(row["run"]) for row in rows]),
        Column("state", [row["state"] for row in rows]),
        Column("age", [told_age((now - row["changed"]).total_seconds()) for row in rows], True),
        Column("size", [told_size(row["bytes"]) for row in rows], True),
    ]
    room = max(_LEAST, COLUMNS - width_of(columns) - 2)
    found = [_cut(_found(row), room) for row in rows]
    return aligned([*columns, Column("found", found)])


def _found(row: dict[Any, Any]) -> str:
    """Give how far an unfinished run is, and the best set; or what is wrong with the folder."""
    if isinstance(row["fault"], str):
        return row["fault"]
    texts = []
    if row["state"] != FINISHED:
        texts.append(f"{row['draws']:,} of {row['draws_wanted']:,} draws")
    if isinstance(row["best"], str):
        gain = row["gain_of_means"]
        side = "above" if gain < 0 else "below"
        percent = rounded(times_100(abs(gain)), 3)
        texts.append(f"{row['best']}: {percent} % {side} {row['reference']}")
    elif row["has_budget"] and row["draws"]:
        texts.append("times of several numbers")
    return ", ".join(texts)


def _cut(text: str, length: int) -> str:
    return text if len(text) <= length else f"{text[: length - 3]}..."
