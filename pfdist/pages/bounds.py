"""The lower bound against the work of its proof."""

from typing import Any

import pandas as pd
from matplotlib.axes import Axes

from pfdist.common.percent import at_most, idle_bound
from pfdist.pages.figure import Plot, Tables, figure, one_number
from pfdist.pages.panel import (
    BAND,
    axes_for,
    label_ends,
    label_error,
    marker,
    styles_of,
    table_of,
    thin,
    write_instead,
)
from pfdist.problem.set_key import phrase_of
from pfdist.results import Run

_BOUND: dict[str, Any] = {"color": "black", "label": "lower bound"}


def _has_curve(run: Run) -> bool:
    """Whether the last proof of a run has several steps, so that its bound grows."""
    has_bound = one_number(run) and "bound" in run.tables
    return has_bound and len(_steps(_last_proof(run.table("bound")))) > 1


def _steps(rows: pd.DataFrame) -> pd.DataFrame:
    """The rows of a proof with the bound of found sets and its work; an exact bound takes none."""
    proved = rows[(rows["position"] > 0) & rows["bound"].notna() & (rows["steps"] > 0)]
    return proved[proved["name"] == proved["name"].head(1).squeeze()]  # all measure as often


@figure("bound", applies=_has_curve)
def bound_figure(tables: Tables) -> Plot:
    """The lower bound against the work of its proof, below the expected MSE of the found sets.

    If there are several proofs, the figure shows the one with most particle-steps.
    """
    rows, labels = table_of(tables.run, "run", "bound"), tables.run.labels
    last = _last_proof(rows)
    proved = last[(last["draws"] == last["draws"].max()) & (last["position"] > 0)]
    best = proved.loc[proved["gap_at_most"].idxmin()]
    mse = f"the expected MSE of {phrase_of(labels[best['name']])}, {best['expected_mse']:.4g}"
    title = idle_bound(best) or f"Proved: no other times lower {mse}, {at_most(best)}."
    return Plot(2.5, lambda panels: bound(rows, ax=panels[0]), title=title)


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
    proved = _steps(rows)
    if proved.empty:
        return write_instead(ax, "there is no lower bound that takes particle-steps")
    others = rows[rows["position"] > 0]  # than the reference
    last = others[others["draws"] == rows["draws"].max()].sort_values("position")
    styles, ends = styles_of(rows, rows.sort_values("position")["name"]), []
    for name, mse in zip(last["name"], last["expected_mse"], strict=True):
        look = {key: styles[name][key] for key in ("color", "ls", "label")}
        ax.axhline(mse, lw=thin(0.9), **look)
        ends.append((mse, look["label"], look["color"]))
    label_error(ax, rows)
    steps = proved["steps"] / 1e9
    ax.errorbar(
        steps, proved["bound"], BAND * proved["bound_error"],
        marker="o", ms=marker(), lw=thin(0.9), elinewidth=thin(), **_BOUND,
    )  # fmt: skip
    ax.set_xscale("log")
    ends_of_work = steps.iloc[[0, -1]]  # others may lie close together
    ax.set_xticks(ends_of_work, [f"{value:.2g}" for value in ends_of_work])
    ax.set_xticks([], minor=True)
    ax.set_xlabel(r"particle-steps of the proof [$10^9$]")
    label_ends(ax, [*ends, (proved["bound"].iloc[-1], "lower bound\n(95 %)", "black")])
    return ax
