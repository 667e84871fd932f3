"""The worth of each measurement, and its sampling window: how far it can move at a small loss."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from pfdist.common.clock import Time
from pfdist.common.formatted_times import formatted_time, measurement_of
from pfdist.pages.figure import Plot, Tables, figure
from pfdist.pages.panel import (
    BAND,
    axes_for,
    chosen,
    cut_outliers,
    height_of_rows,
    label_times,
    legend_above,
    marker,
    points,
    rows_of_sets,
    step_of,
    table_of,
    thin,
    verbatim,
    write_instead,
)
from pfdist.pages.style import BLUE, GREY, RED, SENSORS
from pfdist.results.sampling_windows import STRICT, WIDE, runs_of, sentences, windows_of

_WIDTH = 0.4  # instants over which the stems of several sets at the same instant are spread
_ROW, _TALLEST = 0.14, 6.0  # inches of a row, and of a figure
_MOST_LABELS = 30  # rows that have room for their names
_LENGTH = 0.8  # of a bar, in instants
_BARS = ((WIDE, BLUE, 0.28), (STRICT, RED, 0.72))  # level, colour, and height in rows


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
    return _rises(measurements, names, ax, "removed", {"removed": ("", 0.0)})


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
    changes = {"earlier": ("<", -0.3), "later": (">", 0.3)}
    return _rises(measurements, names, ax, "shifted", changes)


def _rises(
    source: object,
    names: Sequence[str],
    ax: Axes | None,
    change: str,
    columns: Mapping[str, tuple[str, float]],
) -> Axes:
    """Draw the columns of a table of rises, with their 95 % intervals.

    `change` says what is done to a measurement. `columns` gives, for each column, its marker and
    the number of instants by which it is drawn beside t. A column without a marker has stems, and
    the stems of several sets and sensors at the same instant stand side by side. With sensors, each
    has a marker, which a column with a marker shows where nothing is shifted.
    """
    table, curves = table_of(source, "measurements", "worth", "measurements"), []
    sets, ax = rows_of_sets(table, names), axes_for(ax)
    if table.empty:
        return write_instead(ax, "there is no table of what measurements are worth")
    sensors = sorted({*table["sensor"]}) if "sensor" in table else [""]
    markers = dict(zip(sensors, SENSORS, strict=False))
    number, step = len(sets) * len(sensors), step_of(table["t"])
    spread = iter(np.linspace(-_WIDTH / 2, _WIDTH / 2, number) if number > 1 else [0.0])
    for name, of_set, plain in sets:
        style = plain | {"ls": "", "ms": marker(0.9)}
        ax.plot([], [], label=verbatim(name) or None, **style)
        for sensor in sensors:
            rows, beside = of_set[of_set["sensor"] == sensor] if sensor else of_set, next(spread)
            own = style | ({"marker": markers[sensor]} if sensor else {})
            if sensor and change == "shifted":
                ax.plot(rows["t"] + beside * step, np.zeros(len(rows)), **own)
            for column, (shape, aside) in columns.items():
                present = rows.dropna(subset=column)
                together = (beside if sensor else 0.0) + aside if aside else beside
                t = present["t"].to_numpy() + together * step
                rise = present[column].to_numpy()
                half = BAND * present[f"{column}_error"].to_numpy()
                if not shape:
                    ax.vlines(t, 0.0, rise, color=style["color"], lw=thin())
                shaped = own | ({"marker": shape} if shape else {})
                ax.errorbar(t, rise, half, elinewidth=thin(0.6), **shaped)
                curves.append(points(t, rise, style["color"], name))
    for sensor in filter(None, sensors):
        ax.plot([], [], markers[sensor], color=GREY, ms=marker(0.9), label=verbatim(sensor))
    for column, (shape, _) in columns.items():
        if shape:
            ax.plot([], [], shape, color=GREY, ms=marker(0.9), label=f"one instant {column}")
    ax.axhline(0.0, color=GREY, lw=thin(0.6), zorder=0)
    cut_outliers(ax, curves, keep=[0.0])
    ax.set_ylabel(f"MSE rise if {change}")
    label_times(ax, table)
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
    rows = table[table["name"] == name]
    said = sentences(rows.to_dict("records"))
    return Plot(
        _height(len(windows_of(rows.to_dict("records"), WIDE))),
        lambda panels: sampling_windows(rows, name, ax=panels[0]),  # a set may measure nothing
        title=f"Sampling windows of {name}. {said[0] if said else 'Nothing can move.'}",
    )


def _height(rows: int) -> float:
    return min(height_of_rows(rows, _ROW), _TALLEST)


def sampling_windows(table: object, name: str = "", *, ax: Axes | None = None) -> Axes:
    """Draw the instants to which each measurement alone can move at a loss of at most 1 and 5 %.

    Each measurement is a row. A thick bar covers the instants within 1 %, a thin bar those within
    5 %. Hollow bars cover the instants that the draws leave open. A grey line covers all instants
    that were tried: up to the first that is clearly beyond 5 %, or to the last that the job and the
    neighbouring measurements allow.

    Parameters
    ----------
    table : DataFrame or object
        A table with the columns t, moved_to, within_1 and within_5, and name if there are several
        sets. Or an object that has it as ``sampling_windows``, such as a run or the result of
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
    columns = ["t", "sensor"] if "sensor" in rows else ["t"]
    moved = rows.groupby(columns)["moved_to"].agg(["min", "max"]).reset_index()
    times, places = moved["t"].tolist(), range(len(moved))
    names = [formatted_time(measurement_of(row)) for row in moved.to_dict("records")]
    ax = axes_for(ax, _height(len(times)))
    ax.hlines(places, moved["min"], moved["max"], color=GREY, lw=thin(0.6), zorder=1)
    length = _LENGTH * step_of(rows["moved_to"])
    for order, (percent, color, height) in enumerate(_BARS, start=2):
        for place, window in enumerate(windows_of(rows.to_dict("records"), percent)):
            y = (place - height / 2, height)
            sure, left_open = _spans(window.inside, length), _spans(window.open, length)
            ax.broken_barh(sure, y, color=color, lw=0, zorder=order)
            if left_open:
                ax.broken_barh(left_open, y, fc="none", ec=color, lw=thin(0.5), zorder=order)
    ax.plot(times, places, "o", color="black", ms=marker(0.5), zorder=5)
    step = -(-len(times) // _MOST_LABELS)
    ax.set_ylim(max(len(times), 3) - 0.4, -0.6)  # the first measurement on top
    ax.set_yticks(places[::step], names[::step])
    ax.tick_params(axis="y", length=0)
    ax.set_ylabel("measurement at")
    label_times(ax, rows)
    (_, blue, _), (_, red, _) = _BARS
    handles = [
        Patch(fc=red, lw=0, label=f"loss at most {STRICT} %"),
        Patch(fc=blue, lw=0, label=f"at most {WIDE} % (thin)"),
        Patch(fc="white", ec=red, lw=thin(0.5), label="open (hollow)"),
        Line2D([], [], color=GREY, lw=thin(0.6), marker="o", mfc="black", mec="black",
               ms=marker(0.5), label="the set's own; tried up to here"),
    ]  # fmt: skip
    legend_above(ax, handles, columns=2)
    return ax


def _spans(instants: Mapping[Time, int], length: float) -> list[tuple[float, float]]:
    """The left end and the length of a bar over each stretch of successive instants.

    `instants` gives the number of each instant, which on a clock differs from its time.
    """
    return [(run[0] - length / 2, run[-1] - run[0] + length) for run in runs_of(instants)]
