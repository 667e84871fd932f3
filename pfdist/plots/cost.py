"""Cost against the number of evaluations (the paper's figure 2)."""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.axes import Axes

from pfdist.analysis import Run
from pfdist.analysis.reference import label
from pfdist.plots.figure import Plot, Tables, figure, one_number
from pfdist.plots.style import GREY, SERIES
from pfdist.search.methods import METHODS

_PANEL_INCHES = 1.9  # height of a panel without the legend above it
_LINE_INCHES = 0.15  # height of a line of a legend
_LONGEST_NAME = 22  # characters of a name with which a legend has room for two columns

Curve = Callable[[pd.DataFrame], pd.DataFrame]


@figure("cost", applies=one_number)
def cost_figure(tables: Tables) -> Plot:
    """Cost against the number of evaluations (the paper's figure 2).

    Costs of different estimators are not comparable, so each estimator has a panel. The reference
    is shown in the panel of the searches that estimate costs as the comparison does.
    """
    run = tables.run
    groups = _groups(run)
    reference = (label(run.names[0]), tables.statistics.mse[run.names[0]].mean)
    height = _PANEL_INCHES + max(map(legend_inches, groups.values()))
    draw = partial(_draw, run, groups, reference)
    return Plot(height * len(groups), draw, len(groups))


def _groups(run: Run) -> dict[str, list[str]]:
    """Names of the searches that estimate alike, by how they differ from the comparison."""
    groups: dict[str, list[str]] = {}
    for search in run.job["search"]:
        estimation = run.own_estimation(search["name"])
        if search.get("evaluation", {}).get("estimator") == "auto" and not run.knows_estimations:
            estimation["estimator"] = "unknown estimator"
        groups.setdefault(_difference(estimation), []).append(search["name"])
    return dict(sorted(groups.items()))


def _difference(estimation: dict[str, Any]) -> str:
    """Say how a search estimates costs otherwise than the comparison; empty if it does not."""
    particles = f"{estimation['particles']} particles" if "particles" in estimation else ""
    resampling = f"{estimation['resampling']} resampling" if "resampling" in estimation else ""
    estimator = str(estimation.get("estimator", ""))
    parts = (part.replace("_", " ") for part in (estimator, particles, resampling))
    return ", ".join(filter(None, parts))


def _draw(
    run: Run,
    groups: Mapping[str, list[str]],
    reference: tuple[str, float],
    panels: Sequence[Axes],
) -> None:
    methods = {search["name"]: search["method"] for search in run.job["search"]}
    evaluations = _shown_evaluations(run, list(methods))
    for axes, (difference, names) in zip(panels, groups.items(), strict=True):
        curves = {name: curve_of(methods[name]) for name in names}
        title = f"estimated otherwise than the comparison:\n{difference}" if difference else ""
        plot_cost(axes, evaluations, curves, None if difference else reference, title)


def _shown_evaluations(run: Run, searches: Collection[str]) -> pd.DataFrame:
    """Give the table of evaluations; of a search that was repeated, only the repetition."""
    evaluations = run.evaluations()
    if "end" not in evaluations:  # an older run, without prefixes
        evaluations = evaluations.assign(end=run.job["problem"]["horizon"])
    repeated = {f"{name}.again": name for name in searches if run.distrust(name)}
    evaluations = evaluations[~evaluations["phase"].isin(repeated.values())]
    return evaluations.assign(phase=evaluations["phase"].replace(repeated))


def plot_cost(
    axes: Axes,
    evaluations: pd.DataFrame,
    curves: Mapping[str, Curve],
    reference: tuple[str, float] | None,
    title: str = "",
) -> None:
    """Draw the costs that searches have reached against their numbers of evaluations.

    Parameters
    ----------
    axes : matplotlib Axes
    evaluations : DataFrame
        The table of that name.
    curves : mapping of str to callable
        A function of this module for each search, which gives the curves of the search. All
        searches estimate the expected MSE in the same way.
    reference : (str, float) or None
        Label and expected MSE of the reference, drawn as a line. None if the searches estimate
        otherwise than the comparison, because the costs are then not comparable.
    title : str
        Title of the legend.
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
    """Give the height of a panel's legend, at least 0.5 inches.

    Parameters
    ----------
    names : collection of str
        Names of the searches in the panel; each has at most two curves.
    """
    return max(0.5, _LINE_INCHES * math.ceil(2 * len(names) / _columns(names)))


def _columns(names: Collection[str]) -> int:
    """Number of columns of the legend."""
    return 2 if max(map(len, names)) <= _LONGEST_NAME else 1


def _colours(count: int) -> Sequence[Any]:
    """A colour for each search."""
    if count <= len(SERIES):
        return SERIES[:count]
    return [colormaps["turbo"](0.05 + 0.9 * number / (count - 1)) for number in range(count)]


def by_generation(rows: pd.DataFrame) -> pd.DataFrame:
    """Average and minimum of the finite costs of each generation (the paper's curves)."""
    alive = rows[np.isfinite(rows["expected_mse"])]
    total = (alive["expected_mse"] * alive["copies"]).groupby(alive["generation"]).sum()
    groups = alive.groupby("generation")
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
    """Least cost of each generation, for sets that grow or shrink by one time a generation."""
    curve = by_generation(rows)
    return pd.DataFrame({"best of a step": curve["minimum"]})


def best_so_far(rows: pd.DataFrame) -> pd.DataFrame:
    """Least cost of all complete sets so far that were evaluated on all draws.

    Prefixes, and sets that were evaluated on fewer draws, only count as evaluations.
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
    """Give the curves of a search method; those of generations if the method is unknown."""
    return _CURVES[METHODS[method].curve if method in METHODS else "generations"]
