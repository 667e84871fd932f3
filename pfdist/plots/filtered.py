"""A filter's belief of z over time, by real measurements, with 50 and 90 % bands."""

from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from pfdist.plots.figure import Plot
from pfdist.plots.figures import save_plot
from pfdist.plots.style import BLUE, GREY, ORANGE, RED
from pfdist.store.replaceable import check_replaceable

MOST_COMPONENTS = 6  # components of z that are shown, each in a panel
_TITLE = "pfdist: filtered measurements"
_START = 4096  # bytes of a file in which its title stands
_BANDS = ((5, 95, 0.22, "90 %"), (25, 75, 0.38, "50 %"))
_LEVEL = 0.035  # of the markers of times, over the height of a panel


def draw_filtered(
    path: Path,
    table: pd.DataFrame,
    missing: Sequence[int] = (),
    extra: Sequence[int] = (),
    to_come: Sequence[int] = (),
) -> None:
    """Draw mean and bands of each component of z, and the times of measurements, to a PNG file.

    Parameters
    ----------
    path : Path
    table : DataFrame
        With the columns of `pfdist.store.filtered_schema`.
    missing, extra, to_come : sequence of int
        Planned times that were not measured, measured times that were not planned, and planned
        times after the last measurement.

    Raises
    ------
    StoreError
        The file cannot be written, or another file has this name.
    """
    check_figure_replaceable(path)
    number = sum(name.startswith("mean_") for name in table.columns)
    panels = min(number, MOST_COMPONENTS)
    draw = partial(_draw, table, number, (missing, extra, to_come))
    save_plot(path, Plot(1.3 + 1.45 * panels, draw, panels, share_x=True), _TITLE)


def check_figure_replaceable(path: Path) -> None:
    """Raise an error unless a file is missing, or is an earlier figure of this kind.

    Raises
    ------
    StoreError
    """
    check_replaceable(path, _is_earlier)


def _is_earlier(path: Path) -> bool:
    with path.open("rb") as file:
        return _TITLE.encode() in file.read(_START)


def _draw(
    table: pd.DataFrame,
    number: int,
    times: tuple[Sequence[int], Sequence[int], Sequence[int]],
    panels: Sequence[Axes],
) -> None:
    missing, extra, to_come = times
    measured = table["t"].to_numpy()[table["measured"].to_numpy(bool)]
    for component, axes in enumerate(panels):
        plot_component(axes, table, component)
        axes.set_ylabel("$z$" if number == 1 else f"$z_{{{component}}}$")
        low, high = axes.get_ylim()
        axes.set_ylim(low - 0.08 * (high - low), high)  # room for the markers
        planned = sorted(set(measured) - set(extra))
        mark_times(axes, planned, "|", "black", "measured as planned")
        mark_times(axes, extra, "D", ORANGE, "measured, not planned")
        mark_times(axes, missing, "x", RED, "planned, not measured")
        mark_times(axes, to_come, "o", GREY, "planned, to come")
    below = panels[-1]
    left_out = f"; {number - len(panels)} more components are left out" * (number > len(panels))
    below.set_xlabel(f"$t${left_out}")
    below.xaxis.set_major_locator(MaxNLocator(integer=True))
    panels[0].legend(ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0), borderaxespad=0.2)


def plot_component(axes: Axes, table: pd.DataFrame, component: int) -> None:
    """Draw the mean of a component of z, and its 50 and 90 % bands.

    Parameters
    ----------
    axes : matplotlib Axes
    table : DataFrame
        With the columns of `pfdist.store.filtered_schema`.
    component : int
    """
    t = table["t"].to_numpy()
    for low, high, alpha, label in _BANDS:
        below, above = (table[f"q{percent:02d}_{component}"].to_numpy() for percent in (low, high))
        axes.fill_between(t, below, above, color=BLUE, alpha=alpha, lw=0, label=f"{label} band")
    axes.plot(t, table[f"mean_{component}"].to_numpy(), color=BLUE, lw=1.0, label="mean")


def mark_times(axes: Axes, times: Iterable[int], marker: str, color: str, label: str) -> None:
    """Mark some times at the lower edge of a panel; no times have no entry in the legend.

    Parameters
    ----------
    axes : matplotlib Axes
    times : iterable of int
    marker, color, label : str
    """
    at = np.array(list(times))
    if at.size:
        axes.plot(
            at, np.full(at.size, _LEVEL), marker, ms=3.5, mew=0.9, color=color, mfc="white",
            transform=axes.get_xaxis_transform(), label=label, clip_on=False,
        )  # fmt: skip
