"""Histogram of the relative gain of times that are chosen one after another."""

from matplotlib.axes import Axes

from pfdist.analysis import Run
from pfdist.analysis.online import OnlineDraws, online_draws
from pfdist.analysis.reference import label
from pfdist.plots.figure import Plot, Tables, figure, has_online
from pfdist.plots.gain_histogram import gain, title_of
from pfdist.plots.panel import check_kind


@figure("online_gain", applies=has_online)
def online_gain_figure(tables: Tables) -> Plot:
    """Histogram of the relative gain of online times; the plan's gain on the same draws."""
    draws = tables.online
    over_reference = draws.gain("online", draws.reference)
    title = title_of(over_reference, "online times", label(draws.reference))
    return Plot(2.9, lambda panels: online_gain(draws, ax=panels[0]), title=title)


def online_gain(source: Run | OnlineDraws, *, ax: Axes | None = None) -> Axes:
    """Draw the histogram of the relative gain of online times, and that of the plan.

    Parameters
    ----------
    source : Run or OnlineDraws
        A run with online times, or its draws that have them.
    ax : matplotlib Axes, optional
        By default those of a new figure.

    Returns
    -------
    matplotlib Axes

    Raises
    ------
    TypeError
        The source is neither a run nor its draws.
    """
    check_kind(source, (Run, OnlineDraws), "source")
    draws = online_draws(source) if isinstance(source, Run) else source
    online, plan = (draws.gain(name, draws.reference) for name in ("online", draws.plan))
    return gain(
        online, "online", reference=label(draws.reference), beside=(draws.plan, plan), ax=ax
    )
