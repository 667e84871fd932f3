"""Expected MSE against the number of measurements, of regular and of found times."""

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from pfdist.analysis import reaching
from pfdist.plots.style import BLUE, GREY, RED

_STYLES: dict[str, dict[str, Any]] = {
    "regular": {"color": BLUE, "ls": (0, (4, 1.5)), "marker": "o", "mfc": "white"},
    "found": {"color": RED, "ls": "-", "marker": "o", "mfc": RED},
}


def plot_budget(axes: Axes, table: pd.DataFrame, target: float | None = None) -> None:
    """Draw the expected MSE against N with its 95 % intervals.

    Parameters
    ----------
    axes : matplotlib Axes
    table : DataFrame
        As of `pfdist.analysis.Run.budget`.
    target : float, optional
        Where a line is drawn; the least N that reaches it is marked.
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
    axes.axhline(target, color=GREY, lw=0.8, ls=":", label=f"target {target:g}")
    for kind, its in reaching(table, target).items():
        least = its["measurements"]
        if least is not None:
            axes.axvline(least, color=_STYLES[kind]["color"], lw=0.7, ls=":")
            axes.annotate(
                f"{least}", (least, 0.0), (1.5, 2.0), xycoords=("data", "axes fraction"),
                textcoords="offset points", color=_STYLES[kind]["color"], fontsize=7,
            )  # fmt: skip
