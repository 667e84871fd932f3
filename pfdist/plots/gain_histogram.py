"""Histogram of the relative gain over all draws (the paper's figure 4)."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from pfdist.analysis import BIN, EDGES, Gain
from pfdist.analysis.reference import label
from pfdist.plots.figure import Plot, Tables, figure, one_number, write_instead
from pfdist.plots.style import BLUE, GREY, RED

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


def plot_gain_histogram(axes: Axes, gain: Gain, name: str, reference: str) -> None:
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

    References
    ----------
    Tukey, "Exploratory data analysis", 1977: the fences.
    """
    summary, (first, last) = gain.summary(), _shown_bins(gain)
    count = int(np.clip(2 * np.cbrt(summary.draws), 10, 100))  # Rice's rule
    merged = max(1, -(-(last - first) // count))  # number of counted bins in a bar
    starts = np.arange(first, last, merged)
    heights = np.add.reduceat(gain.counts[:last], starts)
    width = 100 * BIN * merged
    density = heights / summary.draws / width
    axes.bar(100 * EDGES[starts], density, width, align="edge", color=BLUE, alpha=0.75, lw=0)
    axes.axvline(0.0, color=RED, lw=1.0, label="no gain")
    told = (
        f"mean {100 * summary.mean_relative_gain:.1f} %\n"
        f"$P(g > 0)$ = {100 * summary.positive_fraction:.1f} %\n{summary.draws:,} draws"
    )
    low, high = 100 * EDGES[first], 100 * EDGES[last]
    below = gain.below + int(gain.counts[:first].sum())
    above = gain.above + int(gain.counts[last:].sum())
    for draws, where, at, arrow in ((below, "below", low, "<"), (above, "above", high, ">")):
        if draws:  # an arrow shows on which side these draws lie
            told += f"\n{draws:,} of them {where} {at:.0f} %"
            axes.plot(at, 0.0, arrow, color=GREY, ms=4, clip_on=False, zorder=5)
    axes.plot([], [], " ", label=told)
    axes.set_xlim(low, high)
    axes.set_xlabel(f"relative gain $g$ of {name} over {reference} [%]")
    axes.set_ylabel("density [1/%]")
    axes.legend(loc="upper left")


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
