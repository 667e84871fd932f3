"""A filter's estimate of z over time, from real measurements, with 50 and 90 % bands."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import pandas as pd
from matplotlib.axes import Axes

from pfdist.pages.figure import Plot, save_plot
from pfdist.pages.panel import (
    MOST_COMPONENTS,
    axes_for,
    chosen,
    clock_of_table,
    label_quantity,
    label_times,
    legend_above,
    marker,
    name_row,
    stack,
    table_of,
    thin,
    verbatim,
)
from pfdist.pages.style import BLUE, GREEN, GREY, OCHRE, RED
from pfdist.store.schema import SMOOTHED_START, components_in

TITLE = "pfdist: filtered measurements"
"""By which the file of a figure is recognised."""
_BANDS = ((5, 95, 0.22), (25, 75, 0.38))  # percentiles and opacity
_LEVEL, _ROW = 0.035, 0.07  # first row of markers, and distance of two, as shares of the height

_Times = tuple[Sequence[float | str], ...]
"""Measured times, planned times that were not measured, measured times that were not planned, and
planned times after the last measurement. With sensors each is written with its sensor."""

Readings = Mapping[str, Sequence[tuple[float, float]]]
_NONE: Readings = MappingProxyType({})


def filtered_plot(
    table: pd.DataFrame, times: _Times, smoothed: bool = False, readings: Readings = _NONE
) -> Plot:
    """The plot of each component of z: mean, bands, and the times of measurements.

    Parameters
    ----------
    table : DataFrame
        With the columns of `pfdist.store.filtered_schema`.
    times : tuple of four sequences of int, float or str
        Measured times, planned times that were not measured, measured times that were not planned,
        and planned times after the last measurement.
    smoothed : bool
    readings : mapping
        As for `belief`.
    """
    quantities = components_in(table, "mean_")
    number = min(len(quantities), MOST_COMPONENTS)
    last, first = table.iloc[-1], quantities[0]
    mean, low, high = (f"{last[f'{name}_{first.suffix}']:.3g}" for name in ("mean", "q05", "q95"))
    unit = f" {first.unit}" if first.unit else ""

    def draw(panels: Sequence[Axes]) -> None:
        for component, ax in enumerate(panels):
            belief(
                table, component=component, times=times, smoothed=smoothed, readings=readings, ax=ax
            )
        stack(panels, len(quantities))

    title = f"The last estimate of {first.name or 'z'} is {mean}{unit} (90 % band {low} to {high})."
    return Plot(1.3 + 1.45 * number, draw, number, share_x=True, title=title)


def draw_filtered(path: Path, plot: Plot) -> None:
    """Draw the plot of filtered measurements to a PNG file.

    Parameters
    ----------
    path : Path
    plot : Plot
        As of `filtered_plot`.

    Raises
    ------
    StoreError
        The file cannot be written, or a file of another kind has this name.
    """
    save_plot(path, plot, TITLE)


def belief(
    source: object,
    *,
    component: int = 0,
    times: _Times | None = None,
    smoothed: bool | None = None,
    readings: Readings | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the mean of a component of z with its 50 and 90 % bands, and the measurement times.

    Parameters
    ----------
    source : DataFrame or object
        A table of filtered measurements, with the columns of `pfdist.store.filtered_schema`; or an
        object whose ``table`` it is, such as the result of `pfdist.filter_measurements`.
    component : int
        Component of z.
    times : tuple of four sequences of int, float or str, optional
        Measured times, planned times that were not measured, measured times that were not planned,
        and planned times after the last measurement; by default the object's ``measured``,
        ``missing``, ``extra`` and ``to_come``. With sensors, which have a row each, `12 x-ray`.
    smoothed : bool, optional
        Whether the smoothed mean and its 90 % band are drawn, too; by default the object's
        ``is_smoothed``.
    readings : mapping of str to list of (float, float), optional
        Measured times and values of components of z, by their suffixes; by default the object's
        ``readings``.
    ax : matplotlib Axes, optional
        By default those of a new figure.

    Returns
    -------
    matplotlib Axes

    Raises
    ------
    JobError
        There is no such component.
    """
    table = table_of(source, "source", "table")
    at_instants = table["t"][table["measured"].to_numpy(bool)].tolist()
    keys = (("measured", at_instants), ("missing", ()), ("extra", ()), ("to_come", ()))
    measured, missing, extra, to_come = times or (getattr(source, *each) for each in keys)
    quantities = components_in(table, "mean_")
    suffix = quantities[chosen(component, range(len(quantities)), "component")].suffix
    t, ax = table["t"].to_numpy(), axes_for(ax)
    for low, high, alpha in _BANDS:
        below, above = (table[f"q{percent:02d}_{suffix}"].to_numpy() for percent in (low, high))
        ax.fill_between(t, below, above, color=BLUE, alpha=alpha, lw=0)
    ax.plot(t, table[f"mean_{suffix}"].to_numpy(), color=BLUE, label="mean; bands: 50 and 90 %")
    if getattr(source, "is_smoothed", False) if smoothed is None else smoothed:
        mean, below, above = (
            table[f"{SMOOTHED_START}{name}_{suffix}"].to_numpy() for name in ("mean", "q05", "q95")
        )
        ax.fill_between(t, below, above, color=GREEN, alpha=0.3, lw=0)
        ax.plot(t, mean, "--", color=GREEN, label="smoothed; band: 90 %")
    shown = getattr(source, "readings", _NONE) if readings is None else readings
    if points := shown.get(suffix):
        at, values = zip(*points, strict=True)
        ax.plot(at, values, ".", ms=marker(1.2), color="black", label="measured values")
    label_quantity(ax, quantities, component)
    clock = clock_of_table(table)
    sensors = [*clock.by_sensor([*measured, *missing, *to_come])]
    bottom, top = ax.get_ylim()
    ax.set_yticks([tick for tick in ax.get_yticks() if bottom <= tick <= top])
    ax.set_ylim(bottom - (0.01 + _ROW * len(sensors)) * (top - bottom), top)  # room for the markers
    as_planned = " as planned" * bool(missing or extra or to_come)
    levels = {sensor: _LEVEL + _ROW * row for row, sensor in enumerate(reversed(sensors))}
    for each, shape, colour, label in (
        ([at for at in measured if at not in extra], "|", "black", f"measured{as_planned}"),
        (extra, "D", OCHRE, "measured, not planned"),
        (missing, "x", RED, "planned, not measured"),
        (to_come, "o", GREY, "planned, to come"),
    ):
        pairs = [*map(clock.time_and_sensor, each)]
        at, sensors_of = zip(*pairs, strict=True) if pairs else ((), ())
        if at:
            ax.plot(
                at, [levels[sensor] for sensor in sensors_of], shape, ms=marker(1.2),
                mew=thin(0.9), color=colour, mfc="white", transform=ax.get_xaxis_transform(),
                label=label, clip_on=False,
            )  # fmt: skip
    for sensor, level in levels.items():
        name_row(ax, level, verbatim(sensor), share=True)
    label_times(ax, table)
    legend_above(ax)
    return ax
