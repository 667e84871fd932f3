"""The lower bound against the work of its proof, below the expected MSE of the found sets."""

import pandas as pd
from matplotlib.axes import Axes
from scipy import stats

from pfdist.analysis import Run
from pfdist.plots.figure import Plot, Tables, figure, one_number, write_instead
from pfdist.plots.style import GREY, SERIES

_TWO_SIDED = float(stats.norm.ppf(0.975))


def _is_proved(run: Run) -> bool:
    return one_number(run) and run.has("bound")


@figure("bound", applies=_is_proved)
def bound_figure(tables: Tables) -> Plot:
    """The lower bound against the work of its proof, below the expected MSE of the found sets.

    If there are several proofs, the figure shows the one with most particle-steps.
    """
    run = tables.run
    rows = run.bounds().sort_values(["compared_draws", "steps"], kind="stable")
    last = rows.iloc[-1]
    for key in ("window", "work", "memory", "particles"):
        rows = rows[rows[key] == last[key]]
    return Plot(2.6, lambda panels: plot_bound(panels[0], rows, run.names))


def plot_bound(axes: Axes, rows: pd.DataFrame, names: list[str]) -> None:
    """Draw the bound with its 95 % intervals, and the expected MSE of each found set as a line.

    Parameters
    ----------
    axes : matplotlib Axes
    rows : DataFrame
        As of `pfdist.analysis.Run.bounds`, of one relaxation and one number of particles.
    names : list of str
        Names of the compared sets, the reference first.
    """
    proved = rows[rows["bound"].notna() & (rows["name"] != names[0])]
    if proved.empty:
        write_instead(axes, "there is no lower bound of the found times")
        return
    proved = proved[proved["name"] == proved["name"].iloc[0]]  # all have as many measurements
    last = rows[rows["draws"] == rows["draws"].max()].set_index("name")
    for colour, name in zip(SERIES, names[1:], strict=False):
        cost = last.loc[name, "expected_mse"]
        axes.axhline(cost, color=colour, lw=0.9, label=f"expected MSE of {name}")
    steps = proved["steps"] / 1e9
    axes.errorbar(
        steps, proved["bound"], _TWO_SIDED * proved["bound_error"],
        color=GREY, marker="o", ms=3, lw=0.9, elinewidth=0.7, ls=(0, (4, 1.5)),
        label="lower bound (95 %)",
    )  # fmt: skip
    if steps.all():  # an exact bound takes none
        axes.set_xscale("log")
    axes.set_xticks(steps, [f"{value:.2g}" for value in steps])
    axes.set_xticks([], minor=True)
    axes.set_xlabel(r"particle-steps of the proof [$10^9$]")
    axes.set_ylabel("expected MSE")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
