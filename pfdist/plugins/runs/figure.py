"""The figure of many runs: a result against a key of their jobs."""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.transforms import ScaledTranslation

from pfdist.errors import ArgumentError, shown
from pfdist.pages.figure import Plot, save_plots
from pfdist.pages.panel import (
    CurvePoints,
    axes_for,
    chosen,
    clipped,
    cut_outliers,
    legend_above,
    marker,
    points,
    table_of,
    thin,
    verbatim,
    write_instead,
)
from pfdist.pages.style import GREY, SERIES
from pfdist.plugins.runs.question import table
from pfdist.plugins.runs.runs_table import formatted_value, keys_of_runs, shown_names
from pfdist.plugins.runs.studies import (
    SEED,
    SET,
    Average,
    averages,
    columns_of_study,
    formatted_point,
    is_numeric,
    still_varying,
    values_of_points,
)
from pfdist.problem.set_key import labels_of_sets
from pfdist.store.folder import FORMATS

MOST_LINES = 20  # nobody could distinguish more
_MARKERS = ("o", "s", "^", "D", "v", "P")
_DASHES = ("-", (0, (4, 1.5)), (0, (1, 1)), (0, (6, 1.5, 1, 1.5)))
_PARTS = (slice(1), slice(1, None))  # values that have colours, and values that have dashes
_BESIDE = 2.5  # points between two lines at one value
_LONGEST_LABEL, _LONGEST_TEXT = 42, 16  # letters
_MOST_TICKS, _CLOSEST = 8, 0.08  # ticks at the values, and their least distance over the axis
_BEST = "best times"
_PER_CENT = (
    "gain_of_means", "mean_relative_gain", "positive_fraction", "bound_gap", "bound_gap_at_most",
)  # fmt: skip
_Line = tuple[tuple[Any, ...], list[Average]]


def against(
    table: pd.DataFrame | Any,
    key: str | None = None,
    value: str = "expected_mse",
    *,
    ax: Axes | None = None,
) -> Axes:
    """Draw a result of many runs against a key of their jobs, with 95 % intervals.

    Runs that differ only in their seeds are replicates: small points, and a line through their
    means, with the interval of the mean by Student's t. Without replicates, the interval is that
    of the run. There is a line for each combination of the other keys and the sets; lines are
    drawn a little beside each other. Colours show the first of these that varies. The expected MSE
    of the references is dashed and grey.

    Parameters
    ----------
    table : DataFrame
        The result of `pfdist.table`, or an object with such a method ``table``, such as the result
        of `pfdist.sweep`.
    key : str, optional
        A column with a key in which the jobs differ; by default the first other than seed, if
        there is another. Values that are not numbers are categories.
    value : str
        A column with a result. Gains, fractions and gaps are drawn in per cent.
    ax : matplotlib Axes, optional
        By default those of a new figure.

    Returns
    -------
    matplotlib Axes

    Raises
    ------
    JobError
        The table lacks a column.
    ArgumentError
        There are more than 20 lines.
    """
    frame = table_of(table, "table", "table")
    for name in ("run", SET):
        if name not in frame.columns:
            raise ArgumentError(
                f"table must be a result of pfdist.table, got one without the column {name}",
                argument="table",
            )
    key, value = _key(frame, key), _result(frame, value)
    names = still_varying(frame, [key])
    lines = _lines(frame, [key, *names], value)
    if len(lines) > MOST_LINES:
        raise ArgumentError(
            f"the table must give at most {MOST_LINES} lines, got {len(lines)} combinations of "
            f"{', '.join(names)}: select rows, as table[table[{shown(names[-1])}] == ...]",
            argument="table",
        )
    ax = axes_for(ax, 2.2 + 0.08 * len(lines))
    if not lines:
        return write_instead(ax, "no result is finite")
    places, factor = _places(ax, values_of_points(frame, key)), 100.0 if value in _PER_CENT else 1.0
    colours, dashes = ([*dict.fromkeys(at[part] for at, _ in lines)] for part in _PARTS)
    curves, varied = [], keys_of_runs(frame)
    for number, (at, line) in enumerate(lines):
        shade, dash = colours.index(at[:1]), dashes.index(at[1:])
        colour = SERIES[shade % len(SERIES)]
        style = {
            "color": colour, "mfc": "white" if dash else colour, "ls": _DASHES[dash % len(_DASHES)],
            "marker": _MARKERS[shade % len(_MARKERS)],
            "label": clipped(formatted_point(names, at, varied) or _BEST, _LONGEST_LABEL),
        }  # fmt: skip
        aside = _BESIDE * (number - (len(lines) - 1) / 2)
        curves.append(_draw_line(ax, line, places, factor, style, aside))
    if value == "expected_mse":
        _draw_references(ax, frame, key, places)
    ax.set_xlabel(verbatim(shown_names(keys_of_runs(frame))[key]))
    words = verbatim(value.replace("_", " ").replace("mse", "MSE"))
    ax.set_ylabel(words + " [%]" * (value in _PER_CENT))
    cut_outliers(ax, curves)
    if len(ax.get_legend_handles_labels()[1]) > 1:
        legend_above(ax)
    return ax


