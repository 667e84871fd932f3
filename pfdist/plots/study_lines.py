"""A result of many runs against the values of a key, with intervals."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.transforms import IdentityTransform, ScaledTranslation

from pfdist.analysis.studies import (
    SET,
    Average,
    averages,
    is_numeric,
    not_told_by,
    told_at,
    values_of,
)
from pfdist.analysis.table_cells import keys_of
from pfdist.common.short_names import short_names
from pfdist.errors import ArgumentError, shown
from pfdist.plots.outliers import cut_outliers, points
from pfdist.plots.panel import (
    axes_for,
    clipped,
    legend_above,
    marker,
    table_of,
    thin,
    verbatim,
    write_instead,
)
from pfdist.plots.study_axis import label_key, place_beside, places_of
from pfdist.plots.study_columns import is_in_per_cent, key_among, label_of, value_among
from pfdist.plots.style import GREY, SERIES

MOST_LINES = 20  # more could not be told apart
_MARKERS = ("o", "s", "^", "D", "v", "P")
_DASHES = ("-", (0, (4, 1.5)), (0, (1, 1)), (0, (6, 1.5, 1, 1.5)))
_LEGEND_LETTERS, _LONGEST_LABEL = 24, 42
_HEIGHT, _LEGEND_INCHES = 2.3, 0.16


@dataclass(frozen=True)
class _Line:
    """A line: the values that its points share, and how it looks."""

    point: tuple[Any, ...]
    label: str
    colour: str
    marker: str
    face: str
    dashes: Any


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
    frame = table_of(table, "table", "table")
    key, value = key_among(frame, key, "key"), value_among(frame, value)
    lines, names = _lines(frame, key, group)
    factor = 100.0 if is_in_per_cent(value) else 1.0
    found = averages(frame, [key, *names], value)
    ax = axes_for(ax, _inches(lines))
    if not any(math.isfinite(each.mean) for each in found):
        return write_instead(ax, "no result is known and finite")
    places = places_of(values_of(frame, key))
    is_axis = is_numeric(list(places))
    curves = []
    for number, line in enumerate(lines):
        beside = (number + 0.5) / len(lines) - 0.5
        own = [each for each in found if each.point[1:] == line.point]
        own = sorted(own, key=lambda each: places[each.point[0]])
        at = np.array(
            [place_beside(places[each.point[0]], beside, places, is_axis) for each in own]
        )
        _draw(ax, line, at, own, factor, is_axis)
        mean = factor * np.array([each.mean for each in own])
        curves.append(points(at, mean, line.colour, line.label))
    if value == "expected_mse":
        _draw_references(ax, frame, key, places, is_axis)
    label_key(ax, places, verbatim(short_names(keys_of(frame))[key]), is_axis)
    ax.set_ylabel(label_of(value))
    cut_outliers(ax, curves)
    handles, labels = ax.get_legend_handles_labels()
    if len(labels) > 1:
        names = [verbatim(line.label) for line in lines]
        order = sorted(range(len(labels)), key=lambda number: labels[number] not in names)
        fits = max(map(len, labels)) <= _LEGEND_LETTERS
        legend_above(ax, [handles[number] for number in order], columns=2 if fits else 1)
    return ax


def lines_inches(frame: pd.DataFrame, key: str) -> float:
    """Give the height of the figure `against`, in inches where the style has 8 points."""
    return _inches(_lines(frame, key, None)[0])


def _inches(lines: Sequence[_Line]) -> float:
    fits = all(len(line.label) <= _LEGEND_LETTERS for line in lines)
    rows = math.ceil((len(lines) + 1) / (2 if fits else 1))
    return _HEIGHT + _LEGEND_INCHES * max(0, rows - 2)


def _lines(frame: pd.DataFrame, key: str, group: str | None) -> tuple[list[_Line], list[str]]:
    """Give the lines, and the columns whose values tell them apart."""
    first = [] if group is None else [key_among(frame, group, "group", [SET])]
    names = [*first, *not_told_by(frame, [key, *first])]
    names = [name for name in names if name != key]
    ats = dict.fromkeys(each.point for each in averages(frame.assign(_any=0.0), names, "_any"))
    if len(ats) > MOST_LINES:
        raise ArgumentError(
            f"the table must give at most {MOST_LINES} lines, got {len(ats)} combinations of "
            f"{', '.join(names)}: select rows, as table[table[{shown(names[-1])}] == ...]",
            argument="table",
        )
    keys, groups, rests = keys_of(frame), list[Any](), list[Any]()
    lines = []
    for at in ats:
        colour, dashes = _position(groups, at[:1]), _position(rests, at[1:])
        label = told_at(names, at, keys)
        label = clipped(label, _LONGEST_LABEL)
        mark = _MARKERS[(colour + colour // len(SERIES)) % len(_MARKERS)]
        shade = SERIES[colour % len(SERIES)]
        face = "white" if dashes else shade
        lines.append(_Line(at, label, shade, mark, face, _DASHES[dashes % len(_DASHES)]))
    return lines, names


def _position(known: list[Any], value: Any) -> int:
    """Give the position of a value in a list, at whose end it is put if it is new."""
    if value not in known:
        known.append(value)
    return known.index(value)


def _draw(
    ax: Axes, line: _Line, at: np.ndarray[Any, Any], found: Sequence[Average], factor: float,
    is_axis: bool,
) -> None:  # fmt: skip
    """Draw the means of a line with their intervals, and the replicates."""
    mean, low, high = (
        factor * np.array([getattr(each, name) for each in found])
        for name in ("mean", "low", "high")
    )
    finite = np.isfinite(mean)
    with np.errstate(invalid="ignore"):  # an infinite mean, which is not drawn
        bars = np.stack([mean - low, high - mean])
    bars = np.nan_to_num(bars, nan=0.0, posinf=0.0, neginf=0.0)
    ax.errorbar(
        at[finite], mean[finite], bars[:, finite], color=line.colour,
        marker=line.marker, mfc=line.face,
        ls=line.dashes if is_axis else "", lw=thin(0.9), ms=marker(), elinewidth=thin(0.7),
        capsize=marker(0.5), capthick=thin(0.7), label=verbatim(line.label) or "_",
    )  # fmt: skip
    several = [
        (x, factor * y)
        for x, e in zip(at, found, strict=True)
        for y in e.replicates
        if len(e.replicates) > 1
    ]
    if several:
        x, y = np.array(several).T
        figure = ax.get_figure(root=True)
        scale = figure.dpi_scale_trans if figure else IdentityTransform()
        right = ScaledTranslation(marker() / 72, 0.0, scale)
        ax.plot(
            x, y, "o", color=line.colour, alpha=0.6, ms=marker(0.6), mew=0, zorder=1,
            transform=ax.transData + right,
        )  # fmt: skip


def _draw_references(
    ax: Axes, frame: pd.DataFrame, key: str, places: dict[Any, float], is_axis: bool
) -> None:
    """Draw the expected MSE of the references, a line for each combination of the other keys."""
    names = [name for name in not_told_by(frame, [key]) if name not in (key, SET)]
    found = averages(frame, [key, "reference", *names], "reference_mse")
    known = {str(each.point[1]) for each in found}
    label = known.pop() if len(known) == 1 else "references"
    for rest in dict.fromkeys(each.point[1:] for each in found):
        line = sorted(
            (places[each.point[0]], each.mean) for each in found if each.point[1:] == rest
        )
        at = [(place, mean) for place, mean in line if math.isfinite(mean)]
        if not at:
            continue
        ax.plot(
            *np.array(at).T, color=GREY, ls=(0, (4, 1.5)) if is_axis else "", lw=thin(0.8),
            marker="" if is_axis and len(at) > 1 else "_", ms=marker(2), zorder=0,
            label=verbatim(label),
        )  # fmt: skip
        label = "_"
