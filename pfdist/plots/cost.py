"""Cost against the number of evaluations (the paper's figure 2)."""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.axes import Axes

from pfdist.plots.style import GREY, SERIES
from pfdist.search.methods import METHODS

_LINE_INCHES = 0.15  # of a legend
_LONGEST_NAME = 22  # of which two, with the kinds of their curves, have room in a line

Curve = Callable[[pd.DataFrame], pd.DataFrame]


def plot_cost(
    axes: Axes,
    evaluations: pd.DataFrame,
    curves: Mapping[str, Curve],
    reference: tuple[str, float] | None,
    title: str = "",
) -> None:
    """Draw the cost that searches have come to against their numbers of evaluations.

    Parameters
    ----------
    axes : matplotlib Axes
    evaluations : DataFrame
        The table of that name.
    curves : mapping of str to callable
        By the name of a search, what is drawn of it: a function of this module. All of these
        searches estimate the expected MSE in the same way.
    reference : (str, float) or None
        What the reference is called and its expected MSE, for a line; None where the searches
        estimate otherwise than the comparison, so that their costs cannot be held against it.
    title : str
        How these searches estimate, if that is to be said.
    """
    styles = {"average": "-", "minimum": "--", "best so far": "--", "best of a step": "--"}
    for colour, (name, curve_of) in zip(_colours(len(curves)), curves.items(), strict=True):
        curve = curve_of(evaluations[evaluations["phase"] == name])
        for kind, costs in curve.items():
            label = f"{name}, {kind}"
            axes.plot(costs.index, costs, color=colour, ls=styles[str(kind)], label=label)
    if reference is not None:
        label, mse = reference
        axes.axhline(mse, color=GREY, lw=0.9, ls=":", label=label)
    axes.set_xlabel("number of cost function evaluations")
    axes.set_ylabel(r"$\hat{\mathbb{E}}_{\mathrm{MSE}}$" if reference else "estimated cost")
    axes.set_xlim(left=0)
    axes.legend(
        ncols=_columns(curves),
        loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
        borderaxespad=0.2,
        title=title or None,
        title_fontsize=7,
    )


def legend_inches(names: Collection[str]) -> float:
    """Give how high the legend of a panel with these searches is, at least 0.5 inches.

    Parameters
    ----------
    names : collection of str
        Of the searches, each of which has at most two curves.
    """
    return max(0.5, _LINE_INCHES * math.ceil(2 * len(names) / _columns(names)))


def _columns(names: Collection[str]) -> int:
    """How many columns of a legend have room beside each other."""
    return 2 if max(map(len, names)) <= _LONGEST_NAME else 1


def _colours(count: int) -> Sequence[Any]:
    """A colour for each search."""
    if count <= len(SERIES):
        return SERIES[:count]
    return [colormaps["turbo"](0.05 + 0.9 * number / (count - 1)) for number in range(count)]


def by_generation(rows: pd.DataFrame) -> pd.DataFrame:
    """Average and minimum of each generation's living (the paper's curves)."""
    living = rows[np.isfinite(rows["expected_mse"])]
    total = (living["expected_mse"] * living["copies"]).groupby(living["generation"]).sum()
    groups = living.groupby("generation")
    curve = pd.DataFrame(
        {"average": total / groups["copies"].sum(), "minimum": groups["expected_mse"].min()}
    )
    population = rows.groupby("generation")["copies"].sum().cumsum()
    return curve.set_index(population.reindex(curve.index))


def one_by_one(rows: pd.DataFrame) -> pd.DataFrame:
    """Average and minimum of all evaluations so far."""
    rows = rows.sort_values(["generation", "individual"])
    cost = rows["expected_mse"].where(np.isfinite(rows["expected_mse"]))
    curve = pd.DataFrame({"average": cost.expanding().mean(), "minimum": cost.cummin().ffill()})
    return curve.set_index(rows["copies"].cumsum())


def best_of_each_step(rows: pd.DataFrame) -> pd.DataFrame:
    """The least cost of each generation: of sets that grow, or shrink, by a time."""
    curve = by_generation(rows)
    return pd.DataFrame({"best of a step": curve["minimum"]})


def best_so_far(rows: pd.DataFrame) -> pd.DataFrame:
    """The least cost of all whole sets so far that were evaluated on all draws.

    Prefixes, and sets that were tried on fewer draws, count as evaluations alone.
    """
    rows = rows.sort_values(["generation", "individual"])
    whole = (rows["end"] == rows["end"].max()) & (rows["draws"] == rows["draws"].max())
    cost = rows["expected_mse"].where(whole & np.isfinite(rows["expected_mse"]))
    curve = pd.DataFrame({"best so far": cost.cummin().ffill()})
    return curve.set_index(rows["copies"].cumsum()).dropna()


_CURVES: dict[str, Curve] = {
    "generations": by_generation,
    "trials": one_by_one,
    "best so far": best_so_far,
    "best of a step": best_of_each_step,
}


def curve_of(method: str) -> Curve:
    """Give what is drawn of a search method; average and minimum of generations, if unknown."""
    return _CURVES[METHODS[method].curve if method in METHODS else "generations"]
