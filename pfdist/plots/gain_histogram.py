"""Histogram of the relative gain over all draws (the paper's figure 4)."""

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from pfdist.plots.style import BLUE, RED

_LOWEST = 0.001  # quantile at which the left tail is cut: the gain has no lower bound


def plot_gain_histogram(
    axes: Axes, gain: NDArray[np.float64], name: str, mean: float, positive: float
) -> None:
    """Draw the histogram of the relative gain.

    Parameters
    ----------
    axes : matplotlib Axes
    gain : array of float64, (D,)
        Of the draws that count.
    name : str
        Of the set of times.
    mean, positive : float
        Mean relative gain, and share of positive ones, as fractions.
    """
    low = np.quantile(gain, _LOWEST)
    count = int(np.clip(2 * np.cbrt(gain.size), 10, 100))  # Rice's rule
    bins = np.linspace(100 * low, 100 * gain.max(), count + 1)
    axes.hist(100 * gain, bins=bins.tolist(), density=True, color=BLUE, alpha=0.75, lw=0)
    axes.axvline(0.0, color=RED, lw=1.0, label="no gain")
    label = f"mean {100 * mean:.1f} %\n$P(g > 0)$ = {100 * positive:.1f} %\n{gain.size:,} draws"
    left_out = int(np.sum(gain < low))
    if left_out:
        label += f"\n{left_out:,} of them below {100 * low:.0f} %"
    axes.plot([], [], " ", label=label)
    axes.set_xlabel(f"relative gain $g$ of {name} over regular times [%]")
    axes.set_ylabel("density [1/%]")
    axes.legend(loc="upper left")
