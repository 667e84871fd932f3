"""Figures of many runs: a result against a key, a heat map over two keys, and the found times."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import colormaps, rcParams
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from matplotlib.transforms import ScaledTranslation

from pfdist.common.dotted_keys import short_names
from pfdist.common.formatted_times import times_of
from pfdist.common.rounding import with_interval
from pfdist.errors import ArgumentError, shown
from pfdist.pages.panel import (
    Points,
    axes_for,
    chosen,
    clipped,
    cut_outliers,
    height_of_rows,
    label_instants,
    legend_above,
    marker,
    minus,
    points,
    table_of,
    thin,
    verbatim,
    write_instead,
)
from pfdist.pages.style import GREY, SERIES
from pfdist.pages.times_axis import times
from pfdist.results.studies import (
    SEED,
    SET,
    Average,
    averages,
    columns_of,
    formatted_point,
    in_order,
    is_numeric,
    still_varying,
    values_of,
)
from pfdist.results.table_cells import formatted_value, is_missing, keys_of

MOST_LINES = 20  # more could not be told apart
ROW_OF_MAP = 0.3  # inches
_MARKERS = ("o", "s", "^", "D", "v", "P")
_DASHES = ("-", (0, (4, 1.5)), (0, (1, 1)), (0, (6, 1.5, 1, 1.5)))
_PARTS = (slice(1), slice(1, None))  # values that colours tell apart, and dashes
_BESIDE = 2.5  # points between two lines at one value
_LONGEST_LABEL, _LONGEST_TEXT = 42, 16  # letters
_MOST_TICKS, _CLOSEST = 8, 0.08  # ticks at the values, and their least distance over the axis
_SHADES = colormaps["cividis"].resampled(64)  # even in lightness, so also in grey print
_BEST = "best times"
_DARK, _LIGHT = "#111111", "#fafafa"  # of texts on cells; a page changes black and white
_PER_CENT = ("gain_of_means", "mean_relative_gain", "positive_fraction", "loss", "bound_gap",
             "bound_gap_at_most")  # fmt: skip
Line = tuple[tuple[Any, ...], list[Average]]


def against(
    table: pd.DataFrame | Any,
    key: str | None = None,
    value: str = "expected_mse",
    *,
    group: str | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw a result of many runs against a key of their jobs, with 95 % intervals.

    Runs that differ in their seeds alone are replicates: small points, and a line through their
    means, with the interval of the mean by Student's t. Where no runs differ in their seeds alone,
    the interval is that of the run. There is a line for each combination of values of the other
    keys and sets; lines stand a little beside each other. The expected MSE of the references is
    dashed and grey.

    Parameters
    ----------
    table : DataFrame
        As `pfdist.table` gives it, or an object with such a method ``table``, as what
        `pfdist.sweep` returns.
    key : str, optional
        A column with a key in which the jobs differ; by default the first other than seed. Values
        that are no numbers are categories.
    value : str
        A column with a result. Gains, fractions and gaps are drawn in per cent.
    group : str, optional
        The key, or ``set``, whose values have colours; by default the set if there are several,
        else the next differing key.
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
    frame = _runs(table)
    key, value = _key(frame, key, "key"), _result(frame, value)
    first = [] if group is None else [_key(frame, group, "group", SET)]
    names = [name for name in (*first, *still_varying(frame, [key, *first])) if name != key]
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
    places, factor = _places(ax, values_of(frame, key)), _factor(value)
    colours, dashes = ([*dict.fromkeys(at[part] for at, _ in lines)] for part in _PARTS)
    curves = []
    for number, (at, line) in enumerate(lines):
        shade, dash = colours.index(at[:1]), dashes.index(at[1:])
        colour = SERIES[shade % len(SERIES)]
        style = {
            "color": colour, "mfc": "white" if dash else colour, "ls": _DASHES[dash % len(_DASHES)],
            "marker": _MARKERS[(shade + shade // len(SERIES)) % len(_MARKERS)],
            "label": clipped(formatted_point(names, at, keys_of(frame)) or _BEST, _LONGEST_LABEL),
        }  # fmt: skip
        aside = _BESIDE * (number - (len(lines) - 1) / 2)
        curves.append(_draw_line(ax, line, places, factor, style, aside))
    if value == "expected_mse":
        _draw_references(ax, frame, key, places)
    ax.set_xlabel(verbatim(short_names(keys_of(frame))[key]))
    ax.set_ylabel(_label(value))
    cut_outliers(ax, curves)
    if len(ax.get_legend_handles_labels()[1]) > 1:
        legend_above(ax)
    return ax


def heat_map(
    table: pd.DataFrame | Any,
    x: str | None = None,
    y: str | None = None,
    value: str = "gain_of_means",
    *,
    ax: Axes | None = None,
) -> Axes:
    """Draw a result of many runs as a heat map over two keys of their jobs, with the numbers.

    Runs that differ in their seeds alone are averaged. A number has the digits that its 95 %
    interval allows. Cells without a result are hatched.

    Parameters
    ----------
    table : DataFrame
        As `pfdist.table` gives it, or an object with such a method ``table``, as what
        `pfdist.sweep` returns. It has one set, and one value of each key other than `x`, `y` and
        the seed: select rows.
    x, y : str, optional
        Columns with keys in which the jobs differ; by default the first two other than seed.
    value : str
        A column with a result. Gains, fractions and gaps are drawn in per cent.
    ax : matplotlib Axes, optional
        By default those of a new figure. The bar of colours takes some of their room.

    Returns
    -------
    matplotlib Axes

    Raises
    ------
    JobError
        The table lacks a column.
    ArgumentError
        The two keys are one, or rows differ in more than them and the seed.
    """
    frame = _runs(table)
    x = _key(frame, x, "x")
    y, value = _key(frame, y, "y", without=x), _result(frame, value)
    if x == y:
        raise ArgumentError(f"x and y must be different keys, got {shown(x)} twice", argument="y")
    if others := still_varying(frame, [x, y]):
        several = values_of(frame, others[0])
        raise ArgumentError(
            f"the table must have one value of {others[0]}, got {len(several)}: select rows, as "
            f"table[table[{shown(others[0])}] == {shown(several[0])}]",
            argument="table",
        )
    across, down, results = values_of(frame, x), values_of(frame, y), averages(frame, [x, y], value)
    cells = np.full((len(down), len(across)), np.nan)
    places = [(down.index(each.point[1]), across.index(each.point[0])) for each in results]
    for place, each in zip(places, results, strict=True):
        cells[place] = _factor(value) * each.mean
    ax = axes_for(ax, height_of_rows(len(down), ROW_OF_MAP))
    if not np.isfinite(cells).any():
        return write_instead(ax, "no result is finite")
    mesh = ax.pcolormesh(np.ma.masked_invalid(cells), cmap=_SHADES, edgecolors="face", lw=0.1)
    bar = ax.figure.colorbar(mesh, ax=ax, label=_label(value), use_gridspec=False)
    bar.outline.set_visible(False)
    short = short_names(keys_of(frame))
    for axis, name, values in ((ax.xaxis, x, across), (ax.yaxis, y, down)):
        axis.set_label_text(verbatim(short[name]))
        axis.set_ticks(np.arange(len(values)) + 0.5, [verbatim(_text(each)) for each in values])
    ax.tick_params(length=0)
    ax.spines[["left", "bottom"]].set_visible(False)
    is_light = np.asarray(mesh.norm(np.ma.masked_invalid(cells))) > 0.5
    intervals = np.array([(each.mean, each.low, each.high) for each in results])
    texts = [minus(with_interval(*numbers)[0]) for numbers in _factor(value) * intervals]
    inches = ax.get_window_extent().width / ax.figure.dpi / len(across)
    size = min(rcParams["font.size"], 90 * inches / (1 + max(map(len, texts))))
    for (row, column), text in zip(places, texts, strict=True):
        if size > 0.55 * rcParams["font.size"] and np.isfinite(cells[row, column]):
            colour = _DARK if is_light[row, column] else _LIGHT
            ax.text(column + 0.5, row + 0.5, text, ha="center", va="center", size=size, c=colour)
    if not np.isfinite(cells).all():
        hatched = Rectangle((0, 0), 1, 1, transform=ax.transAxes, fill=False, hatch="////")
        ax.add_patch(hatched).set(edgecolor=GREY, lw=0, zorder=0)
    return ax


def found_times(
    table: pd.DataFrame | Any, *, horizon: float | None = None, ax: Axes | None = None
) -> Axes:
    """Draw the found times of many runs, a row for each run and set, on one clock.

    A row is labelled with the values in which the runs differ. Where there is no room for all
    labels, the vertical axis says which are left out.

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
    frame = _runs(table, "measurement_times")
    keys = keys_of(frame)
    names = [*(key for key in keys if key != SEED), SET, *({SEED} & {*keys})]
    names = [name for name in names if len(values_of(frame, name)) > 1] or ["run"]
    rows = {}
    for row in in_order(frame, names):
        if not is_missing(row["measurement_times"]):
            label = ", ".join(_text(row[name]) for name in names)
            rows[f"{label}, {row['run']}" if label in rows else label] = row["measurement_times"]
    if not rows:
        return write_instead(axes_for(ax), "no run has found times")
    ax = times(rows, horizon=horizon, ax=ax)
    short, left_out = short_names(keys), ax.get_ylabel()
    ax.set_ylabel(
        "\n".join([verbatim(", ".join(short.get(n, n) for n in names)), left_out]).strip()
    )
    whole = all(t == int(t) for at in rows.values() for t in times_of(at))
    label_instants(ax, frame.attrs.get("time_unit", ""), whole=whole)
    return ax


