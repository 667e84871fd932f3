"""Expected MSE against the number of measurements, of regular and of found times."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from pfdist.analysis import Run, reaching
from pfdist.plots.figure import Plot, Tables, figure, several_numbers
from pfdist.plots.figures import save_plots
from pfdist.plots.style import BLUE, GREY, RED

_STYLES: dict[str, dict[str, Any]] = {
    "regular": {"color": BLUE, "ls": (0, (4, 1.5)), "marker": "o", "mfc": "white"},
    "found": {"color": RED, "ls": "-", "marker": "o", "mfc": RED},
}


@figure("budget", applies=several_numbers)
def budget_figure(tables: Tables) -> Plot:
    """Expected MSE against the number of measurements, of regular and of found times."""
    return _plot(tables.run)


def draw_target(run: Run, target: float) -> list[Path]:
    """Draw the least numbers of measurements that reach a target, beside the other figures.

    Parameters
    ----------
    run : Run
        A run for several numbers of measurements.
    target : float
        An expected MSE.

    Returns
    -------
    list of Path
        The files written.
    """
    return save_plots(run, [(f"budget-target-{target:g}", _plot(run, target))])


def _plot(run: Run, target: float | None = None) -> Plot:
    table = run.budget()
    return Plot(2.6, lambda panels: plot_budget(panels[0], table, target))


def plot_budget(axes: Axes, table: pd.DataFrame, target: float | None = None) -> None:
    """Draw the expected MSE against N with its 95 % intervals.

    Parameters
    ----------
    axes : matplotlib Axes
    table : DataFrame
        As of `pfdist.analysis.Run.budget`.
    target : float, optional
        An expected MSE, drawn as a line; the least N that reaches it is marked.
    """
    for kind, style in _STYLES.items():
        rows = table[table["kind"] == kind]
        mean = rows["expected_mse"].to_numpy()
        errors = np.array([mean - rows["low"], rows["high"] - mean])
        axes.errorbar(
            rows["measurements"], mean, errors, lw=0.8, ms=2.4, mew=0.6, elinewidth=0.6,
            label=f"{kind} times", **style,
        )  # fmt: skip
    axes.set_xlabel("number of measurements $N$")
    axes.set_ylabel("expected MSE")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    if target is not None:
        _mark(axes, table, target)
    axes.legend(loc="upper right")


def _mark(axes: Axes, table: pd.DataFrame, target: float) -> None:
    """Draw a target, and mark the least number of measurements that reaches it."""
    axes.axhline(target, color=GREY, lw=0.8, ls=":", label=f"target {target:g}")
    for kind, reached in reaching(table, target).items():
        least = reached["measurements"]
        if least is not None:
            axes.axvline(least, color=_STYLES[kind]["color"], lw=0.7, ls=":")
            axes.annotate(
                f"{least}", (least, 0.0), (1.5, 2.0), xycoords=("data", "axes fraction"),
                textcoords="offset points", color=_STYLES[kind]["color"], fontsize=7,
            )  # fmt: skip