def draw_points(frame: pd.DataFrame, folder: Path, formats: Sequence[str] = ()) -> list[Path]:
    """The files of the figure of a sweep: of `against`, in ``figures`` of the folder.

    Parameters
    ----------
    frame : DataFrame
        The result of `pfdist.table`.
    folder : Path
    formats : sequence of str
        Further formats, as in `pfdist.pages.figure.draw_figures`.
    """
    title = f"Expected MSE against {_key(frame, None)}."
    plot = Plot(2.6, lambda panels: against(frame, ax=panels[0]), title=title)
    return save_plots(folder, [("points", plot)], formats)


def draw_folder(folder: Path) -> list[Path]:
    """The files of the figure of a folder of runs, in all formats."""
    return draw_points(table(folder), folder, FORMATS)


def _key(frame: pd.DataFrame, key: str | None) -> str:
    """The column with this key; by default the first in which the jobs differ."""
    keys = keys_of_runs(frame)
    if key is not None:
        return chosen(key, keys, "key")
    if not keys:
        raise ArgumentError("against needs runs whose jobs differ, got none", argument="table")
    columns = [name for name in (*columns_of_study(frame), *keys) if name not in (SET, SEED)]
    return columns[0] if columns else SEED


def _result(frame: pd.DataFrame, value: str) -> str:
    """The column with this result, if it holds numbers."""
    results = map(str, frame.loc[:, SET:].select_dtypes("number"))
    return chosen(value, [n for n in results if not n.endswith(("_low", "_high"))], "value")


def _text(value: Any) -> str:
    return clipped(formatted_value(value) or "none", _LONGEST_TEXT)


def _lines(frame: pd.DataFrame, names: list[str], value: str) -> list[_Line]:
    """The finite results that share the values of all columns but the first, with these values."""
    lines: dict[tuple[Any, ...], list[Average]] = {}
    for each in averages(frame, names, value):
        if math.isfinite(each.mean):
            lines.setdefault(each.point[1:], []).append(each)
    return list(lines.items())


def _draw_references(ax: Axes, frame: pd.DataFrame, key: str, places: dict[Any, float]) -> None:
    """Draw the expected MSE of the references, a line for each combination of the other keys."""
    others = [name for name in still_varying(frame, [key]) if name not in (key, SET)]
    lines = _lines(frame, [key, "reference", *others], "reference_mse")
    names = {str(at[0]) for at, _ in lines}
    label = labels_of_sets(names, {})[names.pop()] if len(names) == 1 else "references"
    for _, means in lines:
        line = [replace(each, low=math.nan, high=math.nan, replicates=()) for each in means]
        style = {"color": GREY, "marker": "_", "ls": _DASHES[1], "label": label}
        _draw_line(ax, line, places, 1.0, style)
        label = ""


def _draw_line(
    ax: Axes, line: list[Average], places: dict[Any, float], factor: float, style: dict[str, Any],
    aside: float = 0.0
) -> CurvePoints:  # fmt: skip
    """Draw means with their intervals, and replicates, shifted to the side by so many points."""
    line = sorted(line, key=lambda each: places[each.point[0]])
    x = np.array([places[each.point[0]] for each in line], np.float64)
    mean, low, high = factor * np.array([(each.mean, each.low, each.high) for each in line]).T
    ends = np.nan_to_num([mean - low, high - mean], nan=0.0, posinf=0.0, neginf=0.0)
    shift, right = (
        ax.transData + ScaledTranslation(inches, 0.0, ax.figure.dpi_scale_trans)
        for inches in (aside / 72, (aside + marker()) / 72)
    )
    shape = style | {"label": verbatim(style["label"]) or "_", "transform": shift}
    shape["ls"] = style["ls"] if is_numeric(list(places)) else ""
    ax.errorbar(
        x, mean, ends, ms=marker(), lw=thin(0.9), elinewidth=thin(0.7), capsize=marker(0.5), **shape
    )
    several = [(at, y) for at, each in zip(x, line, strict=True) for y in each.replicates
               if len(each.replicates) > 1]  # fmt: skip
    at, seeds = np.array(several).reshape(-1, 2).T * [[1.0], [factor]]
    small = marker(0.6)
    ax.plot(at, seeds, "o", color=style["color"], alpha=0.6, ms=small, mew=0, transform=right)
    reached = np.concatenate([mean - ends[0], mean + ends[1], seeds])
    ax.update_datalim(np.column_stack([[*x, *x, *at], reached]))  # not done where axes are shifted
    ax.autoscale_view()
    return points(x, mean, style["color"], verbatim(style["label"]))


def _places(ax: Axes, values: list[Any]) -> dict[Any, float]:
    """The place of each value on the horizontal axis: a number, or the position of a category."""
    if not is_numeric(values):
        ax.set_xticks(range(len(values)), [verbatim(_text(each)) for each in values])
        ax.set_xlim(-0.5, len(values) - 0.5)
        return {value: float(place) for place, value in enumerate(values)}
    at = np.array(values, np.float64)
    if len(at) > 2 and at[0] > 0 and at[-1] >= 10 * at[0]:
        plain, logarithmic = np.diff(at), np.diff(np.log(at))
        if logarithmic.min() / logarithmic.sum() > plain.min() / plain.sum():
            ax.set_xscale("log")
    gaps = np.diff(np.log(at) if ax.get_xscale() == "log" else at)
    if len(at) <= _MOST_TICKS and np.all(gaps >= _CLOSEST * gaps.sum()):
        ax.set_xticks(at, [verbatim(_text(each)) for each in values])
        ax.set_xticks([], minor=True)
    return dict(zip(values, at.tolist(), strict=True))
