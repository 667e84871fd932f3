"""Expected MSE against the number of measurements, of regular and of found times, and its bound."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from pfdist.analysis import Run, reaching
from pfdist.plots.figure import Plot, Tables, figure, several_numbers
from pfdist.plots.figures import save_plots
from pfdist.plots.style import BLUE, GREEN, GREY, RED

_STYLES: dict[str, dict[str, Any]] = {
    "regular": {"color": BLUE, "ls": (0, (4, 1.5)), "marker": "o", "mfc": "white"},
    "found": {"color": RED, "ls": "-", "marker": "o", "mfc": RED},
}


@figure("budget", applies=several_numbers)
def budget_figure(tables: Tables) -> Plot:
    """Expected MSE against the number of measurements, of regular and of found times."""
    return _plot(tables.run)


def draw_target(run: Run, target: float) -> list[Path]:
    """Draw which numbers of measurements reach a target, and which cannot, in a figure of its own.

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
    """Draw the expected MSE against N with its 95 % intervals, and the lower bound if there is one.

    Parameters
    ----------
    axes : matplotlib Axes
    table : DataFrame
        As of `pfdist.analysis.Run.budget`.
    target : float, optional
        An expected MSE, drawn as a line; the least N that reaches it is marked, and the largest N
        that is proved not to reach it.
    """
    for kind, style in _STYLES.items():
        rows = table[table["kind"] == kind]
        mean = rows["expected_mse"].to_numpy()
        errors = np.array([mean - rows["low"], rows["high"] - mean])
        axes.errorbar(
            rows["measurements"], mean, errors, lw=0.8, ms=2.4, mew=0.6, elinewidth=0.6,
            label=f"{kind} times", **style,
        )  # fmt: skip
    _draw_bound(axes, table[table["kind"] == "found"])
    axes.set_xlabel("number of measurements $N$")
    axes.set_ylabel("expected MSE")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    if target is not None:
        _mark(axes, table, target)
    handles, labels = axes.get_legend_handles_labels()
    curves = dict(zip(labels, handles, strict=True))
    first = sorted(curves, key=lambda label: not label.endswith("times"))  # the sort is stable
    axes.legend([curves[label] for label in first], first, loc="upper right", fontsize=8)


def _draw_bound(axes: Axes, found: pd.DataFrame) -> None:
    """Draw the lower bound of all times, shaded down to its one-sided limit."""
    if found["bound"].isna().all():
        return
    numbers = found["measurements"]
    axes.plot(numbers, found["bound"], color=GREEN, lw=0.9, label="lower bound (95 %)")
    axes.fill_between(
        numbers, found["bound_low"], found["bound"], color=GREEN, alpha=0.3, linewidth=0
    )


def _mark(axes: Axes, table: pd.DataFrame, target: float) -> None:
    """Draw a target, the least numbers that reach it, and the largest number that cannot."""
    axes.axhline(target, color=GREY, lw=0.8, ls=":", label=f"target {target:g}")
    axes.set_ylim(bottom=axes.get_ylim()[0])  # the lines below end at the target
    for kind, reached in reaching(table, target).items():
        least, impossible = reached["measurements"], reached.get("impossible")
        if least is not None:
            _mark_number(axes, least, target, f"{least}", "left", _STYLES[kind]["color"])
        if impossible is not None:
            _mark_number(axes, impossible, target, f"no {impossible}", "right", GREEN)


def _mark_number(axes: Axes, number: int, top: float, text: str, side: str, colour: str) -> None:
    """Draw a line at a number of measurements up to a height, and write a text beside the line.

    The argument `side` is the side of the text that touches the line.
    """
    axes.vlines(number, axes.get_ylim()[0], top, color=colour, lw=0.7, ls=":")
    axes.annotate(
        text, (number, 0.0), (1.5 if side == "left" else -1.5, 2.0), ha=side,
        xycoords=("data", "axes fraction"), textcoords="offset points", color=colour, fontsize=8,
    )  # fmt: skip
