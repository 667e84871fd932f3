"""The reach of a number of measurements: the budget curve, and the proof of a lower bound."""

from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from pfdist.common.percent import at_most
from pfdist.pages.figure import Plot, Tables, figure, one_number, save_plots
from pfdist.pages.panel import (
    BAND,
    axes_for,
    cut_outliers,
    legend_above,
    marker,
    points,
    styles_of,
    table_of,
    thin,
    verbatim,
    write_instead,
)
from pfdist.pages.style import GREEN, GREY, set_style
from pfdist.results import Run, reaching

_STYLES = {"regular": set_style(0), "found": set_style(1)}


@figure("budget", applies=lambda run: "budget" in run.job)
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
    table = run.table("sets")
    return Plot(
        2.5, lambda panels: budget(table, target=target, ax=panels[0]), title=_title(table, target)
    )


def _title(table: pd.DataFrame, target: float | None) -> str:
    """Say how many found times do what regular times do, or how many reach a target."""
    if target is not None:
        least = {kind: row["measurements"] for kind, row in reaching(table, target).items()}
        numbers = {kind: "no number of" if n is None else str(n) for kind, n in least.items()}
        times = "time" if least["found"] == 1 else "times"
        return (
            f"An expected MSE of {target:g} takes {numbers['found']} found {times}, or "
            f"{numbers['regular']} regular."
        )
    errors = table.pivot_table(index="measurements", columns="kind", values="expected_mse")
    both = errors.dropna()
    if both.empty:
        return "No number of measurements has an expected MSE with both kinds of times."
    lower = 1 - (both["found"] / both["regular"]).median()
    return (
        f"With {both.index[0]} to {both.index[-1]} measurements, found times have an expected MSE "
        f"{100 * abs(lower):.0f} % {'lower' if lower >= 0 else 'higher'} than regular times "
        "(median)."
    )


def budget(
    table: Run | pd.DataFrame, *, target: float | None = None, ax: Axes | None = None
) -> Axes:
    """Draw the expected MSE against N with its 95 % intervals, and the lower bound if there is one.

    Parameters
    ----------
    table : Run or DataFrame
        A run for several numbers of measurements, or its table ``sets``.
    target : float, optional
        An expected MSE, drawn as a line; the least N that reaches it is marked, and the largest N
        that is proved not to reach it.
    ax : matplotlib Axes, optional
        By default those of a new figure.

    Returns
    -------
    matplotlib Axes
    """
    table, ax, curves = table_of(table, "table", "sets"), axes_for(ax), []
    for kind, style in _STYLES.items():
        rows = table[table["kind"] == kind]
        mean = rows["expected_mse"].to_numpy()
        errors = np.array([mean - rows["expected_mse_low"], rows["expected_mse_high"] - mean])
        ax.errorbar(
            rows["measurements"], mean, errors, lw=thin(0.8), ms=marker(0.8), elinewidth=thin(0.6),
            label=f"{kind} times", **style,
        )  # fmt: skip
        curves.append(points(rows["measurements"], mean, style["color"], kind))
    rows = table[table["kind"] == "found"]
    if rows["bound"].notna().any():
        numbers, low, limit = rows["measurements"], rows["bound"], rows["bound_low"]
        ax.plot(numbers, low, color=GREEN, lw=thin(0.9), label="lower bound (95 %)")
        ax.fill_between(numbers, limit, low, color=GREEN, alpha=0.3, linewidth=0)
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


@figure("bound", applies=lambda run: one_number(run) and "bound" in run.tables)
def bound_figure(tables: Tables) -> Plot:
    """The lower bound against the work of its proof, below the expected MSE of the found sets.

    If there are several proofs, the figure shows the one with most particle-steps.
    """
    rows, names = tables.run.table("bound"), tables.run.names
    return Plot(2.5, lambda panels: bound(rows, ax=panels[0]), title=_title_of_proof(rows, names))


def _title_of_proof(rows: pd.DataFrame, names: list[str]) -> str:
    last = _last_proof(rows)
    proved = last[(last["draws"] == last["draws"].max()) & (last["name"] != names[0])]
    gaps = proved["gap_at_most"].dropna()
    if gaps.empty:
        return "There is no lower bound of the found times."
    best = proved.loc[gaps.idxmin()]
    mse = f"the expected MSE of {best['name']}, {best['expected_mse']:.4g}"
    return f"Proved: no other times lower {mse}, {at_most(best)}."


def _last_proof(rows: pd.DataFrame) -> pd.DataFrame:
    """Rows of the proof with most compared draws, then with most particle-steps."""
    rows = rows.sort_values(["compared_draws", "steps"], kind="stable")
    last = rows.iloc[-1]
    for key in ("window", "work", "memory", "particles"):
        rows = rows[rows[key] == last[key]]
    return rows


def bound(rows: Run | pd.DataFrame, *, ax: Axes | None = None) -> Axes:
    """Draw the bound with its 95 % intervals, and the expected MSE of each found set as a line.

    If there are several proofs, the one with most particle-steps is drawn.

    Parameters
    ----------
    rows : Run or DataFrame
        A run whose lower bound was proved, or its table ``bound``.
    ax : matplotlib Axes, optional
        By default those of a new figure.

    Returns
    -------
    matplotlib Axes
    """
    rows, ax = table_of(rows, "rows", "bound"), axes_for(ax)
    rows = _last_proof(rows) if len(rows) else rows
    others = rows[rows["position"] > 0]  # than the reference
    proved = others[others["bound"].notna()]
    if proved.empty:
        return write_instead(ax, "there is no lower bound of the found times")
    proved = proved[proved["name"] == proved["name"].iloc[0]]  # all have as many measurements
    last = others[others["draws"] == rows["draws"].max()].sort_values("position")
    styles = styles_of(rows, rows.sort_values("position")["name"])
    for name, mse in zip(last["name"], last["expected_mse"], strict=True):
        look = {key: styles[name][key] for key in ("color", "ls")}
        ax.axhline(mse, lw=thin(0.9), label=f"expected MSE of {verbatim(name)}", **look)
    ax.set_ylabel("expected MSE")
    steps = proved["steps"] / 1e9
    if len(steps) == 1 or not steps.all():  # an exact bound takes none
        best = proved.loc[proved["bound"].idxmax()]
        value, half = best["bound"], BAND * best["bound_error"]
        text = f"lower bound ({'band: 95 %' if half else 'exact'})"
        ax.axhspan(value - half, value + half, color=GREY, alpha=0.2, lw=0)
        ax.axhline(value, color=GREY, ls=(0, (4, 1.5)), label=text)
        ax.set_xticks([])
        legend_above(ax)
        return ax
    ax.errorbar(
        steps, proved["bound"], BAND * proved["bound_error"],
        color=GREY, marker="o", ms=marker(), lw=thin(0.9), elinewidth=thin(), ls=(0, (4, 1.5)),
        label="lower bound (95 %)",
    )  # fmt: skip
    ax.set_xscale("log")
    ax.set_xticks(steps, [f"{value:.2g}" for value in steps])
    ax.set_xticks([], minor=True)
    ax.set_xlabel(r"particle-steps of the proof [$10^9$]")
    legend_above(ax)
    return ax
