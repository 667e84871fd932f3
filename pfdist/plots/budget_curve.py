"""Expected MSE against the number of measurements, of regular and of found times, and its bound."""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from pfdist.analysis import Run, reaching
from pfdist.plots.figure import Plot, Tables, figure, several_numbers
from pfdist.plots.figures import save_plots
from pfdist.plots.outliers import cut_outliers, points
from pfdist.plots.panel import axes_for, legend_above, marker, table_of, thin
from pfdist.plots.style import GREEN, GREY, set_style

_STYLES = {"regular": set_style(0), "found": set_style(1)}


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
    return Plot(
        2.5, lambda panels: budget(table, target=target, ax=panels[0]), title=_title(table, target)
    )


def _title(table: pd.DataFrame, target: float | None) -> str:
    """Say how many found times do what regular times do, or how many reach a target."""
    if target is not None:
        least = {kind: found["measurements"] for kind, found in reaching(table, target).items()}
        found, regular = (_numeral(least[kind]) for kind in ("found", "regular"))
        times = "time" if found == "1" else "times"
        return f"An expected MSE of {target:g} takes {found} found {times}, or {regular} regular."
    costs = table.pivot_table(index="measurements", columns="kind", values="expected_mse")
    both = costs.dropna()
    if both.empty:
        return "No number of measurements has an expected MSE with both kinds of times."
    lower = 1 - (both["found"] / both["regular"]).median()
    return (
        f"With {both.index[0]} to {both.index[-1]} measurements, found times have an expected MSE "
        f"{_percent(abs(lower))} {'lower' if lower >= 0 else 'higher'} than regular times (median)."
    )


def _numeral(number: int | None) -> str:
    return "no number of" if number is None else str(number)


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def budget(
    table: Run | pd.DataFrame, *, target: float | None = None, ax: Axes | None = None
) -> Axes:
    """Draw the expected MSE against N with its 95 % intervals, and the lower bound if there is one.

    Parameters
    ----------
    table : Run or DataFrame
        A run for several numbers of measurements, or its table `pfdist.analysis.Run.budget`.
    target : float, optional
        An expected MSE, drawn as a line; the least N that reaches it is marked, and the largest N
        that is proved not to reach it.
    ax : matplotlib Axes, optional
        By default those of a new figure.

    Returns
    -------
    matplotlib Axes

    Raises
    ------
    StoreError
        The run has times of one number of measurements alone.
    """
    table, ax, curves = table_of(table, "table", "budget"), axes_for(ax), []
    for kind, style in _STYLES.items():
        rows = table[table["kind"] == kind]
        mean = rows["expected_mse"].to_numpy()
        errors = np.array([mean - rows["low"], rows["high"] - mean])
        ax.errorbar(
            rows["measurements"], mean, errors, lw=thin(0.8), ms=marker(0.8), elinewidth=thin(0.6),
            label=f"{kind} times", **style,
        )  # fmt: skip
        curves.append(points(rows["measurements"], mean, style["color"], kind))
    _draw_bound(ax, table[table["kind"] == "found"])
    ax.set_xlabel("number of measurements $N$")
    ax.set_ylabel("expected MSE")
    ax.xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
    cut_outliers(ax, curves, [] if target is None else [target])
    if target is not None:
        _mark(ax, table, target)
    handles = ax.get_legend_handles_labels()[0]  # the sort is stable
    first = sorted(handles, key=lambda handle: not str(handle.get_label()).endswith("times"))
    legend_above(ax, first, columns=2)
    return ax


def _draw_bound(ax: Axes, found: pd.DataFrame) -> None:
    """Draw the lower bound of all times, shaded down to its one-sided limit."""
    if found["bound"].isna().all():
        return
    numbers = found["measurements"]
    ax.plot(
        numbers, found["bound"], color=GREEN, lw=thin(0.9),
        label="lower bound (95 %)",
    )  # fmt: skip
    ax.fill_between(
        numbers, found["bound_low"], found["bound"], color=GREEN, alpha=0.3, linewidth=0
    )


def _mark(ax: Axes, table: pd.DataFrame, target: float) -> None:
    """Draw a target, the least numbers that reach it, and the largest number that cannot."""
    ax.axhline(target, color=GREY, lw=thin(0.8), ls=":", label=f"target {target:g}")
    ax.set_ylim(bottom=ax.get_ylim()[0])  # the lines below end at the target
    for kind, reached in reaching(table, target).items():
        least, impossible = reached["measurements"], reached.get("impossible")
        if least is not None:
            _mark_number(ax, least, target, f"{least}", "left", _STYLES[kind]["color"])
        if impossible is not None:
            _mark_number(ax, impossible, target, f"no {impossible}", "right", GREEN)


def _mark_number(ax: Axes, number: int, top: float, text: str, side: str, colour: str) -> None:
    """Draw a line at a number of measurements up to a height, and write a text beside the line.

    The argument `side` is the side of the text that touches the line.
    """
    ax.vlines(number, ax.get_ylim()[0], top, color=colour, lw=thin(), ls=":")
    ax.annotate(
        text, (number, 0.0), (1.5 if side == "left" else -1.5, 2.0), ha=side,
        xycoords=("data", "axes fraction"), textcoords="offset points", color=colour,
        fontsize="small",
    )  # fmt: skip
