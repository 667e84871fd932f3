"""The expected error over time, the effective sample size, and draws that are degenerate."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from pfdist.plots.outliers import cut_outliers, points
from pfdist.plots.panel import (
    axes_for,
    check_kind,
    chosen,
    label_times,
    legend_above,
    marker,
    table_of,
    thin,
    verbatim,
    write_instead,
)
from pfdist.plots.style import set_style

BAND = 1.96  # standard errors in half of a 95 % interval
_LINEAR = 20  # largest ratio of two effective sample sizes on a linear axis


def error_profile(
    profile: object,
    names: Sequence[str] = (),
    *,
    draws: int | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw the expected error over time with its 95 % band, and the measurement times.

    Parameters
    ----------
    profile : DataFrame or object
        A table with the columns name, t, measured, error and standard_error, or an object that has
        it as ``profile``, such as the result of `pfdist.why`. The column weight, if there is one,
        weighs the mean that the legend tells.
    names : sequence of str
        Sets that are drawn, the reference first; by default all.
    draws : int, optional
        Number of draws behind the estimates, told in the legend; 0 if they are exact. By default
        that of the table's column of this name, if there is one.
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
    table, curves = table_of(profile, "profile", "profile"), []
    sets, ax = rows_of_sets(table, names), axes_for(ax)
    if table.empty:
        return write_instead(ax, "there is no table of errors over time")
    for name, rows, style in sets:
        t, error = rows["t"].to_numpy(), rows["error"].to_numpy()
        weights = rows["weight"].to_numpy() if "weight" in rows else np.ones(len(rows))
        counts = weights > 0  # an error of weight 0 may be unknown
        mean = np.average(error[counts], weights=weights[counts])
        half = BAND * rows["standard_error"].to_numpy()
        ax.fill_between(t, error - half, error + half, color=style["color"], alpha=0.2, lw=0)
        told = f"{verbatim(name)}, mean {mean:.4g}"
        measured = np.flatnonzero(rows["measured"])
        ax.plot(t, error, markevery=measured, ms=marker(0.9), lw=thin(0.9), label=told, **style)
        curves.append(points(t, error, style["color"], name))
    cut_outliers(ax, curves, zero=True)
    ax.set_ylabel("expected error $e(t)$")
    label_times(ax, table)
    if draws is None:
        draws = int(table["draws"].max()) if "draws" in table else 0
    drawn = f"on {draws:,} draws of their own; " if draws else ""
    legend_above(ax, title=f"{drawn}markers: measured there")
    return ax


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
        A table with the columns t and effective_sample_size, and name if there are several sets.
        Instants without a value are left out. Or an object that has it as ``profile``, such as the
        result of `pfdist.why`, or as ``table``, such as that of `pfdist.filter_measurements`.
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
    known = table_of(profile, "profile", "profile", "table").dropna(subset="effective_sample_size")
    sets, ax = rows_of_sets(known, names), axes_for(ax)
    if known.empty:
        return write_instead(ax, "exact filters have no effective sample size")
    for name, rows, style in sets:
        size = rows["effective_sample_size"].to_numpy()
        ax.plot(rows["t"], size, ms=marker(), lw=thin(), label=verbatim(name) or None, **style)
    sizes = known["effective_sample_size"]
    if sizes.max() > _LINEAR * sizes.min():
        ax.set_yscale("log")
        ax.set_ylim(bottom=1.0)
    else:
        ax.set_ylim(bottom=0.0)
    if particles is not None:
        ax.axhline(particles, color="black", ls=":", lw=thin(), label=f"{particles:,} particles")
    ax.set_ylabel("effective sample size")
    label_times(ax, known)
    legend_above(ax, columns=3)
    return ax


def degenerate_draws(profile: object, names: Sequence[str] = (), *, ax: Axes | None = None) -> Axes:
    """Draw the share of the draws that are degenerate by each instant.

    Parameters
    ----------
    profile : DataFrame or object
        A table with the columns name, t, draws and degenerate_draws (their number up to t), or an
        object that has it as ``profile``, such as the result of `pfdist.why`.
    names : sequence of str
        Sets that are drawn, the reference first; by default all.
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
    table = table_of(profile, "profile", "profile")
    known = table[table["draws"] > 0]
    sets, ax = rows_of_sets(known, names), axes_for(ax)
    if known.empty:
        return write_instead(ax, "exact filters have no degenerate draws")
    for name, rows, style in sets:
        share = 100 * rows["degenerate_draws"].to_numpy() / rows["draws"].to_numpy()
        told = f"{verbatim(name)}, in the end {share[-1]:.2g} %" if name else None
        ax.step(
            rows["t"], share, where="post", label=told, color=style["color"], ls=style["ls"],
            lw=thin(),
        )  # fmt: skip
    _, high = ax.get_ylim()
    ax.set_ylim(0, high if known["degenerate_draws"].any() else 1.0)
    ax.set_ylabel("degenerate draws [%]")
    label_times(ax, table)
    legend_above(ax)
    return ax


def rows_of_sets(
    table: pd.DataFrame, names: Sequence[str]
) -> list[tuple[str, pd.DataFrame, dict[str, Any]]]:
    """Give the name, the rows in order of time and the style of each set of a table.

    Parameters
    ----------
    table : DataFrame
        Without a column name it has one set, whose name is empty. An empty table has no set.
    names : sequence of str
        By default all sets. One name is a sequence of itself.

    Raises
    ------
    JobError
        The table has no set of this name.
    """
    check_kind(names, (Sequence,), "names")
    names = [names] if isinstance(names, str) else names
    if table.empty:
        return []
    if "name" not in table:
        return [("", table.sort_values("t"), set_style(1))]
    known = list(dict.fromkeys(map(str, table["name"])))
    shown = [chosen(name, known, "names") for name in names] or known
    return [
        (name, table[table["name"] == name].sort_values("t"), set_style(position))
        for position, name in enumerate(shown)
    ]
