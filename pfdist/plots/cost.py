"""Cost against the number of evaluations (the paper's figure 2)."""

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from pfdist.plots.style import GREY, SERIES


def plot_cost(axes: Axes, evaluations: pd.DataFrame, one_by_one: set[str], regular: float) -> None:
    """Draw average and minimum cost of every search against its number of evaluations.

    Parameters
    ----------
    axes : matplotlib Axes
    evaluations : DataFrame
        The table of that name.
    one_by_one : set of str
        Phases without populations: their average and minimum are those of all evaluations so far.
        The others' are those of each generation's living.
    regular : float
        Expected MSE of the regular times, for a line.
    """
    for colour, (phase, rows) in zip(SERIES * 9, evaluations.groupby("phase"), strict=False):
        curve = _running(rows) if phase in one_by_one else _by_generation(rows)
        axes.plot(curve.index, curve["average"], color=colour, label=f"{phase}, average")
        axes.plot(curve.index, curve["minimum"], color=colour, ls="--", label=f"{phase}, minimum")
    axes.axhline(regular, color=GREY, lw=0.9, ls=":", label="regular times")
    axes.set_xlabel("number of cost function evaluations")
    axes.set_ylabel(r"$\hat{\mathbb{E}}_{\mathrm{MSE}}$")
    axes.set_xlim(left=0)
    axes.legend(ncols=2, loc="upper center", bbox_to_anchor=(0.5, 1.3))


def _by_generation(rows: pd.DataFrame) -> pd.DataFrame:
    living = rows[np.isfinite(rows["expected_mse"])]
    total = (living["expected_mse"] * living["copies"]).groupby(living["generation"]).sum()
    groups = living.groupby("generation")
    curve = pd.DataFrame(
        {"average": total / groups["copies"].sum(), "minimum": groups["expected_mse"].min()}
    )
    population = rows.groupby("generation")["copies"].sum().cumsum()
    return curve.set_index(population.reindex(curve.index))


def _running(rows: pd.DataFrame) -> pd.DataFrame:
    rows = rows.sort_values(["generation", "individual"])
    cost = rows["expected_mse"].where(np.isfinite(rows["expected_mse"]))
    curve = pd.DataFrame({"average": cost.expanding().mean(), "minimum": cost.cummin().ffill()})
    return curve.set_index(rows["copies"].cumsum())
