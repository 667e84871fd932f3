"""Histogram of the relative gain over all draws (the paper's figure 4)."""

import numpy as np
from matplotlib.axes import Axes

from pfdist.analysis import BIN, EDGES, Gain
from pfdist.plots.style import BLUE, RED

_LOWEST = 0.001  # quantile at which the left tail is cut: the gain has no lower bound


def plot_gain_histogram(axes: Axes, gain: Gain, name: str) -> None:
    """Draw the histogram of the relative gain.

    Parameters
    ----------
    axes : matplotlib Axes
    gain : Gain
        Of the set of times over the reference.
    name : str
        Of the set of times.
    """
    summary, inside = gain.summary(), np.flatnonzero(gain.counts)
    first = max(int(inside[0]), int(np.searchsorted(EDGES, gain.quantile(_LOWEST))) - 1)
    count = int(np.clip(2 * np.cbrt(summary.draws), 10, 100))  # Rice's rule
    together = max(1, -(-(int(inside[-1]) + 1 - first) // count))  # fixed bins to one that is drawn
    starts = np.arange(first, int(inside[-1]) + 1, together)
    heights = np.add.reduceat(gain.counts[: int(inside[-1]) + 1], starts)
    width = 100 * BIN * together
    density = heights / summary.draws / width
    axes.bar(100 * EDGES[starts], density, width, align="edge", color=BLUE, alpha=0.75, lw=0)
    axes.axvline(0.0, color=RED, lw=1.0, label="no gain")
    label = (
        f"mean {100 * summary.mean_relative_gain:.1f} %\n"
        f"$P(g > 0)$ = {100 * summary.positive_fraction:.1f} %\n{summary.draws:,} draws"
    )
    left_out = gain.below + int(gain.counts[:first].sum())
    if left_out:
        label += f"\n{left_out:,} of them below {100 * EDGES[first]:.0f} %"
    axes.plot([], [], " ", label=label)
    axes.set_xlabel(f"relative gain $g$ of {name} over regular times [%]")
    axes.set_ylabel("density [1/%]")
    axes.legend(loc="upper left")
