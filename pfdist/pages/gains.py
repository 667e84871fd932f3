"""Gains of found times: the relative gain over all draws, and one draw (paper, figures 3, 4)."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from numpy.typing import NDArray

from pfdist.common.formatted_times import by_sensor
from pfdist.errors import JobError
from pfdist.pages.figure import Plot, Tables, figure, one_number
from pfdist.pages.panel import (
    MOST_COMPONENTS,
    axes_for,
    check_kind,
    chosen,
    label_quantity,
    label_times,
    legend_above,
    marker,
    minus,
    name_row,
    stack,
    styles_of,
    thin,
    verbatim,
    write_instead,
)
from pfdist.pages.style import GREY
from pfdist.problem.set_key import label_of
from pfdist.results import BIN, EDGES, Gain, GainSummary, Run
from pfdist.results.stored_run import statistics_of
from pfdist.store.schema import components_in

Array = NDArray[np.float64]
Sets = Mapping[str, Sequence[float]]
_FENCE = 3.0  # interquartile ranges from a quartile to the end of the axis: Tukey's outer fences
_LONGEST_NAMES = {3: 12, 2: 20}
"""Characters of a name with which the legend of a draw has room for so many columns."""
_ENTRIES, _LINE_INCHES = 5, 0.15  # of the legend of a draw
_SHAPES = ("+", "*")  # of the reference's times and of the other set's


@figure("gain", applies=one_number, each_set=True)
def gain_figure(tables: Tables, name: str) -> Plot:
    """Histogram of the relative gain over all draws (the paper's figure 4)."""
    relative, names = tables.statistics.gains[name], tables.run.names
    reference = label_of(names[0])
    return Plot(
        2.4,
        lambda panels: gain(relative, name, reference=reference, sets=names, ax=panels[0]),
        title=title_of_gain(relative, f"the times of {name}", reference),
    )


def title_of_gain(relative: Gain, which: str, reference: str) -> str:
    """Say in how many draws these times err less than the reference."""
    if not relative.counts.any():
        return "No draw has a finite gain."
    share = 100 * relative.positive / relative.relative.count
    return f"In {share:.1f} % of the draws, {which} err less than {reference}."


def gain(
    source: Run | Gain | pd.DataFrame,
    name: str = "",
    *,
    reference: str = "",
    beside: str | tuple[str, Gain] = "",
    sets: Sequence[str] = (),
    ax: Axes | None = None,
) -> Axes:
    """Draw the histogram of the relative gain; the legend counts draws beyond the axis.

    Parameters
    ----------
    source : Run, Gain or DataFrame
        A run; or a gain over the reference; or a table with a column ``mse_<name>`` for each set
        and a row for each draw, as the table ``comparison``.
    name : str
        Name of the set; by default the first that was found. A `Gain` needs a name.
    reference : str
        With a `Gain` the label of the reference; with a table the name of its set, by default the
        first; a run has one.
    beside : str or (str, Gain), optional
        Another set over the same reference, drawn as an outline: its name, or name and gain.
    sets : sequence of str
        Names of all sets of the run, the reference first, which give each its colour; a run has
        its own.
    ax : matplotlib Axes, optional
        By default those of a new figure.

    Returns
    -------
    matplotlib Axes

    Raises
    ------
    JobError
        There is no such set.
    TypeError
        The source is neither a run, nor a gain, nor a table.

    References
    ----------
    Tukey, "Exploratory data analysis", 1977: the fences.
    """
    check_kind(source, (Run, Gain, pd.DataFrame), "source")
    if isinstance(source, Gain):
        gains = {name: source}
    elif isinstance(source, Run):
        gains, reference, sets = (
            statistics_of(source).gains,
            label_of(source.names[0]),
            source.names,
        )
    else:
        gains, reference = _gains_of_table(source, reference)
    name = chosen(name or next(iter(gains)), gains, "name")
    if isinstance(beside, tuple):
        gains = gains | dict([beside])
        beside = beside[0]
    names = [name, chosen(beside, gains, "beside")] if beside else [name]
    ax = axes_for(ax)
    if not gains[name].counts.any():
        return write_instead(ax, "no draw has a finite gain")
    styles = styles_of(sets or [reference], names)
    shown = {key: gains[key] for key in names if gains[key].counts.any()}
    _draw_gains(ax, shown, reference, [styles[key]["color"] for key in shown])
    return ax


def _gains_of_table(table: pd.DataFrame, reference: str) -> tuple[dict[str, Gain], str]:
    """Gains of all sets of a table over the reference, and the label of the reference."""
    names = [str(key).removeprefix("mse_") for key in table if str(key).startswith("mse_")]
    reference = chosen(reference or (names or [""])[0], names, "reference")
    gains = {name: Gain() for name in names if name != reference}
    for name, relative in gains.items():
        relative.add(table[f"mse_{name}"].to_numpy(), table[f"mse_{reference}"].to_numpy())
    return gains, label_of(reference)


def _draw_gains(ax: Axes, gains: dict[str, Gain], reference: str, colours: Sequence[str]) -> None:
    (name, relative), *others = gains.items()
    starts_shown, ends_shown = zip(*map(_shown_bins, gains.values()), strict=True)
    first, last = min(starts_shown), max(ends_shown)
    summary = relative.summary()
    count = int(np.clip(2 * np.cbrt(summary.draws), 10, 100))  # Rice's rule
    merged = max(1, -(-(last - first) // count))  # number of counted bins in a bar
    starts, width = np.arange(first, last, merged), 100 * BIN * merged
    heights = _density(relative, starts, last, width)
    bars = ax.bar(
        100 * EDGES[starts], heights, width, align="edge", color=colours[0], alpha=0.75, lw=0
    )
    line = ax.axvline(0.0, color="black", ls=":", label="no gain")
    draws = [f"{summary.draws:,} draws", *_mark_beyond(ax, relative, first, last)]
    if not others:
        bars.set_label(f"{', '.join(_mean_and_share(summary))}\n{', '.join(draws)}")
        legend_above(ax, [bars, line], columns=2)
    else:
        [(other, of_other)] = others
        ends = np.append(100 * EDGES[starts], 100 * EDGES[starts[-1]] + width)
        density = _density(of_other, starts, last, width)
        shape = ax.stairs(density, ends, color=colours[1], lw=thin())
        bars.set_label("\n".join([f"{verbatim(name)}:", *_mean_and_share(summary), *draws]))
        shape.set_label("\n".join([f"{verbatim(other)}:", *_mean_and_share(of_other.summary())]))
        legend_above(ax, [bars, shape, line], columns=2)
    ax.set_xlim(100 * EDGES[first], 100 * EDGES[last])
    ax.set_xlabel(f"relative gain $g$ of {verbatim(name)} over {verbatim(reference)} [%]")
    ax.set_ylabel("density [1/%]")


def _mark_beyond(ax: Axes, relative: Gain, first: int, last: int) -> list[str]:
    """Draw an arrow on each side on which draws lie beyond the axis, and say how many."""
    texts = []
    below = relative.below + int(relative.counts[:first].sum())
    above = relative.above + int(relative.counts[last:].sum())
    for draws, where, index, arrow in ((below, "below", first, "<"), (above, "above", last, ">")):
        if draws:
            at = 100 * EDGES[index]
            texts.append(minus(f"{draws:,} of them {where} {at:.0f} %"))
            ax.plot(at, 0.0, arrow, color=GREY, ms=marker(1.3), clip_on=False, zorder=5)
    return texts


def _density(relative: Gain, starts: NDArray[np.intp], last: int, width: float) -> Array:
    """Share of all draws in each bar, over the width of a bar."""
    counts: Array = np.add.reduceat(relative.counts[:last], starts)
    return counts / relative.relative.count / width


def _mean_and_share(summary: GainSummary) -> list[str]:
    return [
        minus(f"mean {100 * summary.mean_relative_gain:.1f} %"),
        f"$P(g > 0)$ = {100 * summary.positive_fraction:.1f} %",
    ]


def _shown_bins(relative: Gain) -> tuple[int, int]:
    """Indices of the first bin that is shown, and of the bin after the last."""
    inside = np.flatnonzero(relative.counts)
    low, high = (
        float(np.clip(relative.quantile(share), EDGES[0], EDGES[-1])) for share in (0.25, 0.75)
    )
    fence = _FENCE * (high - low)
    first, last = np.searchsorted(EDGES, [low - fence, high + fence]).tolist()
    first, last = max(int(inside[0]), first - 1), min(int(inside[-1]) + 1, last)
    return first, max(last, first + 1)


@figure("draw", applies=one_number, each_set=True)
def draw_figure(tables: Tables, name: str) -> Plot:
    """Truth, estimates and times of a typical draw: the median gain of the first 100 draws."""
    trajectories, sets, draw, gain = _of_run(tables, name)
    if np.isnan(gain):
        return no_draw()
    reference = label_of(tables.run.names[0])
    return plot_of_draw(
        trajectories[trajectories["draw"] == draw], sets, f"{_legend(draw, gain)}, a typical one",
        title_of_draw(gain, f"the times of {name}", reference),
    )  # fmt: skip


def no_draw() -> Plot:
    """A plot that says that there is no draw to show."""
    text = "no draw with a trajectory has a gain"
    title = f"{text[0].upper()}{text[1:]}."
    return Plot(2.6, lambda panels: write_instead(panels[0], text), title=title)


def title_of_draw(gain: float, which: str, reference: str) -> str:
    """Say how much the errors of two sets differ in the draw of median gain."""
    less = "less" if gain >= 0 else "more"
    return (
        f"In a typical draw (of the median gain among those kept), {which} err "
        f"{100 * abs(gain):.1f} % {less} than {reference}."
    )


def _legend(draw: int, gain: float) -> str:
    return minus(f"draw {draw}, relative gain {100 * gain:.1f} %")


def plot_of_draw(trajectory: pd.DataFrame, sets: Sets, legend: str, title: str) -> Plot:
    """The plot of a draw with a panel for each of the first components of z.

    The sets are measurement times of two sets by their names, the reference first.
    """
    number = len(components_in(trajectory, "z_"))

    def draw(panels: Sequence[Axes]) -> None:
        for component, ax in enumerate(panels):
            one_draw(trajectory, sets, title=legend, component=component, ax=ax)
        stack(panels, number)

    lines, most = -(-_ENTRIES // _columns(sets)), min(number, MOST_COMPONENTS)
    return Plot(0.5 + _LINE_INCHES * lines + 1.5 * most, draw, most, title=title)


def _columns(sets: Sets) -> int:
    """Number of columns of the legend."""
    longest = max(map(len, sets), default=0)
    return next((count for count, most in _LONGEST_NAMES.items() if longest <= most), 1)


def typical_draw(gains: "pd.Series[float]") -> int:
    """The draw with the median relative gain; of two medians, the lower. The index holds draws."""
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
        Title of the legend; by default the draw and the relative gain, if a run is given.
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
        trajectory, sets, draw, gain = _of_run(Tables(trajectory), str(sets), draw)
        title = title or _legend(draw, gain)
    elif isinstance(sets, str):
        raise JobError(f"sets must be times by name, got {sets!r}", argument="sets")
    if "draw" in trajectory:
        draws = trajectory["draw"].unique().tolist()
        draw = draws[0] if draw is None else chosen(draw, draws, "draw")
        trajectory = trajectory[trajectory["draw"] == draw]
    quantities = components_in(trajectory, "z_")
    chosen(component, range(len(quantities)), "component")
    ax = axes_for(ax)
    _draw_trajectory(ax, trajectory.sort_values("t"), sets, quantities[component].suffix)
    label_quantity(ax, quantities, component)
    label_times(ax, trajectory)
    legend_above(ax, columns=_columns(sets), title=title)
    return ax


def _of_run(
    tables: Tables, name: str, draw: int | None = None
) -> tuple[pd.DataFrame, Sets, int, float]:
    """Trajectories of a run, the reference and another set, a draw, and the gain in this draw."""
    (reference, *others), sets = tables.run.names, tables.run.sets
    name = chosen(name or others[0], others, "sets")
    gains = tables.gains_of_trajectories[f"gain_{name}"]
    gains = gains[gains.index.isin(tables.trajectories["draw"])]
    if draw is None:
        draw = typical_draw(gains.dropna() if gains.notna().any() else gains)
    gain = float(gains[chosen(draw, gains.index.tolist(), "draw")])
    return tables.trajectories, {key: sets[key] for key in (reference, name)}, draw, gain


def _draw_trajectory(ax: Axes, trajectory: pd.DataFrame, sets: Sets, suffix: str) -> None:
    t, z = trajectory["t"].to_numpy(), trajectory[f"z_{suffix}"].to_numpy()
    ax.plot(t, z, color="black", label="$z(t)$")
    estimates = [trajectory[f"estimate_{name}_{suffix}"].to_numpy() for name in sets]
    everything = np.concatenate([z, *estimates])
    low, high = np.nanmin(everything), np.nanmax(everything)
    row = 0
    styles = styles_of(trajectory, sets)
    for (name, times), estimate, shape in zip(sets.items(), estimates, _SHAPES, strict=True):
        colour, dashes = styles[name]["color"], styles[name]["ls"]
        text = rf"$\hat{{z}}(t)$, {verbatim(name)}"
        ax.plot(t, estimate, color=colour, ls=dashes, lw=thin(0.9), label=text)
        for k, (sensor, measured) in enumerate(by_sensor(times).items()):
            row += 1
            level = low - (high - low) * (0.06 + 0.07 * row)  # below the curves
            ax.plot(
                measured, [level] * len(measured), shape, color=colour, ms=marker(1.2),
                mew=thin(), label="" if k else rf"$\mathcal{{M}}$, {verbatim(name)}",
            )  # fmt: skip
            name_row(ax, level, sensor, color=colour)
