"""The expected error over time, and the effective sample size of the filters (`pfdist why`)."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from pfdist.pages.figure import Plot, Tables, figure
from pfdist.pages.measurements import worth
from pfdist.pages.panel import (
    BAND,
    axes_for,
    check_kind,
    clock_of_table,
    cut_outliers,
    label_error,
    label_times,
    legend_above,
    marker,
    points,
    rows_with_results,
    stack,
    table_of,
    thin,
    write_instead,
)
from pfdist.pages.style import set_style
from pfdist.problem.set_key import phrase_of
from pfdist.results import Run
from pfdist.results.particle_loss import SMALL, SMALL_AT_MOST

_MOST_SETS = 5  # in the figure of the filters
_LINEAR = 20  # largest ratio of two effective sample sizes on a linear axis


def _is_explained(run: Run) -> bool:
    return "profile" in run.tables and "worth" in run.tables


def _has_particles(run: Run) -> bool:
    return _is_explained(run) and bool(run.table("profile")["effective_sample_size"].notna().any())


@figure("why", applies=_is_explained, each_set=True)
def why_figure(tables: Tables, name: str) -> Plot:
    """Expected error of a set over time, and its rise if a measurement is left out."""
    run = tables.run
    profile, measurements = (table_of(run, "run", table) for table in ("profile", "worth"))
    of_set = measurements[measurements["name"] == name]  # it may measure nothing

    def draw(panels: Sequence[Axes]) -> None:
        error_profile(profile, [name], ax=panels[0])
        worth(of_set, ax=panels[1])
        stack(panels)

    mean = _mean_error(profile[profile["name"] == name])
    return Plot(4.0, draw, panels=2, share_x=True, title=_title(of_set, mean, run.labels[name]))


def _title(measurements: pd.DataFrame, mean: float, label: str) -> str:
    """Say which measurement is worth most, and which least."""
    rows = measurements.dropna(subset="removed").sort_values("removed").to_dict("records")
    clock = clock_of_table(measurements)
    if not rows:
        return f"There is no measurement of {phrase_of(label)}."
    least, most = (
        f"t = {clock.text(clock.of_row(row))} ({100 * row['removed'] / mean:.3g} %)"
        for row in (rows[0], rows[-1])
    )
    return (
        f"Most important measurement of {phrase_of(label)}: {most}; least important: {least}. The "
        "expected MSE rises by so much without it."
    )


def _mean_error(rows: pd.DataFrame) -> float:
    """The mean over time of an error profile, weighted as the MSE is."""
    error = rows["error"].to_numpy()
    weights = rows["weight"].to_numpy() if "weight" in rows else np.ones(len(rows))
    counts = weights > 0  # an error of weight 0 may be unknown
    return float(np.average(error[counts], weights=weights[counts]))


@figure("filters", applies=_has_particles)
def filters_figure(tables: Tables) -> Plot:
    """Effective sample size of the filters over time, and degenerate draws if there are any."""
    run = tables.run
    profile, particles = table_of(run, "run", "profile"), run.job["filter"]["particles"]
    sizes = profile.dropna(subset="effective_sample_size")
    names = [name for name in run.names if name in set(sizes["name"])][:_MOST_SETS]
    sizes = sizes[sizes["name"].isin(names)]
    is_degenerate = bool(profile["degenerate_draws"].any())

    def draw(panels: Sequence[Axes]) -> None:
        effective_sample_size(sizes, particles=particles, ax=panels[0])
        if is_degenerate:
            degenerate_draws(profile, names, ax=panels[1])
            stack(panels)

    least = sizes.iloc[sizes["effective_sample_size"].argmin()]
    at = clock_of_table(profile).text(least["t"])
    title = (
        f"The effective sample size is least at t = {at} with "
        f"{phrase_of(run.labels[least['name']])}: on average "
        f"{least['effective_sample_size']:.0f} of {particles} particles."
    )
    if is_degenerate:
        return Plot(3.4, draw, panels=2, share_x=True, title=title)
    return Plot(2.0, draw, title=f"{title} No draw is degenerate.")


def error_profile(profile: object, names: Sequence[str] = (), *, ax: Axes | None = None) -> Axes:
    """Draw the expected error over time with its 95 % band, and the measurement times.

    Parameters
    ----------
    profile : DataFrame or object
        A table with the columns name, t, measured, error and standard_error; or an object whose
        ``profile`` it is, such as the result of `pfdist.why`. The column weight, if there is one,
        weighs the mean in the legend, which also shows the column draws.
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
    table, curves = table_of(profile, "profile", "profile"), []
    sets, ax = rows_with_results(table, names), axes_for(ax)
    if table.empty:
        return write_instead(ax, "there is no table of errors over time")
    for _, rows, style in sets:
        t, error = rows["t"].to_numpy(), rows["error"].to_numpy()
        label = f"{style['label'] or ''}, mean {_mean_error(rows):.4g}".removeprefix(", ")
        half = BAND * rows["standard_error"].to_numpy()
        ax.fill_between(t, error - half, error + half, color=style["color"], alpha=0.2, lw=0)
        ax.plot(
            t, error, markevery=np.flatnonzero(rows["measured"]), ms=marker(0.9), lw=thin(0.9),
            **(style | {"label": label}),
        )  # fmt: skip
        curves.append(points(t, error, style["color"], style["label"] or ""))
    cut_outliers(ax, curves, zero=True)
    label_error(ax, table, "expected error $e(t)$")
    label_times(ax, table)
    draws = int(table["draws"].max()) if "draws" in table else 0
    drawn = f"{draws:,} draws; " if draws else ""
    legend_above(ax, title=f"{drawn}band: 95 % confidence\nmarkers: measured there")
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


def degenerate_draws(profile: object, names: Sequence[str] = (), *, ax: Axes | None = None) -> Axes:
    """Draw the share of the draws that are degenerate by each instant.

    Parameters
    ----------
    profile : DataFrame or object
        A table with the columns name, t, draws and degenerate_draws (their number up to t); or an
        object whose ``profile`` it is, such as the result of `pfdist.why`.
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
    table = table[table["draws"] > 0]
    sets, ax = rows_with_results(table, names), axes_for(ax)
    if table.empty:
        return write_instead(ax, "exact filters have no degenerate draws")
    for _, rows, style in sets:
        share = 100 * rows["degenerate_draws"].to_numpy() / rows["draws"].to_numpy()
        ax.step(
            rows["t"], share, where="post", color=style["color"], ls=style["ls"], lw=thin(),
            label=style["label"] and f"{style['label']}, in the end {share[-1]:.2g} %",
        )  # fmt: skip
    ax.set_ylim(0, ax.get_ylim()[1] if table["degenerate_draws"].any() else 1.0)
    ax.set_ylabel("degenerate draws [%]")
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
