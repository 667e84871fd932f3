"""One draw: the truth, both filters' estimates and their measurement times (paper, figure 3)."""

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from pfdist.analysis import Run
from pfdist.plots.figure import Plot, Tables, figure, one_number, write_instead
from pfdist.plots.style import BLUE, RED

MOST_COMPONENTS = 6  # components of z that are shown, each in a panel


@figure("draw", applies=one_number, each_set=True)
def draw_figure(tables: Tables, name: str) -> Plot:
    """Truth, estimates and times of the draw with the median gain (the paper's figure 3)."""
    gains = tables.gains_of_trajectories[f"gain_{name}"].dropna()
    if gains.empty:
        told = "no draw with a trajectory has a gain"
        return Plot(2.6, lambda panels: write_instead(panels[0], told))
    draw = partial(_draw, tables.run, tables.trajectories, gains, name)
    panels = min(components(tables.trajectories), MOST_COMPONENTS)
    return Plot(1.2 + 1.4 * panels, draw, panels)


def _draw(
    run: Run,
    trajectories: pd.DataFrame,
    gains: "pd.Series[float]",
    name: str,
    panels: Sequence[Axes],
) -> None:
    draw = typical_draw(gains)
    times = run.compared().set_index("name")["measurement_times"]
    chosen = {key: times[key].tolist() for key in (run.names[0], name)}
    rows = trajectories[trajectories["draw"] == draw]
    plot_one_draw(panels, rows, chosen, float(gains[draw]))


def typical_draw(gains: "pd.Series[float]") -> int:
    """Give the draw with the median relative gain; of two medians, the lower.

    Parameters
    ----------
    gains : Series
        Relative gains; the index holds the draws.
    """
    return int(gains.sort_values(kind="stable").index[(len(gains) - 1) // 2])


def components(trajectory: pd.DataFrame) -> int:
    """Give the number of components of z."""
    return sum(column.startswith("z_") for column in trajectory.columns)


def plot_one_draw(
    panels: Sequence[Axes],
    trajectory: pd.DataFrame,
    times: Mapping[str, Sequence[int]],
    gain: float,
    over: str = "",
) -> None:
    """Draw each component of z with two estimates, each component in a panel.

    Parameters
    ----------
    panels : sequence of matplotlib Axes
        From above to below; if there are fewer panels than components, the last are left out.
    trajectory : DataFrame
        Rows of one draw in the table ``trajectories``.
    times : mapping of str to sequence of int
        Measurement times of two sets by their names, the reference first.
    gain : float
        Relative gain of the draw.
    over : str
        Says over which set, if that is not plain.
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
    below.xaxis.set_major_locator(MaxNLocator(integer=True))
    told = f"relative gain{over} of this draw, the median: {100 * gain:.1f} %{left_out}"
    above.set_title(told, pad=30)
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
        level = low - (high - low) * (0.06 + 0.07 * row)  # below the curves
        label = rf"$\mathcal{{M}}$, {name}"
        axes.plot(at, np.full(at.size, level), marker, color=colour, ms=4, mew=0.8, label=label)
