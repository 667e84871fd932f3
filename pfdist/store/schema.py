"""Schemas of tables: columns and units, times instead of instants, and components.

The metadata of every file has the schema's version, the table's name and the key of the run; that
of every column has a unit and a description. ``mse`` and the like have the square of z's unit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pyarrow as pa

from pfdist.common.component_names import Component
from pfdist.errors import StoreError, shown_text

if TYPE_CHECKING:
    import pandas as pd

SCHEMA_VERSION = 4
"""The only version of runs and their files that is read and written."""
RUN_KEY = b"pfdist_run"
"""Name of the entry of a file's metadata with the key of its run."""

FILTERED_PERCENTS = (5, 25, 50, 75, 95)
"""Quantiles, in per cent, in the table of a user's filtered measurements."""

SMOOTHED_START = "smoothed_"
"""The beginning of the columns in this table whose estimates use later measurements."""

WINDOW_PERCENTS = (1, 5)
"""Limits of the regret, in per cent, that define the sampling windows of a measurement."""

LABELS = "labels"
"""Name of the attribute of a DataFrame with the labels of its columns."""

_MSE, _NUMBER = "square of z's unit", pa.float64()
_INSTANTS: Final = ("t", "moved_to", "end")
_MEASUREMENTS: Final = ("measurement_times", "path")

KEYS: dict[str, list[str]] = {
    "evaluations": ["phase", "generation", "individual"],
    "draws": ["evaluation", "draw"],
    "compared": ["position"],
    "comparison": ["draw"],
    "range_sums": ["position", "draw", "draws"],
    "other_estimate": ["draw"],
    "filter_distance": ["draw"],
    "information": ["draw"],
    "information_gap": ["draw"],
    "filter_variance": ["draw"],
    "online": ["draw"],
    "trajectories": ["draw", "t"],
    "timings": ["phase", "task", "session", "seconds"],
    "bound": ["window", "work", "memory", "particles", "draws", "position"],
    "error_sums": ["evaluation", "block"],
    "evenly_spaced": ["measurements"],
    "profile": ["position", "t"],
    "worth": ["position", "t"],
    "sampling_windows": ["position", "t", "moved_to"],
}
"""Columns that identify a row of each table."""

BOUND_PHASE, WHY_PHASE, EVEN_PHASE = "bound.proof", "why.measurements", "evenly.spaced"
RULE_PHASE = "rule.draws"
"""Prefix of the phases of lower bounds, the phase of everything that `why` computes, that of the
comparison with other numbers of evenly spaced measurements, and that of the draws of rules."""

QUESTIONS = (BOUND_PHASE, WHY_PHASE, EVEN_PHASE, RULE_PHASE)
"""Phases of questions, without which a run is finished. No search may have these names."""


def _column(name: str, description: str, kind: pa.DataType = _NUMBER, unit: str = "") -> pa.Field:
    return pa.field(name, kind, metadata={"unit": unit, "description": description})


def _of_component(start: str, component: Component, unit: str, description: str) -> pa.Field:
    """A column of a component; the unit is that of the component, if it has one."""
    column = _column(f"{start}_{component.suffix}", description, unit=component.unit or unit)
    if not component.name:
        return column
    return column.with_metadata({**column.metadata, b"label": component.label.encode()})


def _schema(table: str, columns: Sequence[pa.Field]) -> pa.Schema:
    return pa.schema(
        columns, metadata={"table": table, "pfdist_schema_version": str(SCHEMA_VERSION)}
    )


def _estimate(name: str, description: str) -> list[pa.Field]:
    return [
        _column(name, description, unit=_MSE),
        _column(f"{name}_error", f"standard error of {name}", unit=_MSE),
    ]


_WITHIN = "inside: upper_limit is at most {} %; outside: lower_limit is above; else open"
_OF_A_SET = (
    _column("position", "order of the set, as in compared", pa.int32()),
    _column("name", "the set's name, as in compared", pa.string()),
)
_LEFT_OUT = "whether no particle explains a measurement, which is left out"
_CONTROL = "of expectation 0, if the job asks for it; the printed mean is that of mse - control"
_SUMS = "errors at t = 0, 1, ..., less the control of each, not weighted, over the draws"
_DEGENERATE = _column("degenerate", _LEFT_OUT, pa.bool_())
_TIMES = _column("measurement_times", "the set M, sorted", pa.list_(pa.int16()), "t")


