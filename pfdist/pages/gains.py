"""The relative gain of a set over all draws, and one draw (the paper's figures 4 and 3)."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from numpy.typing import NDArray

from pfdist.errors import JobError
from pfdist.pages.figure import Plot, Tables, figure, one_number
from pfdist.pages.panel import (
    MOST_COMPONENTS,
    axes_for,
    check_kind,
    chosen,
    clock_of_table,
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
from pfdist.problem.set_key import phrase_of
from pfdist.results import BIN, EDGES, Gain, Run
from pfdist.results.stored_run import statistics_of
from pfdist.store.schema import components_in

Array = NDArray[np.float64]
Sets = Mapping[str, Sequence[float]]
_FENCE = 3.0  # interquartile ranges from a quartile to the end of the axis: Tukey's outer fences
_SHAPES = ("+", "*")  # of the reference's times and of the other set's


@figure("gain", applies=one_number, each_set=True)
def gain_figure(tables: Tables, name: str) -> Plot:
    """Histogram of the relative gain over all draws (the paper's figure 4)."""
    relative, labels = tables.statistics.gains[name], tables.run.labels
    reference = phrase_of(labels[tables.run.names[0]])
    return Plot(
        2.4,
        lambda panels: gain(relative, name, reference=reference, sets=labels, ax=panels[0]),
        title=f"How much lower the error is with {phrase_of(labels[name])} than with {reference}, "
        f"in each of {relative.relative.count:,} draws. Answers compare mean errors: "
        "this is another number than the mean of these gains.",
    )


def gain(
    source: Run | Gain | pd.DataFrame,
    name: str = "",
    *,
    reference: str = "",
    sets: Collection[str] = (),
    ax: Axes | None = None,
) -> Axes:
    """Draw the histogram of the relative gain; arrows count the draws beyond the axis.

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
    sets : sequence of str, or mapping of str to str
        Names of all sets of the run, the reference first, or their labels by name; a run has its
        own. They give each set its colour.
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
        gains, sets = statistics_of(source).gains, source.labels
        reference = phrase_of(sets[source.names[0]])
    else:
        gains, reference = _gains_of_table(source, reference)
        sets = sets or source.attrs.get("sets", ())
    name = chosen(name or next(iter(gains)), gains, "name")
    ax = axes_for(ax)
    if not gains[name].counts.any():
        return write_instead(ax, "no draw has a finite gain")
    _draw_gain(ax, gains[name], reference, styles_of(sets or [reference], [name])[name])
    return ax


def _gains_of_table(table: pd.DataFrame, reference: str) -> tuple[dict[str, Gain], str]:
    """Gains of all sets of a table over the reference, and the label of the reference."""
    names = [str(key).removeprefix("mse_") for key in table if str(key).startswith("mse_")]
    reference = chosen(reference or (names or [""])[0], names, "reference")
    mse = {name: table[f"mse_{name}"].to_numpy() for name in names}
    gains = {name: Gain.of_draws(mse[name], mse[reference]) for name in names if name != reference}
    return gains, phrase_of(table.attrs.get("sets", {}).get(reference, reference))


def _draw_gain(ax: Axes, relative: Gain, reference: str, style: Mapping[str, Any]) -> None:
    first, last = _shown_bins(relative)
    count = int(np.clip(2 * np.cbrt(relative.relative.count), 10, 100))  # Rice's rule
    merged = max(1, -(-(last - first) // count))  # number of counted bins in a bar
    starts, width = np.arange(first, last, merged), 100 * BIN * merged
    shares = 100 * np.add.reduceat(relative.counts[:last], starts) / relative.relative.count
    mean = minus(f"{100 * relative.relative.mean:.1f} %")
    bars = ax.bar(
        100 * EDGES[starts], shares, width, align="edge", color=style["color"], alpha=0.75, lw=0,
        label=f"{style['label']}, mean of relative gains {mean}",
    )  # fmt: skip
    ax.axvline(0.0, color="black", ls=":", label="no gain")
    legend_above(ax, [bars], columns=1)
    _mark_beyond(ax, relative, first, last)
    ax.set_xlim(100 * EDGES[first], 100 * EDGES[last])
    ax.set_xlabel(f"relative gain over {verbatim(reference)} [%]\n(right: {style['label']} better)")
    ax.set_ylabel("share of draws [%]")


def _mark_beyond(ax: Axes, relative: Gain, first: int, last: int) -> None:
    """Draw an arrow on each side where draws lie beyond the axis, and write how many."""
    below = relative.below + int(relative.counts[:first].sum())
    above = relative.above + int(relative.counts[last:].sum())
    for draws, where, index, arrow in ((below, "below", first, "<"), (above, "above", last, ">")):
        if draws:
            at = 100 * EDGES[index]
            ax.plot(at, 0.0, arrow, color=GREY, ms=marker(1.3), clip_on=False, zorder=5)
            text = minus(f"{draws:,} draw{'s' * (draws > 1)}\n{where} {at:.0f} %")
            x, side = (0.01, "left") if where == "below" else (0.99, "right")
            ax.text(x, 0.98, text, ha=side, va="top", c=GREY, size="small", transform=ax.transAxes)


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
    """Truth, estimates and times of one draw, of a gain near the median of all draws."""
    trajectories, sets, draw, gain = _of_run(tables, name)
    if np.isnan(gain):
        text = "no draw with a trajectory has a gain"
        return Plot(2.6, lambda panels: write_instead(panels[0], text), title=f"N{text[1:]}.")
    which, reference = (phrase_of(tables.run.labels[key]) for key in (name, tables.run.names[0]))
    draws, number = (
        tables.statistics.gains[name].relative.count,
        len(components_in(trajectories, "z_")),
    )
    most, lower = min(number, MOST_COMPONENTS), "lower" if gain >= 0 else "higher"
    title = (
        f"One draw, of a gain near the median of all {draws:,}: with {which} the error is "
        f"{100 * abs(gain):.1f} % {lower} than with {reference}."
    )

    def plot(panels: Sequence[Axes]) -> None:
        for component, ax in enumerate(panels):
            one_draw(
                trajectories, sets, draw=draw, title=_legend(draw, gain), component=component, ax=ax
            )
        stack(panels, number)

    return Plot(0.8 + 1.5 * most, plot, most, title=title)


def _legend(draw: int, gain: float) -> str:
    return f"draw {draw}, relative gain {minus(f'{100 * gain:.1f} %')}; markers: measured"


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
        One of the draws that have trajectories. By default the draw of a run whose gain is
        nearest the median of all draws, or the first draw of a DataFrame.
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
    legend_above(ax, title=title)
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
        every = tables.statistics.gains[name]
        median = np.clip(every.quantile(0.5), EDGES[0], EDGES[-1])
        draw = int((gains - median).abs().fillna(np.inf).idxmin())
    gain = float(gains[chosen(draw, gains.index.tolist(), "draw")])
    return tables.trajectories, {key: sets[key] for key in (reference, name)}, draw, gain


def _draw_trajectory(ax: Axes, trajectory: pd.DataFrame, sets: Sets, suffix: str) -> None:
    t, z = trajectory["t"].to_numpy(), trajectory[f"z_{suffix}"].to_numpy()
    ax.plot(t, z, color="black", label="truth")
    estimates = [trajectory[f"estimate_{name}_{suffix}"].to_numpy() for name in sets]
    everything = np.concatenate([z, *estimates])
    low, high = np.nanmin(everything), np.nanmax(everything)
    row = 0
    styles = styles_of(trajectory, sets)
    for (name, times), estimate, shape in zip(sets.items(), estimates, _SHAPES, strict=True):
        colour, dashes, label = (styles[name][key] for key in ("color", "ls", "label"))
        ax.plot(t, estimate, color=colour, ls=dashes, lw=thin(0.9), label=label)
        for sensor, measured in clock_of_table(trajectory).by_sensor(times).items():
            row += 1
            level = low - (high - low) * (0.06 + 0.07 * row)  # below the curves
            ax.plot(
                measured, [level] * len(measured), shape, color=colour, ms=marker(1.2), mew=thin()
            )
            name_row(ax, level, ", ".join(filter(None, [label, verbatim(sensor)])), color=colour)
