"""When draws are measured whose times are chosen one after another: a raster, and shares."""

from collections.abc import Collection, Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from pfdist.analysis.online import OnlineDraws
from pfdist.plots.figure import Plot, Tables, figure, has_online
from pfdist.plots.style import BLUE, RED
from pfdist.times.measurement_times import Times

MOST_ROWS = 200  # draws in the raster: more could not be told apart


@figure("online_times", applies=has_online)
def online_times_figure(tables: Tables) -> Plot:
    """Share of the draws that online times measure at each instant, and a raster of the times."""
    draws, horizon = tables.online, tables.run.job["problem"]["horizon"]
    return Plot(4.2, partial(_draw, draws, horizon), panels=2, share_x=True)


def _draw(draws: OnlineDraws, horizon: int, panels: Sequence[Axes]) -> None:
    above, below = panels
    measured = measured_at(list(draws.rows["measurement_times"]), horizon)
    plot_shares(above, measured, draws.planned_times, draws.plan)
    plot_raster(below, measured[:MOST_ROWS], draws.planned_times)
    below.set_xlabel("$t$")
    below.xaxis.set_major_locator(MaxNLocator(integer=True))
    below.set_xlim(-0.75, horizon + 0.75)


def measured_at(times: Collection[Sequence[int]], horizon: int) -> NDArray[np.bool_]:
    """Say whether each draw is measured at each instant, (D, T+1)."""
    measured = np.zeros((len(times), horizon + 1), np.bool_)
    for row, chosen in zip(measured, times, strict=True):
        row[np.asarray(chosen, np.int64)] = True
    return measured


def plot_shares(axes: Axes, measured: NDArray[np.bool_], planned: Times, plan: str) -> None:
    """Draw the share of draws that are measured at each instant, and mark the planned times.

    Parameters
    ----------
    axes : matplotlib Axes
    measured : array of bool, (D, T+1)
    planned : tuple of int
        The times of the plan.
    plan : str
        Name of the plan.
    """
    share = 100 * measured.mean(axis=0)
    label = f"online, {len(measured):,} draws"
    axes.bar(np.arange(share.size), share, 0.8, color=BLUE, alpha=0.75, lw=0, label=label)
    _mark(axes, planned, plan)
    axes.set_ylim(0, 108)
    axes.set_yticks([0, 50, 100])
    axes.set_ylabel("draws measured [%]")
    axes.tick_params(labelbottom=False)
    axes.legend(ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0), borderaxespad=0.2)


def plot_raster(axes: Axes, measured: NDArray[np.bool_], planned: Times) -> None:
    """Draw a row for each draw, dark where it is measured; draws with like times are neighbours.

    Parameters
    ----------
    axes : matplotlib Axes
    measured : array of bool, (D, T+1)
    planned : tuple of int
        The times of the plan, marked above the rows.
    """
    rows, instants = measured.shape
    in_order = measured[np.lexsort(~measured.T[::-1])]  # early measurements come first
    axes.imshow(
        in_order, aspect="auto", interpolation="nearest", cmap=ListedColormap(["white", BLUE]),
        vmin=0, vmax=1, extent=(-0.5, instants - 0.5, rows + 0.5, 0.5),
    )  # fmt: skip
    _mark(axes, planned, "")
    axes.set_ylabel(f"{rows:,} draws, sorted by times")
    axes.set_yticks([])


def _mark(axes: Axes, planned: Times, plan: str) -> None:
    """Mark the planned times at the upper edge, with the label of the plan if it has one."""
    label = f"the plan, {plan}" if plan else None
    at, edge = np.asarray(planned), axes.get_xaxis_transform()
    axes.plot(
        at, np.full(at.size, 1.0), "v", transform=edge, clip_on=False, color=RED, ms=3.5, mew=0,
        label=label, zorder=5,
    )  # fmt: skip
