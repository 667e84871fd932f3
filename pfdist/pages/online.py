"""Online times: when draws are measured, their gains, and one draw."""

from collections.abc import Collection, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap, to_rgba
from matplotlib.typing import RGBAColorType
from numpy.typing import NDArray

from pfdist.pages.figure import Plot, Tables, figure, has_online
from pfdist.pages.gains import (
    gain,
    legend_of_draw,
    median_draw,
    no_draw,
    plot_of_draw,
    title_of_draw,
    title_of_gain,
)
from pfdist.pages.panel import (
    axes_for,
    check_kind,
    label_instants,
    legend_above,
    marker,
    stack,
    step_of,
    styles_of,
    verbatim,
)
from pfdist.problem.clock import Clock
from pfdist.problem.points import Points
from pfdist.problem.set_key import phrase_of
from pfdist.results import Run, relative_gain
from pfdist.results.online import OnlineDraws, online_draws
from pfdist.store.schema import components_in

MOST_ROWS = 200  # draws in the raster: nobody could distinguish more


@figure("online_times", applies=has_online)
def online_times_figure(tables: Tables) -> Plot:
    """Share of the draws that online times measure at each instant, and a raster of the times."""
    draws = tables.online
    differ = 100 * float(np.mean(draws.differ)) if len(draws.rows) else 0.0
    plan = phrase_of(tables.run.labels[draws.plan])
    title = f"In {differ:.0f} % of the draws, online times differ from {plan}."

    def draw(panels: Sequence[Axes]) -> None:
        online_shares(draws, ax=panels[0])
        online_raster(draws, ax=panels[1])
        stack(panels)

    return Plot(4.2, draw, panels=2, share_x=True, title=title)


def measured_marks(times: Collection[Sequence[int]], horizon: int) -> NDArray[np.bool_]:
    """Whether each draw is measured at each instant, (D, T+1)."""
    measured = np.zeros((len(times), horizon + 1), np.bool_)
    for row, instants in zip(measured, times, strict=True):
        row[np.asarray(instants, np.int64)] = True
    return measured


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
    step, shades, text = step_of(clock.times), _shades(draws), f"online, {len(measured):,} draws"
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


def online_raster(source: Run | OnlineDraws, *, ax: Axes | None = None) -> Axes:
    """Draw a row for each draw, dark where it is measured; draws with similar times are neighbours.

    Triangles above the rows mark the planned times.

    Parameters
    ----------
    source : Run or OnlineDraws
        As of `online_shares`; the first 200 draws are shown.
    ax : matplotlib Axes, optional
        By default those of a new figure.

    Returns
    -------
    matplotlib Axes
    """
    draws, measured, clock = _measured(source)
    measured, ax = measured[:MOST_ROWS], axes_for(ax)
    rows, step = len(measured), step_of(clock.times)
    in_order = measured[
        np.lexsort(~measured.reshape(rows, -1).T[::-1])
    ]  # early measurements come first
    first, last = clock.times[0] - step / 2, clock.times[-1] + step / 2
    if clock.is_even:
        shown = in_order
    else:  # each instant in the columns of least width that lie nearest to it
        columns = np.arange(first + step / 2, last, step)
        nearest = np.abs(np.subtract.outer(np.array(clock.times), columns)).argmin(axis=1)
        shown = np.zeros((rows, len(columns), measured.shape[-1]), np.bool_)
        shown[:, nearest] = in_order
    kinds = np.arange(1, shown.shape[-1] + 1)  # in each instant a column for each sensor
    ax.imshow(
        (shown * kinds).reshape(rows, -1), aspect="auto", interpolation="nearest",
        cmap=ListedColormap(["#ffffff00", *_shades(draws)]), vmin=0, vmax=kinds[-1],
        extent=(first, last, rows + 0.5, 0.5),
    )  # fmt: skip
    _mark(ax, draws)
    ax.set_xlim(first - step / 4, last + step / 4)
    ax.set_ylabel(f"{rows:,} draws, sorted by times")
    ax.set_yticks([])
    label_instants(ax, clock)
    return ax


def _measured(source: Run | OnlineDraws) -> tuple[OnlineDraws, NDArray[np.bool_], Clock]:
    """The draws, whether each sensor measures each of them at each instant, and the clock."""
    draws = _draws_of(source)
    points, times = draws.points, draws.rows["measurement_times"]
    measured = measured_marks([points.read(t) for t in times], points.number - 1)
    return draws, measured.reshape(len(times), -1, points.ways), points.clock


