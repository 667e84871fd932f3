"""The expected MSE of compared sets, and how far each set is from the best."""

import math
from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from pfdist.analysis import Run
from pfdist.analysis.pairs import told_ranks
from pfdist.plots.figure import Plot, Tables, figure
from pfdist.plots.panel import axes_for, marker, table_of, thin, verbatim, write_instead
from pfdist.plots.style import BLUE, GREY

_AXIS_INCHES, _ROW_INCHES = 0.6, 0.2
_MOST_ROWS = 40  # rows up to which a new figure grows


def _names_sets(run: Run) -> bool:
    return bool(run.named)


@figure("compared", applies=_names_sets)
def compared_figure(tables: Tables) -> Plot:
    """Expected MSE of each compared set, with the 95 % interval of its difference to the best."""
    ranks = tables.run.ranks()
    title = _title(ranks)
    return Plot(_height(ranks), lambda panels: comparison(ranks, ax=panels[0]), title=title)


def _height(ranks: pd.DataFrame) -> float:
    return _AXIS_INCHES + _ROW_INCHES * min(max(2, len(ranks)), _MOST_ROWS)


def _title(ranks: pd.DataFrame) -> str:
    best, *others = ranks.to_dict("records")
    rivals = [str(each["name"]) for each in others if each["best_rank"] == 1]
    if best["best_rank"] == best["worst_rank"]:
        return f"The times of {best['name']} are clearly the best of {len(ranks)} sets."
    if len(rivals) > 3:
        return f"{1 + len(rivals)} of {len(ranks)} sets may be the best."
    sets = ", ".join([str(best["name"]), *rivals])
    return f"Of {len(ranks)} sets, these may be the best: {sets}."


def comparison(ranks: Run | pd.DataFrame, *, ax: Axes | None = None) -> Axes:
    """Draw the expected MSE of each set, the best on top, and how far it is from the best.

    The bar of a set is the 95 % interval of the difference to the best set on the same draws. The
    numbers on the right are the ranks.

    Parameters
    ----------
    ranks : Run or DataFrame
        A run, or its table `pfdist.analysis.Run.ranks`.
    ax : matplotlib Axes, optional
        By default those of a new figure.

    Returns
    -------
    matplotlib Axes
    """
    table = table_of(ranks, "ranks", "ranks")
    ax = axes_for(ax, _height(table))
    least = table["expected_mse"].iloc[0]
    table = table[np.isfinite(table["difference"])]
    if table.empty or not np.isfinite(least):
        return write_instead(ax, "no expected MSE is known and finite")
    rows, at = np.arange(len(table)), least + table["difference"].to_numpy()
    bars = np.stack([table["difference"] - table["low"], table["high"] - table["difference"]])
    ax.axvline(least, color=GREY, lw=thin(0.6), ls=(0, (4, 1.5)), zorder=0)
    ax.errorbar(
        at, rows, xerr=np.nan_to_num(bars), color=BLUE, ls="", marker="o", ms=marker(0.9),
        elinewidth=thin(1.2), capsize=marker(0.5), capthick=thin(),
    )  # fmt: skip
    ax.set_ylim(len(table) - 0.5, -0.5)
    ranks_told = list(map(told_ranks, table["best_rank"], table["worst_rank"]))
    _label_rows(ax, [verbatim(name) for name in table["name"]])
    beside = ax.twinx()
    beside.set_ylim(ax.get_ylim())
    _label_rows(beside, ranks_told)
    beside.set_ylabel("rank")
    ax.set_xlabel("expected MSE (bars: 95 % of the difference to the best)")
    return ax


def _label_rows(ax: Axes, labels: Sequence[str]) -> None:
    """Label each row, or as many rows as have room."""
    step = math.ceil(len(labels) / _MOST_ROWS)
    ax.set_yticks(range(0, len(labels), step), labels[::step])
    ax.tick_params(axis="y", length=0)