_SCHEMAS = {
    "evaluations": [
        _column("evaluation", "id: hash of all that its draws depend on", pa.string()),
        _column("phase", "the search's name", pa.string()),
        _column("generation", "counted from 0", pa.int32()),
        _column("individual", "index of the first copy in its population", pa.int32()),
        _column("copies", "how many of the population are this set", pa.int32()),
        _TIMES,
        _column("end", "last instant whose errors count, over T + 1", pa.int16(), "t"),
        _column("particles", "of the filter; exact engines have none", pa.int32()),
        _column("estimator", "of a draw's error; exact engines have none", pa.string()),
        _column("expected_mse", "inf: killed for a degenerate draw", unit=_MSE),
        _column("standard_error", "of expected_mse", unit=_MSE),
        _column("draws", "draws filtered", pa.int32()),
        _column("degenerate_draws", "of them, degenerate", pa.int32()),
    ],
    "draws": [
        _column("evaluation", "id, as in evaluations", pa.string()),
        _column("draw", "index of the draw in its stream", pa.int64()),
        _column("mse", "mean over t of the error", unit=_MSE),
        _DEGENERATE,
    ],
    "compared": [
        _column("position", "order; 0 is the reference", pa.int32()),
        _column(
            "name",
            "evenly_spaced, regular, the search that found the set, or a given name",
            pa.string(),
        ),
        _TIMES,
        _column("search_mse", "the estimate of the search; null: reference", unit=_MSE),
        _column("search_standard_error", "of search_mse", unit=_MSE),
    ],
    "range_sums": [
        *_OF_A_SET,
        _column("draw", "the first draw of the range, as in comparison", pa.int64()),
        _column("draws", "number of draws, a power of 2; 0: exact errors", pa.int64()),
        _column("sums", _SUMS, pa.list_(pa.float64()), _MSE),
    ],
    "online": [
        _column("draw", "index of the draw, as in comparison", pa.int64()),
        _column("mse", "with these times", unit=_MSE),
        _DEGENERATE,
        _TIMES,
        _column("estimate", "at t = 0, 1, ...; null: after draw 99", pa.list_(pa.float64()), "z"),
    ],
    "timings": [
        _column("phase", "a search's name, comparison or online.times", pa.string()),
        _column("task", "key of the task", pa.string()),
        _column("session", "which start of the program", pa.string()),
        _column("seconds", "in the worker", unit="s"),
        _column("worker", "process id", pa.string()),
        _column("node", "host name", pa.string()),
        _column("failures", "1: the task failed", pa.int32()),
        _column("error", "traceback, if it failed", pa.string()),
        _column("part", "what the work is for, as search or comparison", pa.string()),
        _column("particle_steps", "that were computed; instants of sets if exact", pa.int64()),
    ],
    "bound": [
        *_OF_A_SET,
        _TIMES,
        _column(
            "budget",
            "the bound is for so many times, or for so much money, in its units",
            pa.int32(),
        ),
        _column("window", "measurements of a window before windows grow", pa.int32()),
        _column("windows", "windows that the relaxation knows", pa.int32()),
        _column("work", "particle-steps after which no window grows"),
        _column("memory", "that the relaxation may take", pa.int32(), "MiB"),
        _column("longest_gap", "after a longer gap everything is measured", pa.int32(), "t"),
        _column("particles", "of the bound's filter; 0: exact", pa.int32()),
        _column("draws", "of the bound; 0: exact", pa.int32()),
        _column("steps", "particle-steps of windows and bound"),
        _column("confidence", "of gap_at_most"),
        _column("compared_draws", "draws of the comparison when it was proved", pa.int64()),
        _column("reason", "why there is no bound; empty: there is one", pa.string()),
        *_estimate("expected_mse", "of the set with the job's own filter; or minus its nats"),
        *_estimate("bound", "no feasible set of so many times has a lower one"),
        _column("path", "times that reach the bound when relaxed", pa.list_(pa.int16()), "t"),
        _column("gap", "how much lower the error can be, over expected_mse"),
        _column("gap_at_most", "one-sided limit of gap"),
        *_estimate("relaxation", "part of the gap: relaxation and chance"),
        *_estimate("estimate", "part of the gap: particles and estimate"),
        *_estimate("filter_model", "part of the gap: wrong filter model"),
    ],
    "error_sums": [
        _column("evaluation", "id: hash of all that the sums depend on", pa.string()),
        _column("block", "index of the block of draws", pa.int64()),
        _column("sums", "errors of all states at their instants", pa.list_(pa.float64()), _MSE),
    ],
    "evenly_spaced": [
        _column("measurements", "number of evenly spaced measurements", pa.int32()),
        _TIMES,
        _column("draws", "the first draws of the comparison; 0: exact", pa.int64()),
        *_estimate("difference", "expected MSE less that of the plan, on the same draws"),
        _column("plan_mse", "expected MSE of the plan, on the same draws", unit=_MSE),
    ],
    "profile": [
        *_OF_A_SET,
        _column("t", "instant", pa.int32(), "t"),
        _column("measured", "whether the set measures at t", pa.bool_()),
        _column("draws", "fresh draws; 0: exact", pa.int64()),
        _column("error", "expected error at t", unit=_MSE),
        _column("standard_error", "of error", unit=_MSE),
        _column("weight", "of the instant in the MSE; the mean is 1"),
        _column("degenerate_draws", "draws that are degenerate up to t", pa.int64()),
        _column(
            "effective_sample_size",
            "mean over the first draws, after the measurement at t; null: not measured",
        ),
    ],
    "worth": [
        *_OF_A_SET,
        _column("t", "instant of the measurement", pa.int32(), "t"),
        _column("draws", "fresh draws; 0: exact", pa.int64()),
        *_estimate(
            "removed", "rise of the expected MSE, or of the job's criterion, if it is removed"
        ),
        *_estimate("earlier", "rise if it is made one instant earlier; null: impossible"),
        *_estimate("later", "rise if it is made one instant later; null: impossible"),
    ],
    "sampling_windows": [
        *_OF_A_SET,
        _column("t", "the measurement that is moved", pa.int32(), "t"),
        _column("moved_to", "to which it alone is moved; t itself is a row, too", pa.int32(), "t"),
        _column("moved_to_instant", "number of the instant moved_to, from 0", pa.int32()),
        _column("draws", "fresh draws; 0: exact", pa.int64()),
        _column("loss", "expected MSE over that of the kept set, less 1"),
        _column("loss_error", "standard error of loss"),
        _column("lower_limit", "one-sided 95 % limit of loss"),
        _column("upper_limit", "one-sided 95 % limit of loss"),
        *(
            _column(f"within_{percent}", _WITHIN.format(percent), pa.string())
            for percent in WINDOW_PERCENTS
        ),
    ],
}


