"""Many runs in a table, and a list of the runs in a folder."""

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

import pandas as pd

from pfdist.common.dotted_keys import short_names
from pfdist.common.formatted_times import (
    formatted_age,
    formatted_seconds,
    formatted_size,
    formatted_times,
)
from pfdist.common.parts import Cell, Page, Section, Table, Text
from pfdist.common.percent import times_100
from pfdist.common.rounding import rounded, with_interval
from pfdist.errors import one_line
from pfdist.problem.sweep import parts_that_pay
from pfdist.results.judged import REGRET, least_regret
from pfdist.results.listed_run import FINISHED
from pfdist.results.studies import is_numeric
from pfdist.results.table_cells import formatted_gain, formatted_mse, formatted_value, keys_of


def table_page(frame: pd.DataFrame) -> Page:
    """A table of runs, as `pfdist.table` gives it: what differs, and what the runs found."""
    keys = keys_of(frame)
    short = short_names(keys)
    head = ["run", *(short[key] for key in keys), "set", "expected MSE", "gain %", "seconds"]
    rows = [_row(row, keys) for row in frame.to_dict("records")]
    lacking = [short[key] for key in reversed(keys) if frame[key].isna().any()]
    others = [short[key] for key in reversed(keys) if short[key] not in lacking]
    names = ["run"] if keys and not frame.duplicated([*keys, "set"]).any() else []
    table = Table("", head, rows, optional=[*lacking, *names, "seconds", *others])
    references = sorted(set(frame["reference"].dropna().astype(str)))
    other = references[0] if len(references) == 1 else "the reference"
    gain = Text(f"±: one standard error; gain %: how far the MSE is below that of {other} (95 %)")
    return Page("", "", [Section("", [table, *([gain] if references else [])])])


def _row(row: Mapping[Any, Any], keys: list[str]) -> list[Cell]:
    # A row without results says how far its run is.
    state = "no other set" if row["state"] == FINISHED else str(row["state"])
    seconds = row["worker_seconds"]
    return [
        Cell(str(row["run"])),
        *(value_cell(row[key]) for key in keys),
        Cell(formatted_value(row["set"])),
        Cell(formatted_mse(row) or state),
        Cell(formatted_gain(row)),
        Cell(formatted_seconds(seconds), seconds),
    ]


def least_regret_text(judged: pd.DataFrame) -> str:
    """Name the plan of least regret of a sweep, as `Sweep.judged` gives its table."""
    worst = least_regret(judged)
    if worst is None:
        return "No plan fits every point, so none has the least regret."
    times = formatted_times(worst["measurement_times"], judged.attrs.get("time_unit", ""))
    value, low, high = with_interval(*(times_100(worst[name]) for name in REGRET))
    interval = f" (95 % CI {low} to {high})" if worst["regret_low"] < worst["regret_high"] else ""
    return one_line(
        f"Plan of least regret: {times} ({worst['set']} at {worst['found_at']}). Its largest "
        f"regret is {value} %{interval}, at {worst['run']}."
    )


def value_cell(value: Any) -> Cell:
    """The value of a key of a job."""
    return Cell(one_line(formatted_value(value)), value if is_numeric([value]) else None)


def records(frame: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows of a table for JSON: moments become texts as of ISO 8601, and missing values None."""
    cells = frame.astype(object).where(frame.notna(), None)
    return [
        {str(key): _plain(value) for key, value in row.items()} for row in cells.to_dict("records")
    ]


def _plain(value: Any) -> Any:
    return value.isoformat(timespec="seconds") if hasattr(value, "isoformat") else value


def list_page(frame: pd.DataFrame, folder: str) -> Page:
    """A list of runs: the folder, state, age and size of each, and what it found.

    Parameters
    ----------
    frame : DataFrame
        As `pfdist.list_runs` gives it.
    folder : str
        The listed folder.
    """
    if frame.empty:
        return Page("", f"{folder}: no runs", [])
    now = datetime.now(UTC)
    rows = []
    for row in frame.to_dict("records"):
        age = formatted_age((now - row["changed"]).total_seconds())
        texts = row["run"], row["state"], age, formatted_size(row["bytes"]), _result(row)
        rows.append([*map(Cell, texts)])
    head = ("run", "state", "age", "size", "found")
    return Page("", folder, [Section("", [Table("", head, rows, optional=["age", "size"])])])


def _result(row: Mapping[Any, Any]) -> str:
    """How far an unfinished run is, and the best set; or what is wrong with the folder."""
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


def foreseen_page(points: pd.DataFrame) -> Page:
    """The points of a sweep and their work, as `pfdist.questions.sweep.foreseen` gives them."""
    billion = 1e9
    rows = [
        [
            Cell(row["point"]),
            Cell(row["state"]),
            Cell(f"{row['steps'] / billion:.3f}", row["steps"]),
        ]
        for row in points.to_dict("records")
    ]
    left = points[["steps", "seconds"]].where(points["state"] != FINISHED, 0)
    text = f"{len(points)} points; about {left['steps'].sum() / billion:.3f} billion particle-steps"
    text += f" are left to do, in {formatted_seconds(left['seconds'].sum())} s of a core"
    text += " (without compiling, figures and reports)"
    if "judging_steps" in points:
        judging = points["judging_steps"].sum() / billion
        text += f", and at most {judging:.3f} billion to judge"
    table = Table("", ("point", "state", "billion steps"), rows)
    parts = parts_that_pay(left["seconds"].tolist())
    pays = f"up to {parts} parts pay, on a core each" if parts > 1 else "one part: more do not pay"
    return Page("", "", [Section("", [table, Text(text), Text(pays)])])
