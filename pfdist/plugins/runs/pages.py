"""Many runs in a table, and a list of the runs in a folder."""

import math
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any

import pandas as pd

from pfdist.common.formatted_sizes import (
    formatted_age,
    formatted_seconds,
    formatted_size,
)
from pfdist.common.measurement_times import EVEN, REGULAR
from pfdist.common.parts import Cell, Page, Section, Table, Text, without_column
from pfdist.common.rounding import with_interval
from pfdist.errors import one_line
from pfdist.filters.criterion import MEAN, Criterion, WorstScenario, criterion_named
from pfdist.plugins.runs.listing import FINISHED
from pfdist.plugins.runs.runs_table import (
    CRITERION,
    formatted_gain,
    formatted_mse,
    formatted_value,
    keys_of_runs,
    shown_names,
)
from pfdist.plugins.runs.studies import SEED, averages, formatted_point, is_numeric, still_varying
from pfdist.problem.set_key import labels_of_sets, phrase_of
from pfdist.results.columns import interval_cell

_ERROR = "expected MSE ± standard error"
_FEW_KEYS = 3  # that a narrow terminal shows


def table_page(frame: pd.DataFrame) -> Page:
    """A table of runs, as `pfdist.table` gives it: what differs, and what the runs found."""
    keys = keys_of_runs(frame)
    short = shown_names(keys)
    form = form_of(frame)
    judged = [] if form is None else [form.head]
    head = ["run", *(short[key] for key in keys), "set", *judged, _ERROR, "gain, %", "seconds"]
    rows = [_row(row, keys, form) for row in frame.to_dict("records")]
    lacking = [short[key] for key in reversed(keys) if frame[key].isna().any()]
    others = [short[key] for key in reversed(keys) if short[key] not in lacking]
    # In a narrow terminal, few keys identify the runs, or else the names of the runs do.
    is_identified = 0 < len(keys) <= _FEW_KEYS and not frame.duplicated([*keys, "set"]).any()
    optional = ["run", "seconds"] if is_identified else [*lacking, "seconds", *others]
    table = Table("", head, rows, optional=optional)
    if len(set(frame["set"])) == 1:
        table = without_column(table, "set")
    references = sorted(set(frame["reference"].dropna().astype(str)))
    labels = labels_of_sets(references, {})
    other = phrase_of(*labels.values()) if references in ([EVEN], [REGULAR]) else "the reference"
    gain = Text(f"The gain is how far the expected MSE lies below that of {other} (95 % CI).")
    return Page("", "", [Section("", [table, *([gain] if references else [])])])


def form_of(frame: pd.DataFrame) -> Criterion | None:
    """The criterion of all runs of a table, unless that is the expected MSE or they differ."""
    names = set(frame.get("criterion", [None]))
    if len(names) > 1 or not isinstance(name := names.pop(), str):
        return None
    return WorstScenario() if name == WorstScenario.name else criterion_named(name)


def _row(row: Mapping[Any, Any], keys: list[str], form: Criterion | None) -> list[Cell]:
    # A row without results shows the state of its run.
    state = "no other set" if row["state"] == FINISHED else str(row["state"])
    seconds = row["worker_seconds"]
    return [
        Cell(str(row["run"])),
        *(
            Cell(one_line(formatted_value(each)), each if is_numeric([each]) else None)
            for each in (row[key] for key in keys)
        ),
        Cell(formatted_value(row["set"])),
        *([] if form is None else [_judged(row, form)]),
        Cell(formatted_mse(row) or state),
        Cell(formatted_gain(row)),
        Cell(formatted_seconds(seconds), seconds),
    ]


def _judged(row: Mapping[Any, Any], form: Criterion) -> Cell:
    ends = (row[name] if math.isfinite(row[name]) else None for name in CRITERION[1:4])
    return interval_cell(*ends, is_side=form.is_side)


def lowest_text(frame: pd.DataFrame) -> str:
    """The values with the lowest number that is minimised, as a mean over seeds, in a sentence."""
    columns, form = still_varying(frame, []), form_of(frame) or MEAN
    means = averages(frame, columns, "expected_mse" if form.is_mean else "judged")
    best = min((each for each in means if math.isfinite(each.mean)),
               key=lambda each: form.sign * each.mean, default=None)  # fmt: skip
    if best is None:
        return ""
    value, low, high = with_interval(best.mean, best.low, best.high)
    interval = "" if math.isnan(best.low) else f" (95 % CI {low} to {high})"
    value = f"{value} {form.unit}".rstrip()
    estimate = f"{value}{' (exact)' if best.low == best.high else interval}"
    if len(best.replicates) > 1:
        estimate += f", the mean of {len(best.replicates)} seeds"
    if not columns:  # the seeds alone differ: there is nothing to choose
        return f"The {form.label} is {estimate}."
    point = formatted_point(
        columns, best.point, sorted(keys_of_runs(frame), key=lambda name: name == SEED)
    )
    return f"The {form.most} {form.label} is {estimate}: {point}."


def list_page(frame: pd.DataFrame, folder: str) -> Page:
    """A list of runs: the folder, state, age and size of each, and what it found.

    Parameters
    ----------
    frame : DataFrame
        The result of `pfdist.list_runs`.
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
    table = Table("", head, rows, optional=["age", "size"])
    return Page("", "", [Section("", [table])], place=folder)


def _result(row: Mapping[Any, Any]) -> str:
    """How far an unfinished run is, and the best set; or what is wrong with the folder."""
    if isinstance(row["fault"], str):
        return row["fault"]
    texts = []
    if row["state"] != FINISHED:
        texts.append(f"{row['draws']:,} of {row['draws_wanted']:,} draws")
    texts += [row["found"]] * isinstance(row["found"], str)
    return ", ".join(texts)
