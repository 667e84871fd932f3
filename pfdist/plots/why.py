"""The figures of `pfdist why`: the error over time, what each measurement is worth, the filters."""

from collections.abc import Sequence
from functools import partial

import pandas as pd
from matplotlib.axes import Axes

from pfdist.analysis import Run
from pfdist.analysis.reference import label
from pfdist.common.told_times import told_time
from pfdist.plots.error_over_time import degenerate_draws, effective_sample_size, error_profile
from pfdist.plots.figure import Plot, Tables, figure
from pfdist.plots.measurements import shifts, worth
from pfdist.plots.panel import stack

_MOST_SETS = 5  # in the figure of the filters


def _is_explained(run: Run) -> bool:
    return run.has("profile") and run.has("worth")


def _has_particles(run: Run) -> bool:
    return _is_explained(run) and bool(run.profile()["effective_sample_size"].notna().any())


@figure("why", applies=_is_explained, each_set=True)
def why_figure(tables: Tables, name: str) -> Plot:
    """Expected error over time, and its rise if a measurement is removed or shifted."""
    run = tables.run
    profile, measurements, names = run.profile(), run.worth(), (run.names[0], name)
    draw = partial(_draw, profile, measurements, names)
    return Plot(5.2, draw, panels=3, share_x=True, title=_title(measurements, names))


def _title(measurements: pd.DataFrame, names: tuple[str, str]) -> str:
    """Say which measurement is worth most."""
    rows = measurements[measurements["name"] == names[1]].dropna(subset="removed")
    if rows.empty:
        return f"{names[1]} measures nothing."
    most = rows.iloc[rows["removed"].argmax()]
    return (
        f"The measurement of {names[1]} at t = {told_time(most['t'])} is worth most: without it, "
        f"the expected MSE rises by {most['removed']:.3g}; {label(names[0])} are shown beside it."
    )


def _draw(
    profile: pd.DataFrame,
    measurements: pd.DataFrame,
    names: tuple[str, str],
    panels: Sequence[Axes],
) -> None:
    above, middle, below = panels
    of_both = measurements[measurements["name"].isin(names)]  # a set may measure nothing
    error_profile(profile, names, ax=above)
    worth(of_both, ax=middle)
    shifts(of_both, ax=below)
    for ax in (above, middle):
        ax.set_xlabel("")


@figure("filters", applies=_has_particles)
def filters_figure(tables: Tables) -> Plot:
    """Effective sample size of the filters over time, and degenerate draws if there are any."""
    run = tables.run
    profile, particles = run.profile(), run.job["filter"]["particles"]
    known = profile.dropna(subset="effective_sample_size")
    names = [name for name in run.names if name in set(known["name"])][:_MOST_SETS]
    known = known[known["name"].isin(names)]
    is_degenerate = bool(profile["degenerate_draws"].any())

    def draw(panels: Sequence[Axes]) -> None:
        effective_sample_size(known, particles=particles, ax=panels[0])
        if is_degenerate:
            degenerate_draws(profile, names, ax=panels[1])
            stack(panels)

    least = known.iloc[known["effective_sample_size"].argmin()]
    title = (
        f"The fewest particles count at t = {told_time(least['t'])} of {least['name']}: on average "
        f"{least['effective_sample_size']:.0f} of {particles}."
    )
    if is_degenerate:
        return Plot(3.4, draw, panels=2, share_x=True, title=title)
    return Plot(2.0, draw, title=f"{title} No draw is degenerate.")
