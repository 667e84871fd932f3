"""The panel of effective sample sizes."""

from collections.abc import Sequence

from matplotlib.axes import Axes

from pfdist.pages.panel import (
    axes_for,
    label_times,
    legend_above,
    marker,
    rows_with_results,
    table_of,
    thin,
    write_instead,
)

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
