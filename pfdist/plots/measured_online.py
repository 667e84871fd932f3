"""When draws are measured whose times are chosen one after another: a raster, and shares."""

from collections.abc import Collection, Sequence
from functools import partial

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from numpy.typing import NDArray

from pfdist.analysis import Run
from pfdist.analysis.online import OnlineDraws, online_draws
from pfdist.common.arguments import whole_argument
from pfdist.plots.figure import Plot, Tables, figure, has_online
from pfdist.plots.panel import (
    axes_for,
    check_kind,
    label_instants,
    legend_above,
    marker,
    stack,
    verbatim,
)
from pfdist.plots.style import BLUE, RED
from pfdist.times.clock import Clock
from pfdist.times.measurement_times import Times

_MOST_INSTANTS = 32_001
MOST_ROWS = 200  # draws in the raster: more could not be told apart
Source = Run | OnlineDraws | pd.DataFrame


@figure("online_times", applies=has_online)
def online_times_figure(tables: Tables) -> Plot:
    """Share of the draws that online times measure at each instant, and a raster of the times."""
    draws = tables.online
    differ = 100 * float(np.mean(draws.differ)) if len(draws.rows) else 0.0
    title = f"In {differ:.0f} % of the draws, online times differ from the plan, {draws.plan}."
    return Plot(4.2, partial(_draw, draws), panels=2, share_x=True, title=title)


def _draw(draws: OnlineDraws, panels: Sequence[Axes]) -> None:
    above, below = panels
    online_shares(draws, ax=above)
    online_raster(draws, ax=below)
    stack(panels)


def measured_at(times: Collection[Sequence[int]], horizon: int) -> NDArray[np.bool_]:
    """Say whether each draw is measured at each instant, (D, T+1)."""
    measured = np.zeros((len(times), horizon + 1), np.bool_)
    for row, chosen in zip(measured, times, strict=True):
        row[np.asarray(chosen, np.int64)] = True
    return measured


def online_shares(
    source: Source,
    *,
    planned: Times = (),
    plan: str = "",
    horizon: int | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the share of draws that are measured at each instant, beside the planned times.

    Parameters
    ----------
    source : Run, OnlineDraws or DataFrame
        A run with online times; or its draws that have them; or a table with a row for each draw
        and the column measurement_times, as `pfdist.analysis.Run.online`.
    planned : tuple of int
        The times of the plan; a run has them.
    plan : str
        Name of the plan; a run has one.
    horizon : int, optional
        The last instant T of a table, whose times must count instants; otherwise the last
        measurement time. A table has no clock; a run and its draws have one.
    ax : matplotlib Axes, optional
        By default those of a new figure.

    Returns
    -------
    matplotlib Axes
    """
    measured, clock, planned, plan = _measured(source, planned, plan, horizon)
    share, ax = 100 * measured.mean(axis=0), axes_for(ax)
    label, step = f"online, {len(measured):,} draws", _least_step(clock)
    ax.bar(clock.times, share, 0.8 * step, color=BLUE, alpha=0.75, lw=0, label=label)
    _mark(ax, planned, f"the plan, {verbatim(plan)}" if plan else "the plan")
    ax.set_ylim(0, 108)
    ax.set_yticks([0, 50, 100])
    ax.set_xlim(clock.times[0] - 0.75 * step, clock.times[-1] + 0.75 * step)
    ax.set_ylabel("draws measured [%]")
    label_instants(ax, clock.unit, whole=clock.counts)
    legend_above(ax)
    return ax


def online_raster(
    source: Source,
    *,
    planned: Times = (),
    horizon: int | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw a row for each draw, dark where it is measured; draws with like times are neighbours.

    Parameters
    ----------
    source : Run, OnlineDraws or DataFrame
        As of `online_shares`; the first 200 draws are shown.
    planned : tuple of int
        The times of the plan, marked above the rows; a run has them.
    horizon : int, optional
        As of `online_shares`.
    ax : matplotlib Axes, optional
        By default those of a new figure.

    Returns
    -------
    matplotlib Axes
    """
    measured, clock, planned, _ = _measured(source, planned, "", horizon)
    measured, ax = measured[:MOST_ROWS], axes_for(ax)
    rows, step = len(measured), _least_step(clock)
    in_order = measured[np.lexsort(~measured.T[::-1])]  # early measurements come first
    first, last = clock.times[0] - step / 2, clock.times[-1] + step / 2
    if clock.is_even:
        shown = in_order
    else:  # each instant in the columns of least width that lie nearest to it
        columns = np.arange(first + step / 2, last, step)
        nearest = np.abs(np.subtract.outer(np.array(clock.times), columns)).argmin(axis=1)
        shown = np.zeros((rows, len(columns)), np.bool_)
        shown[:, nearest] = in_order
    ax.imshow(
        shown, aspect="auto", interpolation="nearest", cmap=ListedColormap(["#ffffff00", BLUE]),
        vmin=0, vmax=1, extent=(first, last, rows + 0.5, 0.5),
    )  # fmt: skip
    _mark(ax, planned, "")
    ax.set_xlim(first - step / 4, last + step / 4)
    ax.set_ylabel(f"{rows:,} draws, sorted by times")
    ax.set_yticks([])
    label_instants(ax, clock.unit, whole=clock.counts)
    return ax


def _least_step(clock: Clock) -> float:
    return float(np.diff(clock.times).min()) if clock.horizon else 1.0


def _measured(
    source: Source, planned: Times, plan: str, horizon: int | None
) -> tuple[NDArray[np.bool_], Clock, Times, str]:
    """Whether each draw is measured at each instant, the clock, the plan's times and its name."""
    check_kind(source, (Run, OnlineDraws, pd.DataFrame), "source")
    clock: Clock | None = None
    if isinstance(source, Run):
        source = online_draws(source)
    if isinstance(source, OnlineDraws):
        clock = source.clock
        planned, plan, source = planned or source.planned_times, plan or source.plan, source.rows
    times = list(source["measurement_times"])
    if clock is None:
        last = int(max((t for chosen in [*times, planned] for t in chosen), default=0))
        horizon = last if horizon is None else horizon
        clock = Clock.counting(whole_argument("horizon", horizon, last, _MOST_INSTANTS))
    instants = [clock.instants(chosen) for chosen in times]
    return measured_at(instants, clock.horizon), clock, planned, plan


def _mark(ax: Axes, planned: Times, label: str) -> None:
    """Mark the planned times at the upper edge, with a label in the legend if it is not empty."""
    if not len(planned):
        return
    ax.plot(
        list(planned), [1.0] * len(planned), "v", transform=ax.get_xaxis_transform(), clip_on=False,
        color=RED, ms=marker(1.2), mew=0, label=label or None, zorder=5,
    )  # fmt: skip