def _beside(points: Points) -> list[tuple[str, float]]:
    """Each sensor, and how far beside an instant it is drawn; a nameless one without sensors."""
    sensors, step = points.sensors or ("",), step_of(points.clock.times)
    middles = (np.arange(len(sensors)) + 0.5) / len(sensors) - 0.5
    return list(zip(sensors, (step * middles).tolist(), strict=True))


def _shades(draws: OnlineDraws) -> list[RGBAColorType]:
    """The colour of online times, lighter for each further sensor."""
    colour, number = _styles(draws)["online"]["color"], draws.points.ways
    return [to_rgba(colour, alpha) for alpha in np.linspace(0.9, 0.4, number)]


def _draws_of(source: Run | OnlineDraws) -> OnlineDraws:
    check_kind(source, (Run, OnlineDraws), "source")
    return online_draws(source) if isinstance(source, Run) else source


def _styles(draws: OnlineDraws) -> dict[str, dict[str, Any]]:
    return styles_of(draws.rows, [draws.reference, draws.plan, "online"])


def _mark(ax: Axes, draws: OnlineDraws, label: str | None = None) -> None:
    """Mark the planned times at the upper edge, with a label in the legend if there is one."""
    planned = draws.points.clock.by_sensor(draws.planned_times)
    times = [t + beside for name, beside in _beside(draws.points) for t in planned.get(name, [])]
    ax.plot(
        times, [1.0] * len(times), "v", transform=ax.get_xaxis_transform(), clip_on=False,
        color=_styles(draws)[draws.plan]["color"], ms=marker(1.2), mew=0, label=label, zorder=5,
    )  # fmt: skip


@figure("online_gain", applies=has_online)
def online_gain_figure(tables: Tables) -> Plot:
    """Histogram of the relative gain of online times, and the plan's gain on the same draws."""
    draws = tables.online
    over_reference = draws.gain("online", draws.reference)
    reference = phrase_of(tables.run.labels[draws.reference])
    title = title_of_gain(over_reference, "online times", reference)
    return Plot(2.9, lambda panels: online_gain(draws, ax=panels[0]), title=title)


def online_gain(source: Run | OnlineDraws, *, ax: Axes | None = None) -> Axes:
    """Draw the histogram of the relative gain of online times, and that of the plan.

    Parameters
    ----------
    source : Run or OnlineDraws
        A run with online times, or its draws that have them.
    ax : matplotlib Axes, optional
        By default those of a new figure.

    Returns
    -------
    matplotlib Axes

    Raises
    ------
    TypeError
        The source is neither a run nor its draws.
    """
    draws = _draws_of(source)
    online, plan = (draws.gain(name, draws.reference) for name in ("online", draws.plan))
    labels = {name: style["label"] for name, style in _styles(draws).items()}
    return gain(
        online, "online", reference=phrase_of(labels[draws.reference]), beside=(draws.plan, plan),
        sets=labels, ax=ax,
    )  # fmt: skip


@figure("online_draw", applies=has_online)
def online_draw_figure(tables: Tables) -> Plot:
    """Truth, estimates and times of one draw, of a gain over the plan near the median.

    If online times differ from the plan in any draw with a trajectory, it is one of those draws.
    """
    draws, trajectories = tables.online, tables.trajectories
    has_estimate = draws.rows["estimate"].notna() & draws.rows["draw"].isin(trajectories["draw"])
    differ = has_estimate & draws.differ
    rows = draws.rows[differ if differ.any() else has_estimate].set_index("draw")
    plan, online = (rows[f"mse_{name}"].to_numpy() for name in (draws.plan, "online"))
    gains = pd.Series(relative_gain(online, plan), index=rows.index).dropna()
    if gains.empty:
        return no_draw()
    every = draws.gain("online", draws.plan)
    draw = median_draw(gains, every)
    sets = {draws.plan: list(draws.planned_times), "online": list(rows["measurement_times"][draw])}
    trajectory = with_online(trajectories[trajectories["draw"] == draw], rows["estimate"][draw])
    relative, plan_phrase = float(gains[draw]), phrase_of(tables.run.labels[draws.plan])
    title = title_of_draw(relative, every.relative.count, "online times", plan_phrase)
    return plot_of_draw(trajectory, sets, legend_of_draw(draw, relative), title)


def with_online(trajectory: pd.DataFrame, estimate: np.ndarray) -> pd.DataFrame:
    """The trajectory of a draw with the estimate with its online times, ((T+1) q,)."""
    quantities = components_in(trajectory, "z_")
    estimates = np.reshape(estimate, (-1, len(quantities)))
    columns = {
        f"estimate_online_{quantity.suffix}": estimates[:, k]
        for k, quantity in enumerate(quantities)
    }
    return trajectory.sort_values("t").assign(**columns)
