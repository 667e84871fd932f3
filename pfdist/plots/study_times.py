"""The found times of many runs: small rows, one below another, on one clock."""

from typing import Any

import pandas as pd
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.font_manager import FontProperties

from pfdist.analysis.studies import SEED, SET, in_order, is_numeric, values_of
from pfdist.analysis.table_cells import is_missing, keys_of, told_value
from pfdist.common.short_names import short_names
from pfdist.errors import ArgumentError
from pfdist.plots.panel import (
    axes_for,
    clipped,
    label_instants,
    legend_above,
    scaled,
    table_of,
    thin,
    verbatim,
    write_instead,
)
from pfdist.plots.style import GREY, SERIES

MOST_ROWS = 40
_AXIS_INCHES, _ROW_INCHES = 0.8, 0.13
_TICK = 0.62  # height of a tick over that of a row
_LONGEST_VALUE, _LONGEST_LABEL = 14, 34
_MOST_LINES = 3  # of the names of the keys
_LETTER = 0.6  # width of a letter over the size of the font
_MOST_NAMES_OF_SETS = len(SERIES)


def found_times(
    table: pd.DataFrame | Any, *, horizon: float | None = None, ax: Axes | None = None
) -> Axes:
    """Draw the found times of many runs, a small row for each run and set, on one clock.

    A row is labelled with the values in which the runs differ. Rows that differ in their seeds
    alone are neighbours, on one shade. If there are more than 40 rows, every second, third, ...
    row is drawn, and the vertical axis says so.

    Parameters
    ----------
    table : DataFrame
        As `pfdist.table` gives it, or an object with such a method ``table``, as what
        `pfdist.sweep` returns.
    horizon : int or float, optional
        The last instant T, or time of the clock; by default the last measurement time.
    ax : matplotlib Axes, optional
        By default those of a new figure.

    Returns
    -------
    matplotlib Axes
    """
    frame = table_of(table, "table", "table")
    for name in ("run", SET, "measurement_times"):
        if name not in frame.columns:
            raise ArgumentError(
                "table must be a table of runs as pfdist.table gives it, but lacks the column "
                f"{name}",
                argument="table",
            )
    keys = keys_of(frame)
    names = [*(key for key in keys if key != SEED), SET, *({SEED} & {*keys})]
    names = [name for name in names if len(values_of(frame, name)) > 1] or ["run"]
    rows = [row for row in in_order(frame, names) if not is_missing(row["measurement_times"])]
    if not rows:
        return write_instead(axes_for(ax), "no run has found times")
    step = -(-len(rows) // MOST_ROWS)
    drawn, sets = rows[::step], values_of(frame, SET)
    ax = axes_for(ax, row_inches(len(rows)))
    height = 72 * scaled(_ROW_INCHES * _TICK)
    has_colours = 1 < len(sets) <= _MOST_NAMES_OF_SETS
    for position, row in enumerate(drawn):
        number = sets.index(row[SET]) if has_colours else 1
        at = list(row["measurement_times"])
        ax.axhline(position, color=GREY, lw=thin(0.25), zorder=0)
        ax.plot(
            at, [position] * len(at), "|", color=SERIES[number], ms=height, mew=thin(1.6),
            label=verbatim(row[SET]) if has_colours else None,
        )  # fmt: skip
    _shade(ax, [[row[name] for name in names if name != SEED] for row in drawn])
    ax.set_yticks(range(len(drawn)), [_label(row, names) for row in drawn])
    ax.tick_params(axis="y", length=0, labelsize=0.9 * scaled(6.5))
    ax.spines["left"].set_visible(False)
    ax.set_ylim(len(drawn) - 0.4, -0.6)
    ax.set_ylabel(_told_names(names, keys, len(rows), step, _letters_beside(ax)))
    _label_clock(ax, frame, [t for row in rows for t in row["measurement_times"]], horizon)
    if has_colours:
        handles, labels = ax.get_legend_handles_labels()
        legend_above(ax, [handles[labels.index(label)] for label in dict.fromkeys(labels)])
    return ax


def row_inches(rows: int) -> float:
    """Give the height of a figure with so many rows, in inches where the style has 8 points."""
    return _AXIS_INCHES + _ROW_INCHES * max(4, min(rows, MOST_ROWS)) + 0.2


def _shade(ax: Axes, groups: list[list[Any]]) -> None:
    """Shade every second group of rows, where groups have several rows."""
    starts = [row for row, group in enumerate(groups) if not row or group != groups[row - 1]]
    if len(starts) == len(groups):
        return
    for first, end in list(zip(starts, [*starts[1:], len(groups)], strict=True))[1::2]:
        ax.axhspan(first - 0.5, end - 0.5, color=GREY, alpha=0.12, lw=0, zorder=-1)


def _label(row: dict[Any, Any], names: list[str]) -> str:
    told = (told_value(row[name]) or "none" for name in names)
    parts = [clipped(each, _LONGEST_VALUE) for each in told]
    return verbatim(clipped(", ".join(parts), _LONGEST_LABEL))


def _letters_beside(ax: Axes) -> int:
    """Give the number of letters that have room along the vertical axis."""
    figure = ax.get_figure(root=True)
    inches = 0.8 * ax.get_window_extent().height / figure.dpi if figure else 0.0
    size = FontProperties(size=rcParams["axes.labelsize"]).get_size_in_points()
    return max(8, int(72 * inches / (_LETTER * size)))


def _told_names(names: list[str], keys: list[str], rows: int, step: int, letters: int) -> str:
    """Say which values label the rows, and how many rows are left out."""
    short, lines = short_names(keys), [""]
    for name in names:
        told = clipped(short.get(name, name), letters)
        if lines[-1] and len(lines[-1]) + len(told) > letters:
            lines[-1] += ","
            lines.append("")
        lines[-1] += f", {told}" if lines[-1] else told
    if len(lines) > _MOST_LINES:
        lines[_MOST_LINES - 1 :] = ["…"]
    if step > 1:
        lines.append(f"{rows} rows, 1 of {step} is drawn")
    return verbatim("\n".join(lines))


def _label_clock(ax: Axes, frame: pd.DataFrame, times: list[float], horizon: float | None) -> None:
    last = max([*times, 0]) if horizon is None else horizon
    first = min([*times, 0])
    beside = 0.02 * (last - first) or 0.75
    ax.set_xlim(first - beside, last + beside)
    whole = is_numeric(times) and all(isinstance(time, int) for time in times)
    label_instants(ax, frame.attrs.get("time_unit", ""), whole=whole)
