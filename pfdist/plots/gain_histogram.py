"""Histogram of the relative gain over all draws (the paper's figure 4)."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from pfdist.analysis import BIN, EDGES, Gain, GainSummary
from pfdist.analysis.reference import label
from pfdist.plots.figure import Plot, Tables, figure, one_number, write_instead
from pfdist.plots.style import BLUE, GREY, RED

Array = NDArray[np.float64]
_FENCE = 3.0  # interquartile ranges from a quartile to the end of the axis: Tukey's outer fences


@figure("gain", applies=one_number, each_set=True)
def gain_figure(tables: Tables, name: str) -> Plot:
    """Histogram of the relative gain over all draws (the paper's figure 4)."""
    gain, reference = tables.statistics.gains[name], label(tables.run.names[0])

    def draw(panels: Sequence[Axes]) -> None:
        if gain.counts.any():
            plot_gain_histogram(panels[0], gain, name, reference)
        else:
            write_instead(panels[0], "no draw has a finite gain")

    return Plot(2.3, draw)


def plot_gain_histogram(
    axes: Axes, gain: Gain, name: str, reference: str, beside: tuple[str, Gain] | None = None
) -> None:
    """Draw the histogram of the relative gain; the legend counts draws beyond the axis.

    Parameters
    ----------
    axes : matplotlib Axes
    gain : Gain
        Gain of a set of times over the reference.
    name : str
        Name of the set.
    reference : str
        Label of the reference.
    beside : (str, Gain), optional
        Name and gain of another set over the same reference, drawn as an outline.

    References
    ----------
    Tukey, "Exploratory data analysis", 1977: the fences.
    """
    summary, shown = gain.summary(), [gain, *([beside[1]] if beside else [])]
    starts_shown, ends_shown = zip(*map(_shown_bins, shown), strict=True)
    first, last = min(starts_shown), max(ends_shown)
    count = int(np.clip(2 * np.cbrt(summary.draws), 10, 100))  # Rice's rule
    merged = max(1, -(-(last - first) // count))  # number of counted bins in a bar
    starts, width = np.arange(first, last, merged), 100 * BIN * merged
    density = _density(gain, starts, last, width)
    bars = axes.bar(100 * EDGES[starts], density, width, align="edge", color=BLUE, alpha=0.75, lw=0)
    handles: list[Any] = [axes.axvline(0.0, color=RED, lw=1.0, label="no gain")]
    told = f"{_mean_and_share(summary)}\n{summary.draws:,} draws"
    if beside is not None:
        other, gain_of_other = beside
        ends = np.append(100 * EDGES[starts], 100 * EDGES[starts[-1]] + width)
        outline = _density(gain_of_other, starts, last, width)
        told_of_other = f"{other}:\n{_mean_and_share(gain_of_other.summary())}"
        handles.append(axes.stairs(outline, ends, color="black", lw=0.9, label=told_of_other))
        told = f"{name}:\n{told}"
    low, high = 100 * EDGES[first], 100 * EDGES[last]
    below = gain.below + int(gain.counts[:first].sum())
    above = gain.above + int(gain.counts[last:].sum())
    for draws, where, at, arrow in ((below, "below", low, "<"), (above, "above", high, ">")):
        if draws:  # an arrow shows on which side these draws lie
            told += f"\n{draws:,} of them {where} {at:.0f} %"
            axes.plot(at, 0.0, arrow, color=GREY, ms=4, clip_on=False, zorder=5)
    handle = axes.plot([], [], " ")[0] if beside is None else bars
    handle.set_label(told)
    handles.insert(1, handle)
    axes.set_xlim(low, high)
    axes.set_xlabel(f"relative gain $g$ of {name} over {reference} [%]")
    axes.set_ylabel("density [1/%]")
    if beside is None:
        axes.legend(handles=handles, loc="upper left")
    else:  # two shapes leave no corner free
        at = {"loc": "lower center", "bbox_to_anchor": (0.45, 1.0)}
        axes.legend(handles=handles[1:], ncols=2, **at)


def _density(gain: Gain, starts: NDArray[np.intp], last: int, width: float) -> Array:
    """Share of all draws in each bar, over the width of a bar."""
    heights: Array = np.add.reduceat(gain.counts[:last], starts) / gain.relative.count / width
    return heights


def _mean_and_share(summary: GainSummary) -> str:
    return (
        f"mean {100 * summary.mean_relative_gain:.1f} %\n"
        f"$P(g > 0)$ = {100 * summary.positive_fraction:.1f} %"
    )


def _shown_bins(gain: Gain) -> tuple[int, int]:
    """Indices of the first bin that is shown, and of the bin after the last."""
    inside = np.flatnonzero(gain.counts)
    low, high = (
        float(np.clip(gain.quantile(share), EDGES[0], EDGES[-1])) for share in (0.25, 0.75)
    )
    fence = _FENCE * (high - low)
    first, last = np.searchsorted(EDGES, [low - fence, high + fence]).tolist()
    first, last = max(int(inside[0]), first - 1), min(int(inside[-1]) + 1, last)
    return first, max(last, first + 1)
