"""Cost against the number of evaluations (the paper's figure 2)."""

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import pandas as pd
from matplotlib import colormaps
from matplotlib.artist import Artist
from matplotlib.axes import Axes

from pfdist.analysis import Run
from pfdist.analysis.reference import label
from pfdist.errors import JobError
from pfdist.plots.cost_curves import curve_of
from pfdist.plots.figure import Plot, Tables, figure, one_number
from pfdist.plots.outliers import cut_outliers, points
from pfdist.plots.panel import (
    axes_for,
    check_kind,
    chosen,
    legend_above,
    marker,
    thin,
    verbatim,
)
from pfdist.plots.style import GREY, SERIES

_PANEL_INCHES = 1.9  # height of a panel without the legend above it
_LINE_INCHES = 0.15  # height of a line of a legend
_LONGEST_NAME = 22  # characters of a name with which a legend has room for two columns
_MARKERS = "osD^vPX<>*"
_DASHES = {"average": "-", "minimum": "--", "best so far": "--", "best of a step": "--"}


def _has_searches(run: Run) -> bool:
    return one_number(run) and bool(run.job["search"])


@figure("cost", applies=_has_searches)
def cost_figure(tables: Tables) -> Plot:
    """Cost against the number of evaluations (the paper's figure 2).

    Costs of different estimators are not comparable, so each estimator has a panel. The reference
    is shown in the panel of the searches that estimate costs as the comparison does.
    """
    run = tables.run
    groups, evaluations = groups_of(run), shown_evaluations(run)
    reference = (label(run.names[0]), tables.statistics.mse[run.names[0]].mean)
    height = _PANEL_INCHES + max(map(legend_inches, groups.values()))

    def draw(panels: Sequence[Axes]) -> None:
        for ax, (difference, names) in zip(panels, groups.items(), strict=True):
            line = None if difference else reference
            cost(evaluations, _methods(run, names), reference=line, title=_told(difference), ax=ax)

    return Plot(height * len(groups), draw, len(groups), title=_title(tables))


def _title(tables: Tables) -> str:
    run, mse = tables.run, tables.statistics.mse
    reference = run.names[0]
    best = min(run.found, key=lambda name: _known(mse[name].mean))
    cost_of_best, cost_of_reference = (f"{mse[name].mean:.4g}" for name in (best, reference))
    return (
        f"The times of {best} have an expected MSE of {cost_of_best} on fresh draws; "
        f"{label(reference)} have {cost_of_reference}."
    )


def _known(mse: float) -> float:
    return mse if math.isfinite(mse) else math.inf


def _told(difference: str) -> str:
    return f"estimated otherwise than the comparison:\n{difference}" if difference else ""


def _methods(run: Run, names: Collection[str]) -> dict[str, str]:
    methods = {search["name"]: search["method"] for search in run.job["search"]}
    return {name: methods[name] for name in names}


def groups_of(run: Run) -> dict[str, list[str]]:
    """Names of the searches that estimate alike, by how they differ from the comparison."""
    groups: dict[str, list[str]] = {}
    for search in run.job["search"]:
        estimation = run.own_estimation(search["name"])
        groups.setdefault(_difference(estimation), []).append(search["name"])
    return dict(sorted(groups.items()))


def _difference(estimation: dict[str, Any]) -> str:
    """Say how a search estimates costs otherwise than the comparison; empty if it does not."""
    particles = f"{estimation['particles']} particles" if "particles" in estimation else ""
    resampling = f"{estimation['resampling']} resampling" if "resampling" in estimation else ""
    estimator = str(estimation.get("estimator", ""))
    parts = (part.replace("_", " ") for part in (estimator, particles, resampling))
    return ", ".join(filter(None, parts))


def shown_evaluations(run: Run) -> pd.DataFrame:
    """Give the table of evaluations; of a search that was repeated, only the repetition."""
    evaluations = run.evaluations()
    names = [search["name"] for search in run.job["search"]]
    repeated = {f"{name}.again": name for name in names if run.distrust(name)}
    evaluations = evaluations[~evaluations["phase"].isin(repeated.values())]
    return evaluations.assign(phase=evaluations["phase"].replace(repeated))