_OPTIONAL_COLUMNS = [
    _column("exact_mse", "if the engine is exact", unit=_MSE),
    _column("exact_information", "of the measurements, if the engine is exact", unit="nats"),
    _column("exact_other_mse", "of the other estimate, if the engine is exact", unit=_MSE),
    _column(
        "scenario",
        "number of the draw's scenario, from 0, if the job has scenarios",
        pa.int16(),
    ),
    _column("tried", "evenly spaced sets that were looked at; 0: all that there are", pa.int64()),
    _column(
        "shares",
        "of scenarios or instants in the bound, if the worst decides",
        pa.list_(pa.float64()),
    ),
]
_OPTIONAL = {each.name: each for each in _OPTIONAL_COLUMNS}
"""Columns that a table has only for some jobs: with an exact engine, or with scenarios."""


_BY_DRAW = [_column("draw", "", pa.int64()), _column("t", "", pa.int32())]
_KINDS = {
    "degenerate": pa.bool_(),
    "sensor": pa.string(),
    "date": pa.string(),
}  # of columns that sets or sensors name
_TIMED = (pa.float64(), pa.list_(pa.float64()), pa.list_(pa.string()))


def check_schema_version(path: Path, version: object, wrote: object = None) -> None:
    """Raise `StoreError` if a run or a file has another schema version.

    `path` is the run's folder or the file, and `wrote` the version of pfdist that wrote it, for the
    error. If the schema version is not a number, nothing is raised.
    """
    if not isinstance(version, int) or version == SCHEMA_VERSION:
        return
    age = "an earlier version" if version < SCHEMA_VERSION else "a newer version"
    writer = f"pfdist {shown_text(wrote)}" if isinstance(wrote, str) else f"{age} of pfdist"
    raise StoreError(
        f"{path} is of schema version {version}, which {writer} reads and writes; "
        f"this pfdist reads version {SCHEMA_VERSION}"
    )


def schema(table: str, *optional: str) -> pa.Schema:
    """Schema of a table with fixed column names and some of its optional columns."""
    return _schema(table, [*_SCHEMAS[table], *(_OPTIONAL[name] for name in optional)])


def wrong_columns(columns: pa.Schema, table: str) -> str:
    """The fault in the columns of a table's file; empty if there is none."""
    declared = {column.name: column.type for column in _SCHEMAS.get(table, _BY_DRAW)}
    for name in declared if table in _SCHEMAS else KEYS.get(table, ()):
        if name not in columns.names:
            return f"lacks the column {name}"
    known = declared | {name: column.type for name, column in _OPTIONAL.items()}
    for column in columns:
        start = column.name.partition("_")[0]
        wanted = known.get(column.name, _KINDS.get(start, pa.float64()))
        is_timed = column.name in (*_INSTANTS, *_MEASUREMENTS) and column.type in _TIMED
        if column.type != wanted and not is_timed:
            return f"must have {wanted} in the column {column.name}, got {column.type}"
    return ""