def _runs(table: pd.DataFrame | Any, *columns: str) -> pd.DataFrame:
    """The table of runs; an error names the first of its columns that it lacks."""
    frame = table_of(table, "table", "table")
    for name in ("run", SET, *columns):
        if name not in frame.columns:
            raise ArgumentError(
                f"table must be a table of runs as pfdist.table gives it, but lacks the column "
                f"{name}",
                argument="table",
            )
    return frame


def _key(
    frame: pd.DataFrame, key: str | None, argument: str, *others: str, without: str = ""
) -> str:
    """The column with this key; by default the first in which jobs differ, other than `without`."""
    keys = keys_of(frame)
    if key is not None:
        return chosen(key, [*keys, *others], argument)
    for name in columns_of(frame) if without else (*columns_of(frame), *keys):
        if name in keys and name not in (SEED, without):
            return name
    which, but = ("a second key", f"beside {without} they") if without else ("a key", "they")
    raise ArgumentError(
        f"{argument} must be {which} in which the jobs differ, but {but} differ in none but the "
        "seed",
        argument=argument,
    )


def _result(frame: pd.DataFrame, value: str) -> str:
    """The column with this result, if it holds numbers."""
    results = map(str, frame.loc[:, SET:].select_dtypes("number"))
    return chosen(value, [n for n in results if not n.endswith(("_low", "_high"))], "value")


def _label(value: str) -> str:
    words = verbatim(value.replace("_", " ").replace("mse", "MSE"))
    return f"{words} [%]" if value in _PER_CENT else words


def _factor(value: str) -> float:
    return 100.0 if value in _PER_CENT else 1.0


def _text(value: Any) -> str:
    return clipped(formatted_value(value) or "none", _LONGEST_TEXT)


def _lines(frame: pd.DataFrame, names: list[str], value: str) -> list[Line]:
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
    label = names.pop() if len(names) == 1 else "references"
    for _, means in lines:
        line = [replace(each, low=math.nan, high=math.nan, replicates=()) for each in means]
        style = {"color": GREY, "marker": "_", "ls": _DASHES[1], "label": label}
        _draw_line(ax, line, places, 1.0, style)
        label = ""


def _draw_line(
    ax: Axes, line: list[Average], places: dict[Any, float], factor: float, style: dict[str, Any],
    aside: float = 0.0
) -> Points:  # fmt: skip
    """Draw means with their intervals, and replicates, so many points beside their places."""
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
    return points(x, mean, style["color"], style["label"])


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
