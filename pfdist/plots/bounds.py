"""The lower bound against the work of its proof, below the expected MSE of the found sets."""

from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from scipy import stats

from pfdist.analysis import Run
from pfdist.common.gap_sentence import rounded_up
from pfdist.common.rounding import rounded
from pfdist.plots.figure import Plot, Tables, figure, one_number
from pfdist.plots.panel import (
    axes_for,
    legend_above,
    marker,
    table_of,
    thin,
    verbatim,
    write_instead,
)
from pfdist.plots.style import GREY, SERIES

_DASHES = ("-", "-.", ":")
_TWO_SIDED = float(stats.norm.ppf(0.975))


def _is_proved(run: Run) -> bool:
    return one_number(run) and run.has("bound")


@figure("bound", applies=_is_proved)
def bound_figure(tables: Tables) -> Plot:
    """The lower bound against the work of its proof, below the expected MSE of the found sets.

    If there are several proofs, the figure shows the one with most particle-steps.
    """
    rows, names = tables.run.bounds(), tables.run.names
    return Plot(2.5, lambda panels: bound(rows, ax=panels[0]), title=_title(rows, names))


def _title(rows: pd.DataFrame, names: list[str]) -> str:
    last = _last_proof(rows)
    proved = last[(last["draws"] == last["draws"].max()) & (last["name"] != names[0])]
    gaps = proved["gap_at_most"].dropna()
    if gaps.empty:
        return "There is no lower bound of the found times."
    best = proved.loc[gaps.idxmin()]
    limit = rounded(100 * rounded_up(best["gap_at_most"]), 2)
    return (
        f"No other times lower the expected MSE of {best['name']}, {best['expected_mse']:.4g}, by "
        f"more than {limit} % ({100 * best['confidence']:g} %)."
    )


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
        A run whose lower bound was proved, or its table `pfdist.analysis.Run.bounds`.
    ax : matplotlib Axes, optional
        By default those of a new figure.

    Returns
    -------
    matplotlib Axes
    """
    rows, ax = table_of(rows, "rows", "bounds"), axes_for(ax)
    rows = _last_proof(rows) if len(rows) else rows
    found = rows[rows["position"] > 0]
    proved = found[found["bound"].notna()]
    if proved.empty:
        return write_instead(ax, "there is no lower bound of the found times")
    proved = proved[proved["name"] == proved["name"].iloc[0]]  # all have as many measurements
    last = found[found["draws"] == rows["draws"].max()].sort_values("position")
    for number, (name, mse) in enumerate(zip(last["name"], last["expected_mse"], strict=True)):
        style: dict[str, Any] = {"color": SERIES[number % len(SERIES)], "ls": _DASHES[number % 3]}
        ax.axhline(mse, lw=thin(0.9), label=f"expected MSE of {verbatim(name)}", **style)
    steps = proved["steps"] / 1e9
    ax.errorbar(
        steps, proved["bound"], _TWO_SIDED * proved["bound_error"],
        color=GREY, marker="o", ms=marker(), lw=thin(0.9), elinewidth=thin(), ls=(0, (4, 1.5)),
        label="lower bound (95 %)",
    )  # fmt: skip
    if steps.all():  # an exact bound takes none
        ax.set_xscale("log")
    ax.set_xticks(steps, [f"{value:.2g}" for value in steps])
    ax.set_xticks([], minor=True)
    ax.set_xlabel(r"particle-steps of the proof [$10^9$]")
    ax.set_ylabel("expected MSE")
    legend_above(ax)
    return ax
