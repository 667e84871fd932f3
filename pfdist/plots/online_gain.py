"""Histogram of the relative gain of times that are chosen one after another."""

from collections.abc import Sequence

from matplotlib.axes import Axes

from pfdist.analysis.reference import label
from pfdist.plots.figure import Plot, Tables, figure, has_online, write_instead
from pfdist.plots.gain_histogram import plot_gain_histogram


@figure("online_gain", applies=has_online)
def online_gain_figure(tables: Tables) -> Plot:
    """Histogram of the relative gain of online times; the plan's gain on the same draws."""
    draws = tables.online
    gain, of_plan = (draws.gain(name, draws.reference) for name in ("online", draws.plan))

    def draw(panels: Sequence[Axes]) -> None:
        if gain.counts.any():
            beside = (draws.plan, of_plan) if of_plan.counts.any() else None
            plot_gain_histogram(panels[0], gain, "online", label(draws.reference), beside)
        else:
            write_instead(panels[0], "no draw has a finite gain")

    return Plot(2.9, draw)
