"""Histogram of the relative gain over all draws (the paper's figure 4)."""

import numpy as np
from matplotlib.axes import Axes

from pfdist.analysis import BIN, EDGES, Gain
from pfdist.plots.style import BLUE, GREY, RED

_FENCE = 3.0  # quartile ranges beyond a quartile at which the axis ends: Tukey's outer fences


def plot_gain_histogram(axes: Axes, gain: Gain, name: str, reference: str) -> None:
    """Draw the histogram of the relative gain; draws far from most others are counted beside it.

    Parameters
    ----------
    axes : matplotlib Axes
    gain : Gain
        Of the set of times over the reference.
    name : str
        Of the set of times.
    reference : str
        What the reference is called.

    References
    ----------
    Tukey, "Exploratory data analysis", 1977: the fences.
    """
    summary, (first, last) = gain.summary(), _shown_bins(gain)
    count = int(np.clip(2 * np.cbrt(summary.draws), 10, 100))  # Rice's rule
    together = max(1, -(-(last - first) // count))  # fixed bins to each that is drawn
    starts = np.arange(first, last, together)
    heights = np.add.reduceat(gain.counts[:last], starts)
    width = 100 * BIN * together
    density = heights / summary.draws / width
    axes.bar(100 * EDGES[starts], density, width, align="edge", color=BLUE, alpha=0.75, lw=0)
    axes.axvline(0.0, color=RED, lw=1.0, label="no gain")
    label = (
        f"mean {100 * summary.mean_relative_gain:.1f} %\n"
        f"$P(g > 0)$ = {100 * summary.positive_fraction:.1f} %\n{summary.draws:,} draws"
    )
    low, high = 100 * EDGES[first], 100 * EDGES[last]
    below = gain.below + int(gain.counts[:first].sum())
    above = gain.above + int(gain.counts[last:].sum())
    for draws, where, at, arrow in ((below, "below", low, "<"), (above, "above", high, ">")):
        if draws:  # the legend counts them, and an arrow marks where they lie
            label += f"\n{draws:,} of them {where} {at:.0f} %"
            axes.plot(at, 0.0, arrow, color=GREY, ms=4, clip_on=False, zorder=5)
    axes.plot([], [], " ", label=label)
    axes.set_xlim(low, high)
    axes.set_xlabel(f"relative gain $g$ of {name} over {reference} [%]")
    axes.set_ylabel("density [1/%]")
    axes.legend(loc="upper left")


def _shown_bins(gain: Gain) -> tuple[int, int]:
    """First of the bins that are shown, and that after the last."""
    inside = np.flatnonzero(gain.counts)
    low, high = (
        float(np.clip(gain.quantile(share), EDGES[0], EDGES[-1])) for share in (0.25, 0.75)
    )
    fence = _FENCE * (high - low)
    first, last = np.searchsorted(EDGES, [low - fence, high + fence]).tolist()
    first, last = max(int(inside[0]), first - 1), min(int(inside[-1]) + 1, last)
    return first, max(last, first + 1)
