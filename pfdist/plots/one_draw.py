"""One draw: the truth, both filters' estimates and their measurement times (paper, figure 3)."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from pfdist.plots.style import BLUE, RED


def typical_draw(gains: "pd.Series[float]", mean: float) -> int:
    """Give the draw, of those in the index, whose relative gain lies nearest to the mean."""
    distance = (gains - mean).abs().to_numpy()
    return int(gains.index[int(distance.argmin())])


def plot_one_draw(
    axes: Axes,
    trajectory: pd.DataFrame,
    times: Mapping[str, Sequence[int]],
    gain: float,
    component: int = 0,
) -> None:
    """Draw z and two estimates of it.

    Parameters
    ----------
    axes : matplotlib Axes
    trajectory : DataFrame
        Rows of the table ``trajectories`` of one draw.
    times : mapping of str to sequence of int
        Measurement times of two sets by name, the reference first.
    gain : float
        Relative gain of the draw.
    component : int
        Of z.
    """
    t, z = trajectory["t"].to_numpy(), trajectory[f"z_{component}"].to_numpy()
    axes.plot(t, z, color="black", lw=1.0, label="$z(t)$")
    reference, found = times
    styles = ((reference, BLUE, "+", (0, (4, 2))), (found, RED, "*", "-"))
    estimates = [trajectory[f"estimate_{name}_{component}"].to_numpy() for name in times]
    everything = np.concatenate([z, *estimates])
    low, high = np.nanmin(everything), np.nanmax(everything)
    for row, ((name, colour, marker, dashes), estimate) in enumerate(
        zip(styles, estimates, strict=True), start=1
    ):
        axes.plot(t, estimate, color=colour, ls=dashes, lw=0.9, label=rf"$\hat{{z}}(t)$, {name}")
        at = np.asarray(times[name])
        level = low - (high - low) * (0.06 + 0.07 * row)  # below the curves, a line a set
        label = rf"$\mathcal{{M}}$, {name}"
        axes.plot(at, np.full(at.size, level), marker, color=colour, ms=4, mew=0.8, label=label)
    axes.set_xlabel("$t$")
    axes.set_ylabel("$z$" if component == 0 and "z_1" not in trajectory else f"$z_{component}$")
    axes.set_title(f"relative gain of this draw: {100 * gain:.1f} %", pad=30)
    axes.legend(ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0), columnspacing=1.2)
