"""One draw: the truth, both filters' estimates and their measurement times (paper, figure 3)."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from pfdist.analysis import Run
from pfdist.analysis.reference import label
from pfdist.errors import JobError
from pfdist.plots.figure import Plot, Tables, figure, one_number
from pfdist.plots.panel import (
    axes_for,
    check_kind,
    chosen,
    label_quantity,
    label_times,
    legend_above,
    marker,
    minus,
    stack,
    thin,
    verbatim,
    write_instead,
)
from pfdist.plots.style import BLUE, RED
from pfdist.store.schema import components_in

MOST_COMPONENTS = 6  # components of z that are shown, each in a panel
_LONGEST_NAMES = {3: 12, 2: 20}
"""Characters of a name with which the legend has room for so many columns."""
_ENTRIES = 5  # of the legend
_LINE_INCHES = 0.15  # height of a line of the legend
_SHAPES = ((BLUE, "+", (0, (4, 2))), (RED, "*", "-"))
Sets = Mapping[str, Sequence[int]]


@figure("draw", applies=one_number, each_set=True)
def draw_figure(tables: Tables, name: str) -> Plot:
    """Truth, estimates and times of the draw with the median gain (the paper's figure 3)."""
    gains = tables.gains_of_trajectories[f"gain_{name}"].dropna()
    reference = tables.run.names[0]
    if gains.empty:
        return no_draw()
    draw, sets = typical_draw(gains), tables.run.sets()
    trajectory = tables.trajectories[tables.trajectories["draw"] == draw]
    title = title_of(float(gains[draw]), f"the times of {name}", label(reference))
    told = f"{_told(draw, gains[draw])}, the median"
    return plot_of(trajectory, {key: sets[key] for key in (reference, name)}, told, title)


def no_draw() -> Plot:
    """Say that there is no draw to show."""
    told = "no draw with a trajectory has a gain"
    title = f"{told[0].upper()}{told[1:]}."
    return Plot(2.6, lambda panels: write_instead(panels[0], told), title=title)


def title_of(gain: float, found: str, reference: str) -> str:
    """Say how much the errors of two sets differ in the draw of median gain."""
    less = "less" if gain >= 0 else "more"
    return (
        f"In the draw with the median gain, {found} err {100 * abs(gain):.1f} % {less} "
        f"than {reference}."
    )


def _told(draw: int, gain: float) -> str:
    return minus(f"draw {draw}, relative gain {100 * gain:.1f} %")


def plot_of(trajectory: pd.DataFrame, sets: Sets, told: str, title: str) -> Plot:
    """Give the plot of a draw with a panel for each of the first components of z.

    Parameters
    ----------
    trajectory : DataFrame
        Rows of one draw in the table ``trajectories``.
    sets : mapping of str to sequence of int
        Measurement times of two sets by their names, the reference first.
    told : str
        Title of the legend.
    title : str
        Title of the plot.
    """
    number = len(components_in(trajectory, "z_"))
    shown = min(number, MOST_COMPONENTS)

    def draw(panels: Sequence[Axes]) -> None:
        for component, ax in enumerate(panels):
            one_draw(trajectory, sets, title=told, component=component, ax=ax)
        stack(panels)
        if number > len(panels):
            panels[-1].set_xlabel(f"$t$; {number - len(panels)} more components are left out")

    lines = -(-_ENTRIES // _columns(sets))
    return Plot(0.5 + _LINE_INCHES * lines + 1.5 * shown, draw, shown, title=title)


def _columns(sets: Sets) -> int:
    """Number of columns of the legend."""
    longest = max(map(len, sets), default=0)
    return next((count for count, most in _LONGEST_NAMES.items() if longest <= most), 1)


def typical_draw(gains: "pd.Series[float]") -> int:
    """Give the draw with the median relative gain; of two medians, the lower.

    Parameters
    ----------
    gains : Series
        Relative gains; the index holds the draws.
    """
    return int(gains.sort_values(kind="stable").index[(len(gains) - 1) // 2])


def one_draw(
    trajectory: Run | pd.DataFrame,
    sets: str | Sets = "",
    *,
    draw: int | None = None,
    component: int = 0,
    title: str = "",
    ax: Axes | None = None,
) -> Axes:
    """Draw a component of z over time with the estimates of two sets, and both sets' times.

    Parameters
    ----------
    trajectory : Run or DataFrame
        A run, or rows of its table ``trajectories``.
    sets : str, or mapping of str to sequence of int
        With a run, the set beside the reference; by default the first that was found. With a
        DataFrame, measurement times of two sets by their names, the reference first.
    draw : int, optional
        One of the draws that have trajectories. By default the draw of a run with the median gain,
        or the first draw of a DataFrame.
    component : int
        Component of z.
    title : str
        Title of the legend; a run tells the draw and the relative gain.
    ax : matplotlib Axes, optional
        By default those of a new figure.

    Returns
    -------
    matplotlib Axes

    Raises
    ------
    JobError
        There is no such set, draw or component.
    TypeError
        The trajectory is neither a run nor a table.
    """
    check_kind(trajectory, (Run, pd.DataFrame), "trajectory")
    if isinstance(trajectory, Run):
        trajectory, sets, draw, told = _of_run(trajectory, sets, draw)
        title = title or told
    elif isinstance(sets, str):
        raise JobError(f"sets must be times by name, got {sets!r}", argument="sets")
    if "draw" in trajectory:
        draws = trajectory["draw"].unique().tolist()
        draw = draws[0] if draw is None else chosen(draw, draws, "draw")
        trajectory = trajectory[trajectory["draw"] == draw]
    quantities = components_in(trajectory, "z_")
    chosen(component, range(len(quantities)), "component")
    ax = axes_for(ax)
    _plot(ax, trajectory.sort_values("t"), sets, quantities[component].suffix)
    label_quantity(ax, quantities, component)
    label_times(ax, trajectory)
    legend_above(ax, columns=_columns(sets), title=title)
    return ax


def _of_run(run: Run, name: str | Sets, draw: int | None) -> tuple[pd.DataFrame, Sets, int, str]:
    """Trajectories of a run, two of its sets, the draw to show and what to tell of it."""
    reference, *found = run.names
    name = chosen(str(name or found[0]), found, "sets")
    trajectories, sets = run.trajectories(), run.sets()
    known = int(trajectories["draw"].max()) + 1
    gains = run.gains(draws=known).set_index("draw")[f"gain_{name}"]
    gains = gains[gains.index.isin(trajectories["draw"])]
    if draw is None:
        usable = gains.dropna()
        draw = typical_draw(usable) if len(usable) else int(trajectories["draw"].min())
    chosen(draw, gains.index.tolist(), "draw")
    shown = {key: sets[key] for key in (reference, name)}
    return trajectories, shown, draw, _told(draw, gains[draw])


def _plot(ax: Axes, trajectory: pd.DataFrame, sets: Sets, suffix: str) -> None:
    t, z = trajectory["t"].to_numpy(), trajectory[f"z_{suffix}"].to_numpy()
    ax.plot(t, z, color="black", label="$z(t)$")
    estimates = [trajectory[f"estimate_{name}_{suffix}"].to_numpy() for name in sets]
    everything = np.concatenate([z, *estimates])
    low, high = np.nanmin(everything), np.nanmax(everything)
    for row, ((name, times), estimate, (colour, shape, dashes)) in enumerate(
        zip(sets.items(), estimates, _SHAPES, strict=True), start=1
    ):
        shown = verbatim(name)
        ax.plot(
            t, estimate, color=colour, ls=dashes, lw=thin(0.9), label=rf"$\hat{{z}}(t)$, {shown}"
        )
        level = low - (high - low) * (0.06 + 0.07 * row)  # below the curves
        told = rf"$\mathcal{{M}}$, {shown}"
        at = np.asarray(times)
        ax.plot(
            at, np.full(at.size, level), shape, color=colour, ms=marker(1.2), mew=thin(), label=told
        )