_DATE = _column("date", "of t: local date and hour", pa.string())
"""A column beside t, if instants have dates."""


def with_sensors(schema: pa.Schema) -> pa.Schema:
    """Schema of a table of single measurements, with the sensor after the time."""
    column = _column("sensor", "that measures", pa.string())
    return schema.insert(schema.get_field_index("t") + 1, column)


def keys_of(table: str, columns: Sequence[str]) -> list[str]:
    """Columns that identify a row of a table with these columns."""
    return [*KEYS[table], *(["sensor"] if "sensor" in columns else [])]


def comparison_schema(
    names: Sequence[str], *, with_control: bool = False, with_scenarios: bool = False
) -> pa.Schema:
    """Schema of the comparison: a row for each draw, with two or three columns for each set."""
    comparison = _of_sets("comparison", "mse", "with this set", names)
    for name in names:
        comparison = comparison.append(_column(f"degenerate_{name}", _LEFT_OUT, pa.bool_()))
    for name in names if with_control else ():
        comparison = comparison.append(_column(f"control_{name}", _CONTROL, unit=_MSE))
    return comparison.append(_OPTIONAL["scenario"]) if with_scenarios else comparison


def first_draws_schema(
    table: str,
    start: str,
    description: str,
    names: Sequence[str],
    *,
    unit: str = "",
    has_unmeasured: bool = False,
) -> pa.Schema:
    """Schema of what filtering gives beside the comparison: a row for each draw, a column a set."""
    schema = _of_sets(table, start, description, names, unit or _MSE)
    if has_unmeasured:
        without = _column("unmeasured", "without any measurement", unit=_MSE)
        schema = schema.append(without)
    return schema


def _of_sets(
    table: str, start: str, description: str, names: Sequence[str], unit: str = _MSE
) -> pa.Schema:
    columns = [_column("draw", "index of the draw, as in comparison", pa.int64())]
    columns += [_column(f"{start}_{name}", description, unit=unit) for name in names]
    return _schema(table, columns)


def trajectories_schema(
    names: Sequence[str], quantities: Sequence[Component], measurements: Sequence[Component]
) -> pa.Schema:
    """Schema of the trajectories of sets with these names: a row for each draw and instant.

    The components are those of z and of y.
    """
    columns = [
        _column("draw", "index of the draw, as in comparison", pa.int64()),
        _column("t", "instant", pa.int32(), "t"),
    ]
    columns += [_of_component("z", each, "z", "quantity of interest") for each in quantities]
    columns += [
        _of_component("y", each, "y", "measurement, had one been made") for each in measurements
    ]
    columns += [
        _of_component(f"estimate_{name}", each, "z", "the filter's")
        for name in names
        for each in quantities
    ]
    return _schema("trajectories", columns)


def _moments_of(start: str, component: Component, uses: str) -> list[pa.Field]:
    return [
        _of_component(f"{start}mean", component, "z", f"mean, {uses}"),
        _of_component(f"{start}sd", component, "z", "standard deviation"),
        *(
            _of_component(f"{start}q{percent:02d}", component, "z", f"quantile of {percent} %")
            for percent in FILTERED_PERCENTS
        ),
    ]


def filtered_schema(quantities: Sequence[Component]) -> pa.Schema:
    """Schema of filtered measurements, by the components of z: a row for each instant."""
    columns = [
        _column("t", "instant", pa.int32(), "t"),
        _column("measured", "whether t was measured", pa.bool_()),
    ]
    for each in quantities:
        columns += _moments_of("", each, "by the measurements up to t")
    columns += [
        _column("effective_sample_size", "of the particles; null: exact"),
        _column("surprise", "p-value of the measurement; null: not measured"),
    ]
    later = "by later measurements, too (`problem.lag`, else all); null: too many particles"
    for each in quantities:
        columns += _moments_of(SMOOTHED_START, each, later)
    of_lines = "of the particles, by their descendants; null: exact"
    columns.append(_column(f"{SMOOTHED_START}effective_sample_size", of_lines))
    return _schema("filtered", columns)


