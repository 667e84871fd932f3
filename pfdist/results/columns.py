"""The columns of the table of sets, each declared once, and the views of its rows.

Answers, reports, lists and tables of runs, JSON and DataFrames all show this table.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from types import MappingProxyType, SimpleNamespace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from pfdist.common.parts import Cell, Table, without_empty_columns
from pfdist.common.percent import range_of, times_100
from pfdist.common.rounding import unrounded, with_error, with_interval, with_sides
from pfdist.errors import relative
from pfdist.filters.beside import BESIDE
from pfdist.filters.criterion import CRITERIA, unit_of_criterion
from pfdist.results.moments import QUANTILES, quantile_name

if TYPE_CHECKING:
    import pandas as pd

ERRORS_SHOWN = ("expected_mse", *(each.mse for each in BESIDE))
CRITERIA_SHOWN = tuple(CRITERIA)
"""Columns with errors, and with numbers of criteria, by the names of these."""
T = TypeVar("T")
Results = dict[str, Any]


def _listed(values: Iterable[float | str]) -> str:
    return ", ".join(map(unrounded, values))


class Row(SimpleNamespace):
    """A row of a table: its columns are attributes, and None is a missing value."""

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(f"a row has no column {name!r}; it has: {', '.join(vars(self))}")

    def add(self, columns: Mapping[str, Any]) -> None:
        """Add columns, or replace their values."""
        vars(self).update(columns)

    def plain(self) -> Row:
        """The same row with values of Python alone; a missing number is None."""
        values = {k: v.item() if isinstance(v, np.generic) else v for k, v in vars(self).items()}
        return Row(**{k: None if v != v else v for k, v in values.items()})  # noqa: PLR0124  NaN

    def __repr__(self) -> str:
        if not {"label", "expected_mse", "measurement_times"} <= {*vars(self)}:
            return super().__repr__()
        judged = [name for name in CRITERIA_SHOWN if vars(self).get(name) is not None]
        texts = {name: COLUMNS[name].cell(self).text for name in judged}
        values = [
            f"{name.replace('_', ' ')} {text} {unit_of_criterion(name)}".rstrip()
            for name, text in texts.items()
        ]
        values.append(f"expected MSE {with_error(self.expected_mse, self.standard_error)}")
        about = f"{self.label}: {self.measurements} measurements, {', '.join(values)}"
        return f"<{about}: t = {_listed(self.measurement_times)}>"


@dataclass(frozen=True, kw_only=True)
class Column:
    """A result of a set.

    Parameters
    ----------
    name : str
    meaning : str
        A phrase for the manual.
    dtype : str
        Type of the column in a DataFrame.
    head : str
        Head of the column on pages.
    error : str
        Column of its standard error, which pages show beside it.
    is_percent : bool
        Whether pages show it in per cent.
    has_interval : bool
        Whether the ends of its 95 % interval are the columns ``NAME_low`` and ``NAME_high``.
    is_side : bool
        Whether it is a lower side, which may be far from the upper one.
    """

    name: str
    meaning: str
    dtype: str = "float64"
    head: str = ""
    error: str = ""
    is_percent: bool = False
    has_interval: bool = False
    is_side: bool = False

    def cell(self, row: Row, listed: Callable[[list[Any]], str] = _listed) -> Cell:
        """The value of a row as pages show it; empty if it is missing. `listed` writes lists."""
        value = getattr(row, self.name)
        if value is None:
            return Cell("")
        if isinstance(value, list):
            return Cell(listed(value))
        if self.error:
            return Cell(with_error(value, getattr(row, self.error)), value)
        if self.has_interval:
            ends = (getattr(row, f"{self.name}_{end}") for end in ("low", "high"))
            return interval_cell(value, *ends, is_percent=self.is_percent, is_side=self.is_side)
        return Cell(value if isinstance(value, str) else f"{value:,.10g}", value)


def interval_cell(
    value: float | None,
    low: float | None,
    high: float | None,
    *,
    is_percent: bool = False,
    is_side: bool = False,
) -> Cell:
    """A number with its interval, or alone if it is exact; a lower side as `with_sides` says.

    >>> interval_cell(0.176321, 0.162, 0.1904, is_percent=True).text
    '17.6 (16.2 to 19.0)'
    >>> interval_cell(2.5, 2.5, 2.5).text
    '2.5000'
    """
    ends = (value, low, high)
    if is_side and (limits := with_sides(value, low, high)):
        return Cell(limits, value)
    text, *texts = with_interval(*(map(times_100, ends) if is_percent else ends))
    return Cell(text if low == high == value else f"{text} ({range_of(*texts)})", value)


def _with_interval(column: Column) -> Iterable[Column]:
    """The column, and those of the ends of its 95 % interval."""
    ends = [
        Column(name=f"{column.name}_{end}", meaning=f"{which} end of its 95 % interval")
        for end, which in (("low", "lower"), ("high", "upper"))
    ]
    return [column, *(ends if column.has_interval else [])]


_DECLARED = [
    Column(name="name", dtype="object", meaning="name of the set"),
    Column(name="label", dtype="object", head="times", meaning="the set as pages call it"),
    Column(
        name="kind", dtype="object",
        meaning="found (by a search), evenly_spaced, regular, reference (the times that the job "
        "gives as comparison.reference), or given (a set that the job names)",
    ),
    Column(name="reference", dtype="object", meaning="the set over which it gains"),
    Column(name="measurements", dtype="int64", head="number", meaning="number of measurements"),
    Column(
        name="budget", dtype="int64",
        meaning="number of measurements; in a budget curve of prices, the total price",
    ),
    Column(name="measurement_times", dtype="object", head="t", meaning="on the clock of the job"),
    Column(name="price", head="price", meaning="total price, where the job has one"),
    Column(
        name="expected_mse", error="standard_error", has_interval=True,
        head="expected MSE ± standard error",
        meaning="mean on the compared draws, of mse - control where there is a control; or exact",
    ),
    Column(name="standard_error", meaning="of expected_mse; 0 where it is exact"),
    *(
        column
        for each in BESIDE
        for column in (
            Column(name=each.mse, error=each.error, head=each.head_of(), meaning=each.meaning),
            Column(name=each.error, meaning=f"standard error of {each.mse}; 0: exact"),
        )
    ),
    Column(
        name="criterion_value",
        meaning="number that the job minimises, unless that is expected_mse: of the worst scenario "
        "the expected MSE; the negative information",
    ),
    Column(
        name="criterion_gain", has_interval=True,
        meaning="1 - criterion_value / that of the reference; of the information, how many nats "
        "more the set gives",
    ),
    *(
        Column(
            name=name, has_interval=True, is_side=form.is_side, meaning=form.meaning,
            head=f"{form.short}, {form.unit}" if form.unit else form.short,
        )
        for name, form in CRITERIA.items()
    ),
    Column(name="draws", dtype="int64", meaning="compared draws"),
    Column(name="degenerate_draws", dtype="int64", meaning="draws that are degenerate"),
    Column(
        name="largest_share",
        meaning="share of expected_mse that the largest 1 % of the draws carries; above 0.2 its "
        "interval is too short; missing with fewer than 100 draws, and where it is exact",
    ),
    Column(
        name="worse_than", dtype="Int64",
        meaning="best smaller number of measurements of the same kind, if it is better on common "
        "draws; the intervals of all such differences hold together with 95 %",
    ),
    Column(
        name="beats_search", dtype="object",
        meaning="whether a given set or opponent, which keeps the constraints, is better than all "
        "found sets by three standard errors on common draws: then answers name it",
    ),
    Column(
        name="gain_of_means", has_interval=True, is_percent=True, head="lower by, %",
        meaning="1 - expected_mse / expected_mse of the reference; interval by Fieller",
    ),
    Column(
        name="positive_fraction", has_interval=True, is_percent=True,
        meaning="share of draws with a positive relative gain; interval by Wilson",
    ),
    Column(
        name="mean_relative_gain", has_interval=True, is_percent=True,
        meaning="mean of 1 - mse / mse of the reference over the draws, the paper's figure; filter "
        "noise biases it low; interval by Student's t",
    ),
    Column(
        name="mean_log10_ratio", has_interval=True,
        meaning="mean of log10(mse / mse of the reference); interval by Student's t",
    ),
    *(
        Column(
            name=quantile_name(share),
            meaning=f"{share:.0%} quantile of the relative gain, to 0.001; -inf below -10",
        )
        for share in QUANTILES
    ),
    Column(
        name="typical_error", dtype="object",
        meaning="root of the expected MSE of each component of z, in its unit; of an angle a "
        "circular deviation, in radians; missing where errors are scaled, or the model's own",
    ),
    Column(
        name="evenly_spaced", dtype="Int64",
        meaning="least number of evenly spaced measurements that do as well: on the same draws the "
        "95 % interval of the paired difference ends at most 2 % above the set's error",
    ),
    Column(name="evenly_spaced_undecided", dtype="object", meaning="smaller undecided numbers"),
    Column(
        name="evenly_spaced_worse", dtype="object",
        meaning="larger numbers that do worse: their interval begins more than 2 % above",
    ),
    Column(name="gain_draws", dtype="Int64", meaning="draws whose relative gain is a number"),
    Column(
        name="gains_disagree", dtype="object",
        meaning="whether mean_relative_gain and gain_of_means differ in sign or by more than 5 %",
    ),
    Column(
        name="search_mse", error="search_standard_error",
        head="estimated by the search ± standard error",
        meaning="expected MSE of the set, or criterion_value, as its search estimated it",
    ),
    Column(name="search_standard_error", meaning="of search_mse"),
    Column(
        name="search_excess", is_percent=True,
        meaning="search_mse / expected_mse - 1, or by criterion_value where there is one",
    ),
    Column(name="search_cause", dtype="object", meaning="reason of search_excess"),
    Column(
        name="search_settings", dtype="object",
        meaning="settings in which the search estimates otherwise than the comparison",
    ),
    Column(
        name="particle_loss",
        meaning="share of expected_mse due to finitely many particles, by two filters",
    ),
    Column(name="particle_loss_error", meaning="standard error of particle_loss"),
    Column(name="particle_loss_at_most", meaning="at least the particle loss"),
    Column(name="particle_loss_at_most_error", meaning="standard error of particle_loss_at_most"),
    Column(name="particle_loss_limit", meaning="upper 95 % limit of the particle loss"),
    Column(
        name="lost_constants",
        meaning="share of draws that end with fewer than 20 values of a constant",
    ),
    Column(name="unmeasured_mse", meaning="expected MSE of the exact filter without measurements"),
    Column(
        name="bound", error="bound_error", head="lower bound",
        meaning="lower bound of the expected MSE of any feasible times of this number, or price",
    ),
    Column(name="bound_error", meaning="standard error of bound; 0 where it is exact"),
    Column(
        name="bound_low",
        meaning="one-sided limit of bound; the limits of all numbers hold together with 95 %",
    ),
    Column(
        name="bound_gap", is_percent=True,
        meaning="1 - bound / expected MSE of the set, on the draws of the bound",
    ),
    Column(name="bound_gap_at_most", is_percent=True, meaning="upper 95 % limit of bound_gap"),
    Column(name="description", dtype="object", meaning="a phrase about a set that the job gives"),
    Column(
        name="broken_constraints", dtype="object", meaning="constraints of the job that it breaks"
    ),
    Column(name="warnings", dtype="object", meaning="sentences"),
]  # fmt: skip

_BY_NAME = {each.name: each for declared in _DECLARED for each in _with_interval(declared)}
_FIRST = (
    "name", "label", "measurements", "measurement_times", "typical_error", "expected_mse",
    "standard_error", "gain_of_means", "gain_of_means_low", "gain_of_means_high",
)  # fmt: skip
COLUMNS = {name: _BY_NAME[name] for name in dict.fromkeys([*_FIRST, *_BY_NAME])}
"""All columns of the table of sets; the first ten are those that notebooks show."""


def rows_of(table: pd.DataFrame) -> list[Row]:
    """The rows of a table; its columns have names of attributes."""
    plain = table.astype(object).where(table.notna(), None)
    return [Row(**{str(k): value for k, value in row.items()}) for row in plain.to_dict("records")]


def frame_of_sets(rows: Iterable[Row]) -> pd.DataFrame:
    """The table of sets as a DataFrame."""
    import pandas as pd  # noqa: PLC0415  it loads when tables are made

    rows, order = [*rows], [*COLUMNS]
    judged = [
        name for name in CRITERIA_SHOWN if any(vars(row).get(name) is not None for row in rows)
    ]
    for name in judged:  # what the job asks for comes first
        order.remove(name)
        order.insert(order.index("expected_mse"), name)
    table = pd.DataFrame([*map(vars, rows)], columns=order)
    table.attrs["units"] = {
        name: unit_of_criterion(name) for name in judged if unit_of_criterion(name)
    }
    for name, column in COLUMNS.items():
        if column.dtype == "object":
            table[name] = table[name].astype(object).where(table[name].notna(), None)
    return table.astype({name: column.dtype for name, column in COLUMNS.items()})


def records_of(table: pd.DataFrame) -> list[Results]:
    """The rows of a table for JSON; numbers that are missing or infinite are None."""
    return finite([vars(row) for row in rows_of(table)])


def sets_table(
    caption: str,
    rows: Iterable[Row],
    columns: Sequence[str],
    *,
    listed: Callable[[list[Any]], str] = _listed,
    heads: Mapping[str, str] = MappingProxyType({}),
    **how: Any,
) -> Table:
    """A page's table of some results of sets; columns without a value are left out.

    Parameters
    ----------
    caption : str
    rows : iterable of Row
    columns : sequence of str
        Names of columns that have a head.
    listed : callable
        Writes measurement times.
    heads : mapping of str to str
        Other heads of columns, by name.
    how
        As of `pfdist.common.parts.Table`.
    """
    declared = [COLUMNS[name] for name in columns]
    cells = [[column.cell(row, listed) for column in declared] for row in rows]
    return without_empty_columns(
        Table(caption, [heads.get(each.name, each.head) for each in declared], cells, **how)
    )


def finite(value: T) -> T:
    """A value for JSON: lists, relative paths, and dates as texts of ISO 8601.

    A float that is not finite becomes None.
    """
    plain: Any = relative(value) if isinstance(value, str) else value
    if isinstance(value, dict):
        plain = {key: finite(inner) for key, inner in value.items()}
    elif isinstance(value, list | tuple):
        plain = [finite(inner) for inner in value]
    elif isinstance(value, datetime):
        plain = value.isoformat(timespec="seconds")
    elif isinstance(value, float) and not math.isfinite(value):
        plain = None
    return plain  # type: ignore[no-any-return]
