"""The worth of each measurement, and its sampling window: how far it may move at a small loss."""

from collections.abc import Mapping, Sequence
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from pfdist.pages.figure import Plot, Tables, figure
from pfdist.pages.panel import (
    BAND,
    axes_for,
    chosen,
    clock_of_table,
    cut_outliers,
    height_of_rows,
    label_error,
    label_times,
    legend_above,
    marker,
    points,
    rows_with_results,
    step_of,
    table_of,
    thin,
    verbatim,
    write_instead,
)
from pfdist.pages.style import GREY, RED, SENSORS
from pfdist.problem.clock import Time
from pfdist.problem.set_key import phrase_of
from pfdist.results.sampling_windows import STRICT, WIDE, runs_of, sentences, windows_of

_WIDTH = 0.4  # instants over which the stems of several sets at the same instant are spread
_ROW, _TALLEST = 0.14, 6.0  # inches of a row, and of a figure
_LONG_NAME = 16  # letters of a measurement; beside longer ones a legend has less room
_MOST_LABELS = 30  # rows that have room for their names
_LENGTH = 0.8  # of a bar, in instants
_BARS = ((WIDE, 0.28), (STRICT, 0.72))  # level, and height in rows


def worth(measurements: object, names: Sequence[str] = (), *, ax: Axes | None = None) -> Axes:
    """Draw the rise of the expected MSE if a measurement is left out, with 95 % intervals.

    The stems of several sets and sensors at one instant stand side by side, and each sensor has a
    marker.

    Parameters
    ----------
    measurements : DataFrame or object
        A table with the columns name, t, removed and removed_error; or an object whose ``worth`` or
        ``measurements`` it is, such as the result of `pfdist.why`.
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
    table, curves = table_of(measurements, "measurements", "worth", "measurements"), []
    sets, ax = rows_with_results(table, names), axes_for(ax)
    if table.empty:
        return write_instead(ax, "there is no table of what measurements are worth")
    sensors = sorted({*table["sensor"]}) if "sensor" in table else [""]
    markers = dict(zip(sensors, cycle(SENSORS), strict=False))
    number, step = len(sets) * len(sensors), step_of(table["t"])
    spread = iter(np.linspace(-_WIDTH / 2, _WIDTH / 2, number) if number > 1 else [0.0])
    for _, of_set, plain in sets:
        style = plain | {"ls": "", "ms": marker(0.9)}
        ax.plot([], [], **style)
        for sensor in sensors:
            rows = (of_set[of_set["sensor"] == sensor] if sensor else of_set).dropna(
                subset="removed"
            )
            own = style | {"label": None} | ({"marker": markers[sensor]} if sensor else {})
            t, rise = rows["t"].to_numpy() + next(spread) * step, rows["removed"].to_numpy()
            ax.vlines(t, 0.0, rise, color=style["color"], lw=thin())
            half = BAND * rows["removed_error"].to_numpy()
            ax.errorbar(t, rise, half, elinewidth=thin(0.6), **own)
            curves.append(points(t, rise, style["color"], style["label"] or ""))
    for sensor in filter(None, sensors):
        ax.plot([], [], markers[sensor], color=GREY, ms=marker(0.9), label=verbatim(sensor))
    ax.axhline(0.0, color=GREY, lw=thin(0.6), zorder=0)
    cut_outliers(ax, curves, keep=[0.0])
    label_error(ax, table, "MSE rise if left out")
    label_times(ax, table)
    if len(ax.get_legend_handles_labels()[1]) > 1:
        legend_above(ax)
    return ax


@figure(
    "sampling_windows",
    applies=lambda run: "sampling_windows" in run.tables,
    each_set=True,
)
def sampling_windows_figure(tables: Tables, name: str) -> Plot:
    """Sampling windows: instants to which each measurement alone can move at a small loss."""
    table = tables.run.table("sampling_windows")
    rows, which = table[table["name"] == name], phrase_of(tables.run.labels[name])
    said = sentences(rows.to_dict("records"), clock_of_table(table))
    return Plot(
        _height(len(windows_of(rows.to_dict("records"), WIDE, clock_of_table(table)))),
        lambda panels: sampling_windows(rows, name, ax=panels[0]),  # a set may measure nothing
        title=f"Sampling windows of {which}. {said[0] if said else 'Nothing can move.'}",
    )


def _height(rows: int) -> float:
    return min(height_of_rows(rows, _ROW), _TALLEST)


def sampling_windows(table: object, name: str = "", *, ax: Axes | None = None) -> Axes:
    """Draw the instants to which each measurement alone can move at a loss of at most 1 and 5 %.

    Each measurement is a row. A thick bar covers the instants within 1 %, a thin bar those within
    5 %. Hollow bars cover the instants that need more draws. A grey line covers all instants that
    were tried: up to the first that is clearly beyond 5 %, or to the last that the job and the
    neighbouring measurements allow.

    Parameters
    ----------
    table : DataFrame or object
        A table with the columns t, moved_to, within_1 and within_5, and name if there are several
        sets; or an object whose ``sampling_windows`` it is, such as a run or the result of
        `pfdist.why`.
    name : str
        The set that is drawn; by default the last set.
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
    every = table_of(table, "table", "sampling_windows")
    if "name" in every and len(every):
        names = list(dict.fromkeys(map(str, every["name"])))
        every = every[every["name"] == (chosen(name, names, "name") if name else names[-1])]
    rows = every.sort_values(["t", "moved_to"])
    if rows.empty:
        return write_instead(axes_for(ax), "there is no measurement that can be moved")
    columns, clock = [column for column in ("t", "sensor") if column in rows], clock_of_table(rows)
    moved = rows.groupby(columns)["moved_to"].agg(["min", "max"]).reset_index()
    times, places = moved["t"].tolist(), range(len(moved))
    names = [clock.text(clock.of_row(row)) for row in moved.to_dict("records")]
    ax = axes_for(ax, _height(len(times)))
    ax.hlines(places, moved["min"], moved["max"], color=GREY, lw=thin(0.6), zorder=1)
    length = _LENGTH * step_of(rows["moved_to"])
    for order, (percent, height) in enumerate(_BARS, start=2):
        for place, window in enumerate(windows_of(rows.to_dict("records"), percent, clock)):
            y = (place - height / 2, height)
            sure, left_open = _spans(window.inside, length), _spans(window.open, length)
            ax.broken_barh(sure, y, color=RED, lw=0, zorder=order)
            if left_open:
                ax.broken_barh(left_open, y, fc="none", ec=RED, lw=thin(0.5), zorder=order)
    ax.plot(times, places, "o", color="black", ms=marker(0.5), zorder=5)
    step = -(-len(times) // _MOST_LABELS)
    ax.set_ylim(max(len(times), 3) - 0.4, -0.6)  # the first measurement on top
    ax.set_yticks(places[::step], names[::step])
    ax.tick_params(axis="y", length=0)
    ax.set_ylabel("measurement at")
    label_times(ax, rows)
    handles = [
        Patch(fc=RED, lw=0, label=f"error at most {STRICT} % higher (thin: {WIDE} %)"),
        Patch(fc="white", ec=RED, lw=thin(0.5), label="open"),
        Line2D([], [], color=GREY, lw=thin(0.6), label="tried"),
    ]
    legend_above(ax, handles, columns=3 if max(map(len, names)) <= _LONG_NAME else 2)
    return ax


def _spans(instants: Mapping[Time, int], length: float) -> list[tuple[float, float]]:
    """The left end and the length of a bar over each stretch of successive instants.

    `instants` gives the number of each instant, which on a clock differs from its time.
    """
    return [(run[0] - length / 2, run[-1] - run[0] + length) for run in runs_of(instants)]
