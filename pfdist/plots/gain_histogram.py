"""Histogram of the relative gain over all draws (the paper's figure 4)."""

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from numpy.typing import NDArray

from pfdist.analysis import BIN, EDGES, Gain, GainSummary, Run
from pfdist.analysis.reference import label
from pfdist.plots.figure import Plot, Tables, figure, one_number
from pfdist.plots.panel import (
    axes_for,
    check_kind,
    chosen,
    legend_above,
    marker,
    minus,
    thin,
    verbatim,
    write_instead,
)
from pfdist.plots.style import BLUE, GREY, RED

Array = NDArray[np.float64]
_FENCE = 3.0  # interquartile ranges from a quartile to the end of the axis: Tukey's outer fences


@figure("gain", applies=one_number, each_set=True)
def gain_figure(tables: Tables, name: str) -> Plot:
    """Histogram of the relative gain over all draws (the paper's figure 4)."""
    known, reference = tables.statistics.gains[name], label(tables.run.names[0])
    return Plot(
        2.4,
        lambda panels: gain(known, name, reference=reference, ax=panels[0]),
        title=title_of(known, f"the times of {name}", reference),
    )


def title_of(known: Gain, found: str, reference: str) -> str:
    """Say in how many draws found times err less than the reference."""
    if not known.counts.any():
        return "No draw has a finite gain."
    share = 100 * known.positive / known.relative.count
    return f"In {share:.1f} % of the draws, {found} err less than {reference}."


def gain(
    source: Run | Gain | pd.DataFrame,
    name: str = "",
    *,
    reference: str = "",
    beside: str | tuple[str, Gain] = "",
    ax: Axes | None = None,
) -> Axes:
    """Draw the histogram of the relative gain; the legend counts draws beyond the axis.

    Parameters
    ----------
    source : Run, Gain or DataFrame
        A run; or a gain over the reference; or a table with a column ``mse_<name>`` for each set
        and a row for each draw, as `pfdist.analysis.Run.comparison`.
    name : str
        Name of the set; by default the first that was found. A `Gain` needs a name.
    reference : str
        With a `Gain` the label of the reference; with a table the name of its set, by default the
        first; a run has one.
    beside : str or (str, Gain), optional
        Another set over the same reference, drawn as an outline: its name, or name and gain.
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
    gains: dict[str, Gain] = {}
    if isinstance(source, Gain):
        gains[name] = source
    else:
        gains, reference = _gains(source, reference)
        name = chosen(name or next(iter(gains)), gains, "name")
    if isinstance(beside, tuple):
        gains[beside[0]] = beside[1]
        beside = beside[0]
    other = chosen(beside, gains, "beside") if beside else ""
    ax = axes_for(ax)
    if not gains[name].counts.any():
        return write_instead(ax, "no draw has a finite gain")
    shown = {key: gains[key] for key in (name, other) if key and gains[key].counts.any()}
    _plot(ax, shown, reference)
    return ax


def _gains(source: Run | pd.DataFrame, reference: str) -> tuple[dict[str, Gain], str]:
    """Gains of all sets of a run or a table over the reference, and the label of the reference."""
    if isinstance(source, Run):
        return source.statistics().gains, label(source.names[0])
    prefix = "mse_"
    names = [str(key).removeprefix(prefix) for key in source if str(key).startswith(prefix)]
    reference = chosen(reference or (names or [""])[0], names, "reference")
    gains = {name: Gain() for name in names if name != reference}
    for name, known in gains.items():
        known.add(source[prefix + name].to_numpy(), source[prefix + reference].to_numpy())
    return gains, label(reference)


def _plot(ax: Axes, gains: dict[str, Gain], reference: str) -> None:
    name, known = next(iter(gains.items()))
    starts_shown, ends_shown = zip(*map(_shown_bins, gains.values()), strict=True)
    first, last = min(starts_shown), max(ends_shown)
    summary = known.summary()
    count = int(np.clip(2 * np.cbrt(summary.draws), 10, 100))  # Rice's rule
    merged = max(1, -(-(last - first) // count))  # number of counted bins in a bar
    starts, width = np.arange(first, last, merged), 100 * BIN * merged
    heights = _density(known, starts, last, width)
    bars = ax.bar(100 * EDGES[starts], heights, width, align="edge", color=BLUE, alpha=0.75, lw=0)
    line = ax.axvline(0.0, color=RED, label="no gain")
    draws = ", ".join([f"{summary.draws:,} draws", *_beyond(ax, known, first, last)])
    if len(gains) == 1:
        bars.set_label(f"{', '.join(_mean_and_share(summary))}\n{draws}")
        legend_above(ax, [bars, line])
    else:
        other, of_other = list(gains.items())[1]
        ends = np.append(100 * EDGES[starts], 100 * EDGES[starts[-1]] + width)
        outline = _density(of_other, starts, last, width)
        shape = ax.stairs(outline, ends, color="black", lw=thin())
        bars.set_label(
            "\n".join([f"{verbatim(name)}:", *_mean_and_share(summary), *draws.split(", ")])
        )
        shape.set_label("\n".join([f"{verbatim(other)}:", *_mean_and_share(of_other.summary())]))
        legend_above(ax, [bars, shape])
    ax.set_xlim(100 * EDGES[first], 100 * EDGES[last])
    ax.set_xlabel(f"relative gain $g$ of {verbatim(name)} over {verbatim(reference)} [%]")
    ax.set_ylabel("density [1/%]")


def _beyond(ax: Axes, known: Gain, first: int, last: int) -> list[str]:
    """Draw an arrow on each side on which draws lie beyond the axis, and say how many."""
    told = []
    below = known.below + int(known.counts[:first].sum())
    above = known.above + int(known.counts[last:].sum())
    for draws, where, index, arrow in ((below, "below", first, "<"), (above, "above", last, ">")):
        if draws:
            at = 100 * EDGES[index]
            told.append(minus(f"{draws:,} of them {where} {at:.0f} %"))
            ax.plot(at, 0.0, arrow, color=GREY, ms=marker(1.3), clip_on=False, zorder=5)
    return told


def _density(known: Gain, starts: NDArray[np.intp], last: int, width: float) -> Array:
    """Share of all draws in each bar, over the width of a bar."""
    heights: Array = np.add.reduceat(known.counts[:last], starts) / known.relative.count / width
    return heights


def _mean_and_share(summary: GainSummary) -> list[str]:
    return [
        minus(f"mean {100 * summary.mean_relative_gain:.1f} %"),
        f"$P(g > 0)$ = {100 * summary.positive_fraction:.1f} %",
    ]


def _shown_bins(known: Gain) -> tuple[int, int]:
    """Indices of the first bin that is shown, and of the bin after the last."""
    inside = np.flatnonzero(known.counts)
    low, high = (
        float(np.clip(known.quantile(share), EDGES[0], EDGES[-1])) for share in (0.25, 0.75)
    )
    fence = _FENCE * (high - low)
    first, last = np.searchsorted(EDGES, [low - fence, high + fence]).tolist()
    first, last = max(int(inside[0]), first - 1), min(int(inside[-1]) + 1, last)
    return first, max(last, first + 1)