def backtest_schema() -> pa.Schema:
    """Schema of a backtest: a row for each judged replicate and set of times."""
    columns = [
        _column("replicate", "name of the replicate", pa.string()),
        _column("set", "name of the set of times", pa.string()),
        _column("judged", "number of judged values", pa.int32()),
        _column("real", "error, relative to the variance of what is judged"),
        _column("foreseen", "the same of simulated systems, on average"),
        _column("covered", "share of judged values in the 90 % interval"),
    ]
    return _schema("backtest", columns)


@dataclass(frozen=True)
class TimeColumns:
    """A converter of columns of instants to columns of times.

    With `written`, columns of sets of measurements become columns of these texts or times. With
    `dates`, a column ``date`` follows the column t.
    """

    times: tuple[float, ...]  # (T+1,); the time of each instant
    unit: str  # for the metadata of the columns
    written: tuple[Any, ...] = ()  # the text or the time of each possible measurement
    dates: tuple[str, ...] = ()  # (T+1,); the text of each instant
    counts: bool = False  # whether the time of an instant is its number: such columns stay

    def table(self, rows: pa.Table) -> pa.Table:
        """A table with times instead of instants; columns of times are unchanged."""
        for field in rows.schema:
            index = rows.schema.get_field_index(field.name)
            if self._is_changed(field):
                values = self.written if self._is_written(field) else self.times
                column = rows.column(index).combine_chunks()
                rows = rows.set_column(index, self._field(field), _valued(column, values))
                if self.dates and field.name == "t":
                    rows = rows.add_column(index + 1, _DATE, _valued(column, self.dates))
        return rows

    def _is_written(self, field: pa.Field) -> bool:
        return field.name in _MEASUREMENTS and bool(self.written)

    def _is_changed(self, field: pa.Field) -> bool:
        if self._is_written(field):
            return _holds_numbers(field)
        columns = () if self.counts else (*_INSTANTS, *_MEASUREMENTS)
        return field.name in columns and _holds_numbers(field)

    def _field(self, field: pa.Field) -> pa.Field:
        has_texts = self._is_written(field) and isinstance(self.written[0], str)
        kind = pa.string() if has_texts else pa.float64()
        kind = pa.list_(kind) if pa.types.is_list(field.type) else kind
        metadata = dict(field.metadata or {}) | {b"unit": self.unit.encode()}
        return pa.field(field.name, kind, metadata=metadata)


def frame_of(table: pa.Table) -> pd.DataFrame:
    """A DataFrame with the units and labels from the table's metadata.

    If the column t has times instead of instants, the DataFrame has the attribute ``time_unit``. If
    columns are those of components with names, it has the attribute ``labels``: names and units by
    column.
    """
    frame: pd.DataFrame = table.to_pandas()
    index = table.schema.get_field_index("t")
    if index >= 0 and pa.types.is_floating(table.schema.field(index).type):
        metadata = table.schema.field(index).metadata or {}
        frame.attrs["time_unit"] = metadata.get(b"unit", b"").decode()
    labels = {
        field.name: field.metadata[b"label"].decode(errors="replace")
        for field in table.schema
        if b"label" in (field.metadata or {})
    }
    if labels:
        frame.attrs[LABELS] = labels
    return frame


def _holds_numbers(field: pa.Field) -> bool:
    kind = field.type.value_type if pa.types.is_list(field.type) else field.type
    return bool(pa.types.is_integer(kind))


def _valued(column: pa.Array, values: Sequence[Any]) -> pa.Array:
    """The value of each index in a column."""
    if pa.types.is_list(column.type):
        offsets = column.offsets.to_numpy()  # a slice of a column begins later
        return pa.ListArray.from_arrays(
            pa.array(offsets - offsets[0]),
            _valued(column.flatten(), values),
            mask=column.is_null(),
        )
    return pa.array(np.array(values)[column.to_numpy(zero_copy_only=False)])


def components_in(table: pd.DataFrame, start: str) -> tuple[Component, ...]:
    """Components whose columns begin with these characters, such as ``z_``.

    The names and units are those of the attribute ``labels`` of the table. A column without a label
    is named by its suffix, unless that is a number.
    """
    labels = table.attrs.get(LABELS, {})
    return tuple(
        _component(str(column).removeprefix(start), labels.get(column, ""))
        for column in table.columns
        if str(column).startswith(start)
    )


def _component(suffix: str, label: str) -> Component:
    if not label:
        return Component(suffix, "" if suffix.isdecimal() else suffix)
    name, _, unit = label.partition(" [")
    return Component(suffix, name, unit.removesuffix("]"))


def labels_of(start: str, components: Sequence[Component]) -> dict[str, str]:
    """Labels of the columns of components that have names, by column."""
    return {f"{start}{each.suffix}": each.label for each in components if each.name}
