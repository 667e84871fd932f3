"""Online times: when draws are measured."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from numpy.typing import NDArray

from pfdist.pages.figure import Plot, Tables, figure
from pfdist.pages.panel import (
    axes_for,
    check_kind,
    label_instants,
    legend_above,
    marker,
    step_of,
    styles_of,
    verbatim,
)
from pfdist.plugins.online.draws import OnlineDraws, online_draws
from pfdist.problem.clock import Clock
from pfdist.problem.points import Points
from pfdist.problem.set_key import phrase_of
from pfdist.results import Run

MOST_ROWS = 200  # draws in the raster: nobody could distinguish more


@figure("online_times", applies=lambda run: "online" in run.tables)
def online_times_figure(tables: Tables) -> Plot:
    """Share of the draws that online times measure at each instant, and the planned times."""
    draws = online_draws(tables.run)
    differ = 100 * float(np.mean(draws.differ)) if len(draws.rows) else 0.0
    plan = phrase_of(tables.run.labels[draws.plan])
    title = f"In {differ:.0f} % of the draws, online times differ from {plan}."
    return Plot(2.3, lambda panels: online_shares(draws, ax=panels[0]), title=title)


def online_shares(source: Run | OnlineDraws, *, ax: Axes | None = None) -> Axes:
    """Draw the share of draws that are measured at each instant; triangles mark the planned times.

    Parameters
    ----------
    source : Run or OnlineDraws
        A run with online times, or its draws that have them.
    ax : matplotlib Axes, optional
        By default those of a new figure.

    Returns
    -------
    matplotlib Axes
    """
    draws, measured, clock = _measured(source)
    shares, ax = 100 * measured.mean(axis=0), axes_for(ax)
    step, text = step_of(clock.times), f"online, {len(measured):,} draws"
    colour, number = _styles(draws)["online"]["color"], draws.points.ways
    shades = [to_rgba(colour, alpha) for alpha in np.linspace(0.9, 0.4, number)]  # of sensors
    for share, (sensor, beside), shade in zip(shares.T, _beside(draws.points), shades, strict=True):
        ax.bar(
            np.add(clock.times, beside), share, 0.8 * step / len(shades), color=shade, lw=0,
            label=f"{text}, {verbatim(sensor)}" if sensor else text,
        )  # fmt: skip
    _mark(ax, draws, _styles(draws)[draws.plan]["label"])
    ax.set_ylim(0, 108)
    ax.set_yticks([0, 50, 100])
    ax.set_xlim(clock.times[0] - 0.75 * step, clock.times[-1] + 0.75 * step)
    ax.set_ylabel("draws measured [%]")
    label_instants(ax, clock)
    legend_above(ax)
    return ax


def _measured(source: Run | OnlineDraws) -> tuple[OnlineDraws, NDArray[np.bool_], Clock]:
    """The draws, whether each sensor measures each of them at each instant, and the clock."""
    check_kind(source, (Run, OnlineDraws), "source")
    draws = online_draws(source) if isinstance(source, Run) else source
    points, times = draws.points, draws.rows["measurement_times"]
    measured = np.zeros((len(times), points.number), np.bool_)
    for row, at in zip(measured, times, strict=True):
        row[[*points.read(at)]] = True
    return draws, measured.reshape(len(times), -1, points.ways), points.clock


def _beside(points: Points) -> list[tuple[str, float]]:
    """Each sensor, and how far beside an instant it is drawn; a nameless one without sensors."""
    sensors, step = points.sensors or ("",), step_of(points.clock.times)
    middles = (np.arange(len(sensors)) + 0.5) / len(sensors) - 0.5
    return list(zip(sensors, (step * middles).tolist(), strict=True))


def _styles(draws: OnlineDraws) -> dict[str, dict[str, Any]]:
    return styles_of(draws.rows, [draws.reference, draws.plan, "online"])


def _mark(ax: Axes, draws: OnlineDraws, label: str) -> None:
    """Mark the planned times at the upper edge, with a label in the legend."""
    planned = draws.points.clock.by_sensor(draws.planned_times)
    times = [t + beside for name, beside in _beside(draws.points) for t in planned.get(name, [])]
    ax.plot(
        times, [1.0] * len(times), "v", transform=ax.get_xaxis_transform(), clip_on=False,
        color=_styles(draws)[draws.plan]["color"], ms=marker(1.2), mew=0, label=label, zorder=5,
    )  # fmt: skip