def cost(
    evaluations: Run | pd.DataFrame,
    searches: Mapping[str, str] | Collection[str] = (),
    *,
    reference: tuple[str, float] | None = None,
    title: str = "",
    ax: Axes | None = None,
) -> Axes:
    """Draw the costs that searches have reached against their numbers of evaluations.

    Parameters
    ----------
    evaluations : Run or DataFrame
        A run, or the table of this name.
    searches : mapping of str to str, or names
        The searches to show: with a DataFrame the method of each search by its name. By default
        the searches of a run that estimate the expected MSE as the comparison does, or else those
        that estimate in another, common way. Costs of different estimators are not comparable.
    reference : (str, float), optional
        Label and expected MSE of the reference, drawn as a line; a run gives its own.
    title : str
        Title of the legend; a run says how these searches estimate, if not as the comparison.
    ax : matplotlib Axes, optional
        By default those of a new figure.

    Returns
    -------
    matplotlib Axes

    Raises
    ------
    JobError
        The run has no such search, or the searches estimate differently.
    TypeError
        The evaluations are neither a run nor a table.
    """
    check_kind(evaluations, (Run, pd.DataFrame), "evaluations")
    if isinstance(evaluations, Run):
        run, way, names = evaluations, *_alike(groups_of(evaluations), list(searches))
        searches, title = _methods(run, names), title or _told(way)
        if not way and reference is None and run.draws_compared and not run.has_budget:
            reference = (label(run.names[0]), run.statistics().mse[run.names[0]].mean)
        evaluations = shown_evaluations(run)
    methods = searches if isinstance(searches, Mapping) else dict.fromkeys(searches, "")
    methods = methods or dict.fromkeys(map(str, evaluations["phase"].unique()), "")
    ax = axes_for(ax)
    shown = []
    for position, (name, method) in enumerate(methods.items()):
        curve = curve_of(method)(evaluations[evaluations["phase"] == name])
        colour, shape = _colour(position, len(methods)), _MARKERS[position % len(_MARKERS)]
        start = 0.2 * position / len(methods)
        for kind, costs in curve.items():
            ax.plot(
                costs.index, costs, color=colour, ls=_DASHES[str(kind)],
                label=f"{verbatim(name)}, {kind}", marker=shape,
                markevery=(start, 0.2), ms=marker(0.9), mew=0,
            )  # fmt: skip
            shown.append(points(costs.index, costs, colour, f"{name} {kind}"))
    if reference is not None:
        told, mse = reference
        ax.axhline(mse, color=GREY, lw=thin(0.9), ls=":", label=verbatim(told))
    ax.set_xlabel("number of cost function evaluations")
    ax.set_ylabel(r"$\hat{\mathbb{E}}_{\mathrm{MSE}}$" if reference else "estimated cost")
    ax.set_xlim(left=0)
    cut_outliers(ax, shown, [] if reference is None else [reference[1]])
    legend_above(ax, _in_rows(ax), columns=_columns(methods), title=title)
    return ax


def _alike(groups: Mapping[str, list[str]], names: list[str]) -> tuple[str, list[str]]:
    """Give how some searches estimate, and their names; of no names, those of the first group."""
    way_of = {name: way for way, group in groups.items() for name in group}
    names = [chosen(name, way_of, "searches") for name in names] or next(iter(groups.values()))
    ways = {way_of[name] for name in names}
    if len(ways) > 1:
        told = "; ".join(f"{name}: {way_of[name] or 'as the comparison'}" for name in names)
        raise JobError(f"searches must estimate costs alike, got {told}", argument="searches")
    return ways.pop(), names


def _in_rows(ax: Axes) -> list[Artist]:
    """Order the legend's entries by columns, so that both curves of a search share a row."""
    handles = ax.get_legend_handles_labels()[0]
    curves = [handle for handle in handles if ", " in str(handle.get_label())]
    others = [handle for handle in handles if handle not in curves]
    names = [str(handle.get_label()).rpartition(",")[0] for handle in curves]
    if any(names.count(name) != 2 for name in names):
        return handles
    return [*curves[::2], *others, *curves[1::2]]


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


def _colour(position: int, count: int) -> Any:
    """Colour of a search; many searches take colours of rising lightness."""
    return SERIES[position] if count <= len(SERIES) else colormaps["viridis"](position / count)
