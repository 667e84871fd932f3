"""Pictures of the worth of measurements, and of the expected error over time."""

from collections.abc import Sequence
from itertools import cycle

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from pfdist.pages.figure import Plot, Tables, figure
from pfdist.pages.panel import (
    BAND,
    axes_for,
    cut_outliers,
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
from pfdist.pages.style import GREY, SENSORS
from pfdist.problem.set_key import phrase_of
from pfdist.results.stored_run import criterion_of

_WIDTH = 0.4  # instants over which the stems of several sets at the same instant are spread


@figure("why", applies=lambda run: {"profile", "worth"} <= {*run.tables}, each_set=True)
def why_figure(tables: Tables, name: str) -> Plot:
    """Rise of a set's expected error if a measurement is left out."""
    run = tables.run
    measurements = table_of(run, "run", "worth")
    of_set = measurements[measurements["name"] == name]  # it may measure nothing
    which = phrase_of(run.labels[name])
    form = criterion_of(run)
    change = form.worsens.removesuffix("s")
    title = (
        f"{change.capitalize()} of the {form.label} without each measurement of {which}, with 95 % "
        "intervals."
    )
    if not form.is_mean:
        of_set.attrs |= {"worth": f"{change} of the {form.label} if left out"}
        of_set.attrs |= {"error_unit": ""} if form.unit else {}
    return Plot(2.3, lambda panels: worth(of_set, ax=panels[0]), title=title)


def _mean_error(rows: pd.DataFrame) -> float:
    """The mean over time of an error profile, weighted as the MSE is."""
    error = rows["error"].to_numpy()
    weights = rows["weight"].to_numpy() if "weight" in rows else np.ones(len(rows))
    counts = weights > 0  # an error of weight 0 may be unknown
    return float(np.average(error[counts], weights=weights[counts]))


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
    label_error(ax, table, table.attrs.get("worth", "MSE rise if left out"))
    label_times(ax, table)
    if len(ax.get_legend_handles_labels()[1]) > 1:
        legend_above(ax)
    return ax


def error_profile(profile: object, names: Sequence[str] = (), *, ax: Axes | None = None) -> Axes:
    """Draw the expected error over time with its 95 % band, and the measurement times.

    Parameters
    ----------
    profile : DataFrame or object
        A table with the columns name, t, measured, error and standard_error; or an object whose
        ``profile`` it is, such as the result of `pfdist.why`. The column weight, if there is one,
        weighs the mean in the legend, which also shows the column draws.
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
    table, curves = table_of(profile, "profile", "profile"), []
    sets, ax = rows_with_results(table, names), axes_for(ax)
    if table.empty:
        return write_instead(ax, "there is no table of errors over time")
    for _, rows, style in sets:
        t, error = rows["t"].to_numpy(), rows["error"].to_numpy()
        label = f"{style['label'] or ''}, mean {_mean_error(rows):.4g}".removeprefix(", ")
        half = BAND * rows["standard_error"].to_numpy()
        ax.fill_between(t, error - half, error + half, color=style["color"], alpha=0.2, lw=0)
        ax.plot(
            t, error, markevery=np.flatnonzero(rows["measured"]), ms=marker(0.9), lw=thin(0.9),
            **(style | {"label": label}),
        )  # fmt: skip
        curves.append(points(t, error, style["color"], style["label"] or ""))
    cut_outliers(ax, curves, zero=True)
    label_error(ax, table, "expected error $e(t)$")
    label_times(ax, table)
    draws = int(table["draws"].max()) if "draws" in table else 0
    drawn = f"{draws:,} draws; " if draws else ""
    legend_above(ax, title=f"{drawn}band: 95 % confidence\nmarkers: measured there")
    return ax
