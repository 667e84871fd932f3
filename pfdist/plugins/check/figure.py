"""The particle loss by the number of particles."""

import pandas as pd
from matplotlib.axes import Axes

from pfdist.pages.panel import BAND, axes_for, check_kind, legend_above, marker, thin
from pfdist.pages.style import set_style
from pfdist.results.particle_loss import SMALL, SMALL_AT_MOST


def particle_losses(losses: pd.DataFrame, *, ax: Axes | None = None) -> Axes:
    """Draw the particle loss against the number of particles: its estimate and its upper limit.

    Dotted lines are the limits of ``filter.particles = "auto"``, 1 and 5 %.

    Parameters
    ----------
    losses : DataFrame
        The result of `pfdist.particle_losses`.
    ax : matplotlib Axes, optional
        By default those of a new figure.

    Returns
    -------
    matplotlib Axes
    """
    check_kind(losses, (pd.DataFrame,), "losses")
    table, ax = losses.sort_values("particles"), axes_for(ax)
    ax.set_xscale("log")
    ax.set_yscale("log", nonpositive="clip")
    for column, errors, most, style, name in (
        ("particle_loss", "particle_loss_error", SMALL, set_style(1), "two filters"),
        ("particle_loss_limit", None, SMALL_AT_MOST, set_style(0), "at most (95 %)"),
    ):
        share = 100 * table[column].where(table[column] > 0)  # a logarithmic axis has no 0
        half = None if errors is None else 100 * BAND * table[errors]
        ax.errorbar(
            table["particles"], share, half, lw=thin(), ms=marker(), elinewidth=thin(), label=name,
            **style,
        )  # fmt: skip
        ax.axhline(100 * most, color=style["color"], ls=":", lw=thin())
    ax.xaxis.set_major_formatter("{x:,.0f}")
    ax.yaxis.set_major_formatter("{x:g}")
    ax.set_xlabel("number of particles")
    ax.set_ylabel("loss [% of the MSE]")
    legend_above(ax)
    return ax
