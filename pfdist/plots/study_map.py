"""A result of many runs as a heat map over two keys of their jobs."""

import math
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import colormaps, rcParams
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.font_manager import FontProperties
from matplotlib.patches import Rectangle

from pfdist.analysis.studies import Average, averages, columns_of, not_told_by, values_of
from pfdist.analysis.table_cells import keys_of, told_value
from pfdist.common.rounding import with_interval
from pfdist.common.short_names import short_names
from pfdist.errors import ArgumentError, shown
from pfdist.plots.panel import axes_for, clipped, minus, table_of, thin, verbatim, write_instead
from pfdist.plots.study_columns import is_in_per_cent, key_among, label_of, value_among
from pfdist.plots.style import GREY

_SHADES = colormaps["cividis"].resampled(64)  # even in lightness, so also in grey print
_DARK, _LIGHT = "#111111", "#fafafa"  # of texts on cells; a page changes black and white
_MIDDLE = 0.5  # lightness between light and dark cells
_AXIS_INCHES, _ROW_INCHES, _LEAST_INCHES = 0.7, 0.3, 1.9
_LETTER = 0.62  # width of a digit over the size of the font
_LEAST_POINTS = 4.5  # of the font in a cell
_LONGEST_LABEL, _LONGEST_NAME = 16, 30


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
    frame = table_of(table, "table", "table")
    x = key_among(frame, x, "x")
    y = key_among(frame, y, "y") if y else _second(frame, x)
    value = value_among(frame, value)
    _check(frame, x, y)
    across, down = (values_of(frame, name) for name in (x, y))
    found = {each.point: each for each in averages(frame, [x, y], value)}
    ax = axes_for(ax, map_inches(frame, y))
    factor = 100.0 if is_in_per_cent(value) else 1.0
    cells = np.full((len(down), len(across)), np.nan)
    for row, below in enumerate(down):
        for column, beside in enumerate(across):
            if (beside, below) in found:
                cells[row, column] = factor * found[beside, below].mean
    shown_cells = np.ma.masked_invalid(cells)
    if not shown_cells.count():
        return write_instead(ax, "no result is known and finite")
    mesh = ax.pcolormesh(shown_cells, cmap=_SHADES, edgecolors="face", linewidth=0.1)
    figure = ax.get_figure()
    if figure is not None:
        bar = figure.colorbar(mesh, ax=ax, label=label_of(value), drawedges=False)
        bar.outline.set_visible(False)
    short = short_names(keys_of(frame))
    ax.set_xlabel(verbatim(clipped(short[x], _LONGEST_NAME)))
    ax.set_ylabel(verbatim(clipped(short[y], _LONGEST_NAME)))
    ax.set_xticks(np.arange(len(across)) + 0.5, list(map(_told, across)))
    ax.set_yticks(np.arange(len(down)) + 0.5, list(map(_told, down)))
    ax.tick_params(length=0)
    for name in ("left", "bottom"):
        ax.spines[name].set_visible(False)
    texts = {
        (row, column): minus(_number(found[beside, below], factor))
        for row, below in enumerate(down)
        for column, beside in enumerate(across)
        if (beside, below) in found
    }
    _write(ax, mesh, cells, texts)
    _hatch(ax, cells)
    return ax


def map_inches(frame: pd.DataFrame, y: str) -> float:
    """Give the height of the figure `heat_map`, in inches where the style has 8 points."""
    return max(_LEAST_INCHES, _AXIS_INCHES + _ROW_INCHES * len(values_of(frame, y)))


def _second(frame: pd.DataFrame, x: str) -> str:
    others = [name for name in columns_of(frame) if name in keys_of(frame) and name != x]
    if not others:
        raise ArgumentError(
            f"y must be a second key in which the jobs differ, but beside {x} they differ in none "
            "but the seed",
            argument="y",
        )
    return others[0]


def _check(frame: pd.DataFrame, x: str, y: str) -> None:
    if x == y:
        raise ArgumentError(f"x and y must be different keys, got {shown(x)} twice", argument="y")
    others = not_told_by(frame, [x, y])
    if others:
        name = others[0]
        raise ArgumentError(
            f"the table must have one value of {name}, got {len(values_of(frame, name))}: select "
            f"rows, as table[table[{shown(name)}] == {shown(values_of(frame, name)[0])}]",
            argument="table",
        )


def _told(value: Any) -> str:
    return verbatim(clipped(told_value(value) or "none", _LONGEST_LABEL))


def _number(average: Average, factor: float) -> str:
    """Give a mean with the digits that its interval allows; three if it has none."""
    return with_interval(*(factor * part for part in (average.mean, average.low, average.high)))[0]


def _write(
    ax: Axes, mesh: QuadMesh, cells: np.ndarray[Any, Any], texts: dict[tuple[int, int], str]
) -> None:
    """Write the numbers into the cells, if they have room."""
    figure = ax.get_figure(root=True)
    if figure is None or not texts:
        return
    inches = 0.8 * ax.get_window_extent().width / figure.dpi / cells.shape[1]
    longest = max(map(len, texts.values()))
    most = FontProperties(size=rcParams["xtick.labelsize"]).get_size_in_points()
    size = min(most, 72 * inches / (_LETTER * (longest + 1)))
    if size < _LEAST_POINTS:
        return
    for (row, column), text in texts.items():
        value = cells[row, column]
        is_light = math.isfinite(value) and _lightness(mesh, value) > _MIDDLE
        colour = _DARK if is_light else _LIGHT if math.isfinite(value) else None
        ax.text(
            column + 0.5, row + 0.5, text, ha="center", va="center", size=size,
            color=colour or rcParams["text.color"],
        )  # fmt: skip


def _lightness(mesh: QuadMesh, value: float) -> float:
    red, green, blue, _ = mesh.to_rgba(np.array(value))
    return float(0.299 * red + 0.587 * green + 0.114 * blue)


def _hatch(ax: Axes, cells: np.ndarray[Any, Any]) -> None:
    """Hatch the cells that have no finite value."""
    for row, column in np.argwhere(~np.isfinite(cells)):
        ax.add_patch(
            Rectangle(
                (column, row), 1, 1, fill=False, hatch="////", edgecolor=GREY, lw=thin(0.3),
                zorder=0.5,
            )
        )  # fmt: skip
