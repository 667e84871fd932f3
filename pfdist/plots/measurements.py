"""The worth of each measurement of a set: the rise of the error without it, or if it is moved."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from pfdist.plots.error_over_time import BAND, rows_of_sets
from pfdist.plots.outliers import Points, cut_outliers, points
from pfdist.plots.panel import (
    axes_for,
    draw_zero,
    label_times,
    legend_above,
    marker,
    step_of,
    table_of,
    thin,
    verbatim,
    write_instead,
)
from pfdist.plots.style import GREY

Array = NDArray[np.float64]
_WIDTH = 0.4  # of the instants over which the stems of all sets at one instant are spread


def worth(measurements: object, names: Sequence[str] = (), *, ax: Axes | None = None) -> Axes:
    """Draw the rise of the expected MSE if a measurement is removed, with 95 % intervals.

    Parameters
    ----------
    measurements : DataFrame or object
        A table with the columns name, t, removed and removed_error, or an object that has it as
        ``worth`` or ``measurements``, such as the result of `pfdist.why`.
    names : sequence of str
        Sets that are drawn, the reference first; by default all.
    ax : matplotlib Axes, optional
        By default those of a new figure.

    Returns
    -------
    matplotlib Axes

    Raises
    ------
    JobError
        The table has no set of this name.
    """
    table, curves = table_of(measurements, "measurements", "worth", "measurements"), list[Points]()
    sets, ax = rows_of_sets(table, names), axes_for(ax)
    if table.empty:
        return write_instead(ax, "there is no table of what measurements are worth")
    for (name, rows, style), aside in zip(sets, _aside(len(sets)), strict=True):
        t = rows["t"].to_numpy() + aside * step_of(table)
        rise = rows["removed"].to_numpy()
        ax.vlines(t, 0.0, rise, color=style["color"], lw=thin())
        _intervals(ax, t, rise, rows["removed_error"].to_numpy(), style)
        ax.plot([], [], label=verbatim(name) or None, **style | {"ls": ""}, ms=marker(0.9))
        curves.append(points(t, rise, style["color"], name))
    draw_zero(ax)
    cut_outliers(ax, curves, keep=[0.0])
    ax.set_ylabel("MSE rise if removed")
    label_times(ax, table)
    legend_above(ax)
    return ax


def shifts(measurements: object, names: Sequence[str] = (), *, ax: Axes | None = None) -> Axes:
    """Draw the rise of the expected MSE if a measurement is shifted by one instant.

    Parameters
    ----------
    measurements : DataFrame or object
        A table with the columns name, t, earlier, later and their errors, or an object that has it
        as ``worth`` or ``measurements``, such as the result of `pfdist.why`.
    names : sequence of str
        Sets that are drawn, the reference first; by default all.
    ax : matplotlib Axes, optional
        By default those of a new figure.

    Returns
    -------
    matplotlib Axes

    Raises
    ------
    JobError
        The table has no set of this name.
    """
    table, curves = table_of(measurements, "measurements", "worth", "measurements"), list[Points]()
    sets, ax = rows_of_sets(table, names), axes_for(ax)
    if table.empty:
        return write_instead(ax, "there is no table of what measurements are worth")
    for name, _, style in sets:
        ax.plot([], [], label=verbatim(name) or None, **style | {"ls": ""}, ms=marker(0.9))
    for change, shape, aside in (("earlier", "<", -0.3), ("later", ">", 0.3)):
        for name, found, style in sets:
            rows = found.dropna(subset=change)
            t = rows["t"].to_numpy() + aside * step_of(table)
            rise = rows[change].to_numpy()
            _intervals(ax, t, rise, rows[f"{change}_error"].to_numpy(), style | {"marker": shape})
            curves.append(points(t, rise, style["color"], name))
        told = f"one instant {change}"
        ax.plot([], [], shape, color=GREY, ms=marker(0.9), label=told)
    draw_zero(ax)
    cut_outliers(ax, curves, keep=[0.0])
    ax.set_ylabel("MSE rise if shifted")
    label_times(ax, table)
    legend_above(ax)
    return ax


def _aside(sets: int) -> list[float]:
    """Give how far from the instant each set is drawn, so that no set hides another."""
    return [0.0] if sets == 1 else np.linspace(-_WIDTH / 2, _WIDTH / 2, sets).tolist()


def _intervals(ax: Axes, t: Array, rise: Array, error: Array, style: dict[str, Any]) -> None:
    shape = style | {"ls": ""}
    ax.errorbar(t, rise, BAND * error, ms=marker(0.9), elinewidth=thin(0.6), **shape)
