"""One draw: the truth, both filters' estimates and their measurement times (paper, figure 3)."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from pfdist.plots.style import BLUE, RED

MOST_COMPONENTS = 6  # of z that are shown, a panel each


def typical_draw(gains: "pd.Series[float]") -> int:
    """Give the draw, of those in the index, of median relative gain (the lower of two medians)."""
    return int(gains.sort_values(kind="stable").index[(len(gains) - 1) // 2])


def components(trajectory: pd.DataFrame) -> int:
    """Give how many components z has."""
    return sum(column.startswith("z_") for column in trajectory.columns)


def plot_one_draw(
    panels: Sequence[Axes],
    trajectory: pd.DataFrame,
    times: Mapping[str, Sequence[int]],
    gain: float,
) -> None:
    """Draw every component of z and two estimates of it, a panel each.

    Parameters
    ----------
    panels : sequence of matplotlib Axes
        From above to below; if z has more components than there are panels, the first are shown.
    trajectory : DataFrame
        Rows of the table ``trajectories`` of one draw.
    times : mapping of str to sequence of int
        Measurement times of two sets by name, the reference first.
    gain : float
        Relative gain of the draw.
    """
    number = components(trajectory)
    for component, axes in enumerate(panels):
        _plot_component(axes, trajectory, times, component)
        axes.set_ylabel("$z$" if number == 1 else f"$z_{{{component}}}$")
    left_out = f"; {number - len(panels)} more components of $z$" if number > len(panels) else ""
    above, below = panels[0], panels[-1]
    for axes in panels[:-1]:
        axes.tick_params(labelbottom=False)
    below.set_xlabel("$t$")
    above.set_title(f"relative gain of this draw, the median: {100 * gain:.1f} %{left_out}", pad=30)
    above.legend(ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0), columnspacing=1.2)


def _plot_component(
    axes: Axes, trajectory: pd.DataFrame, times: Mapping[str, Sequence[int]], component: int
) -> None:
    t, z = trajectory["t"].to_numpy(), trajectory[f"z_{component}"].to_numpy()
    axes.plot(t, z, color="black", lw=1.0, label="$z(t)$")
    reference, found = times
    styles = ((reference, BLUE, "+", (0, (4, 2))), (found, RED, "*", "-"))
    estimates = [trajectory[f"estimate_{name}_{component}"].to_numpy() for name in times]
    everything = np.concatenate([z, *estimates])
    low, high = np.nanmin(everything), np.nanmax(everything)
    for row, ((name, colour, marker, dashes), estimate) in enumerate(
        zip(styles, estimates, strict=True), start=1
    ):
        axes.plot(t, estimate, color=colour, ls=dashes, lw=0.9, label=rf"$\hat{{z}}(t)$, {name}")
        at = np.asarray(times[name])
        level = low - (high - low) * (0.06 + 0.07 * row)  # below the curves, a line a set
        label = rf"$\mathcal{{M}}$, {name}"
        axes.plot(at, np.full(at.size, level), marker, color=colour, ms=4, mew=0.8, label=label)
