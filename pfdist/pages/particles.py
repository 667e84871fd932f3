"""Panels of particles: how many are effective, and what they lose."""

from collections.abc import Sequence

import pandas as pd
from matplotlib.axes import Axes

from pfdist.pages.panel import (
    BAND,
    axes_for,
    check_kind,
    label_times,
    legend_above,
    marker,
    rows_with_results,
    table_of,
    thin,
    write_instead,
)
from pfdist.pages.style import set_style
from pfdist.results.particle_loss import SMALL, SMALL_AT_MOST

_LINEAR = 20  # largest ratio of two effective sample sizes on a linear axis


def effective_sample_size(
    profile: object,
    names: Sequence[str] = (),
    *,
    particles: int | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the effective sample size of filters over time.

    The axis is logarithmic if the sizes differ by more than a factor of 20.

    Parameters
    ----------
    profile : DataFrame or object
        A table with the columns t and effective_sample_size, and name if there are several sets;
        instants without a value are left out. Or an object whose ``profile`` or ``table`` it is,
        such as the result of `pfdist.why` or `pfdist.filter_measurements`.
    names : sequence of str
        Sets that are drawn, the reference first; by default all.
    particles : int, optional
        Number of particles, drawn as a line: no effective sample size is larger.
    ax : matplotlib Axes, optional
        By default those of a new figure.

    Returns
    -------
    matplotlib Axes

    Raises
    ------
    JobError
        The table has no set of this name.
    """
    table = table_of(profile, "profile", "profile", "table").dropna(subset="effective_sample_size")
    sets, ax = rows_with_results(table, names), axes_for(ax)
    if table.empty:
        return write_instead(ax, "exact filters have no effective sample size")
    for _, rows, style in sets:
        size = rows["effective_sample_size"].to_numpy()
        ax.plot(rows["t"], size, ms=marker(), lw=thin(), **style)
    sizes = table["effective_sample_size"]
    is_logarithmic = sizes.max() > _LINEAR * sizes.min()
    ax.set_yscale("log" if is_logarithmic else "linear")
    if particles is not None:
        ax.axhline(particles, color="black", ls=":", lw=thin(), label=f"{particles:,} particles")
    ax.set_ylim(bottom=float(is_logarithmic))  # last: the upper end no longer follows the lines
    ax.set_ylabel("effective sample size")
    label_times(ax, table)
    legend_above(ax)
    return ax


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
