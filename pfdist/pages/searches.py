"""How close each search came to the best (the paper's figure 2), and how sets compare."""

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, SymmetricalLogLocator

from pfdist.pages.figure import Plot, Tables, figure, one_number
from pfdist.pages.panel import (
    axes_for,
    check_kind,
    chosen,
    height_of_rows,
    label_error,
    legend_above,
    marker,
    minus,
    styles_of,
    table_of,
    thin,
    verbatim,
    write_instead,
)
from pfdist.pages.style import GREY
from pfdist.problem.added_sections import has_amounts
from pfdist.problem.methods import METHODS
from pfdist.problem.set_key import phrase_of
from pfdist.results import ComparisonStatistics, Run
from pfdist.results.stored_run import named_sets, own_estimation, statistics_of

_PANEL, _LEGEND_LINE = 1.9, 0.15  # inches of a panel without its legend, and of a legend's line
_LONGEST_NAME = 12  # characters of a name with which the legend has two columns
_ROW, _MOST_ROWS = 0.2, 40  # inches of a row of the comparison; rows up to which a figure grows
_MARKERS = "osD^vPX<>*"
_LINEAR = 10.0  # per cent, up to which the axis of errors is linear
_Curve = Callable[[pd.DataFrame], pd.DataFrame]


def _by_generation(rows: pd.DataFrame) -> pd.DataFrame:
    """Average and minimum of the finite errors of each generation (the paper's curves)."""
    alive = rows[np.isfinite(rows["expected_mse"])]
    total = (alive["expected_mse"] * alive["copies"]).groupby(alive["generation"]).sum()
    groups = alive.groupby("generation")
    curve = pd.DataFrame(
        {"average": total / groups["copies"].sum(), "minimum": groups["expected_mse"].min()}
    )
    population = rows.groupby("generation")["copies"].sum().cumsum()
    return curve.set_index(population.reindex(curve.index))


def _one_by_one(rows: pd.DataFrame) -> pd.DataFrame:
    """Average and minimum of all evaluations so far."""
    rows = rows.sort_values(["generation", "individual"])
    mse = rows["expected_mse"].where(np.isfinite(rows["expected_mse"]))
    curve = pd.DataFrame({"average": mse.expanding().mean(), "minimum": mse.cummin().ffill()})
    return curve.set_index(rows["copies"].cumsum())


def _best_so_far(rows: pd.DataFrame) -> pd.DataFrame:
    """Least error of all complete sets so far that were evaluated on all draws.

    Prefixes, and sets that were evaluated on fewer draws, only count as evaluations.
    """
    rows = rows.sort_values(["generation", "individual"])
    whole = (rows["end"] == rows["end"].max()) & (rows["draws"] == rows["draws"].max())
    mse = rows["expected_mse"].where(whole & np.isfinite(rows["expected_mse"]))
    curve = pd.DataFrame({"best so far": mse.cummin().ffill()})
    return curve.set_index(rows["copies"].cumsum()).dropna()


_CURVES: dict[str, _Curve] = {
    "generations": _by_generation,
    "trials": _one_by_one,
    "best so far": _best_so_far,
}


def curve_of(method: str) -> _Curve:
    """The curves of a search method; those of generations if the method is unknown."""
    return _CURVES[METHODS[method].curve if method in METHODS else "generations"]


@figure("searches", applies=lambda run: one_number(run) and len(run.job["search"]) > 1)
def searches_figure(tables: Tables) -> Plot:
    """Estimated error against the number of evaluations, relative to the best (paper, figure 2).

    The errors of searches that estimate as the comparison does are relative to the least expected
    MSE on fresh draws, and the reference is shown. The errors of others, which may have fewer
    particles and estimate by their variance, are relative to their own least error.
    """
    run, evaluations = tables.run, tables.run.table("evaluations")
    ways, lines = ways_of(run), _on_fresh_draws(run, tables.statistics)
    methods = _methods(run)

    def draw(panels: Sequence[Axes]) -> None:
        searches(evaluations, methods, ways=ways, **lines, ax=panels[0])

    height = _PANEL + legend_inches(_labels(methods, ways))
    return Plot(height, draw, title="How close each search came to its best after how many sets.")


def _on_fresh_draws(run: Run, statistics: ComparisonStatistics) -> dict[str, tuple[str, float]]:
    """The reference and the best set, each with its expected MSE, as `searches` takes them."""
    mse = {name: float(np.nan_to_num(statistics.mse[name].mean, nan=np.inf)) for name in run.names}
    reference, best = run.names[0], min(mse, key=lambda name: mse[name])
    return {
        "reference": (phrase_of(run.labels[reference]), mse[reference]),
        "best": (phrase_of(run.labels[best]), mse[best]),
    }


def _methods(run: Run) -> dict[str, str]:
    return {search["name"]: search["method"] for search in run.job["search"]}


def ways_of(run: Run) -> dict[str, str]:
    """How each search estimates, if not as the comparison does."""
    ways = dict[str, str]()
    for search in run.job["search"]:
        own = own_estimation(run, search["name"])
        parts = [str(own.get("estimator", ""))]
        parts += [f"{own[key]} {key}" for key in ("particles", "resampling") if key in own]
        ways[search["name"]] = ", ".join(part.replace("_", " ") for part in parts if part)
    return ways


def _labels(names: Collection[str], ways: Mapping[str, str]) -> list[str]:
    return [f"{name}: {ways[name]}" if ways.get(name) else name for name in names]


def searches(
    evaluations: Run | pd.DataFrame,
    names: Mapping[str, str] | Collection[str] = (),
    *,
    ways: Mapping[str, str] | None = None,
    reference: tuple[str, float] | None = None,
    best: tuple[str, float] | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Draw how far estimated errors lie above the best, against the number of evaluations.

    The difference is in per cent. If one exceeds 10 %, the axis is logarithmic except near 0, so
    that differences of 1 % are seen beside those of 100 %.

    Parameters
    ----------
    evaluations : Run or DataFrame
        A run, or the table of this name.
    names : mapping of str to str, or collection of str
        The searches to show, by default all; with a DataFrame the method of each by its name.
    ways : mapping of str to str, optional
        How searches estimate, if not as the comparison does; a run has its own. Their errors are
        relative to the least of the searches that estimate alike.
    reference : (str, float), optional
        Label and expected MSE of the reference, drawn as a line; a run has its own.
    best : (str, float), optional
        Label and expected MSE of the set to which errors are relative: that of a run with the
        least expected MSE on fresh draws. By default it is the least that is drawn.
    ax : matplotlib Axes, optional
        By default those of a new figure.

    Returns
    -------
    matplotlib Axes

    Raises
    ------
    JobError
        The run has no such search.
    TypeError
        The evaluations are neither a run nor a table.
    """
    check_kind(evaluations, (Run, pd.DataFrame), "evaluations")
    if isinstance(evaluations, Run):
        run, ways = evaluations, ways_of(evaluations)
        own = _methods(run)
        names = {name: own[chosen(name, own, "searches")] for name in names or own}
        if run.draws_compared and not has_amounts(run.job):
            lines = _on_fresh_draws(run, statistics_of(run))
            reference, best = reference or lines["reference"], best or lines["best"]
        evaluations = run.table("evaluations")
    methods = names if isinstance(names, Mapping) else dict.fromkeys(names, "")
    methods = methods or dict.fromkeys(map(str, evaluations["phase"].unique()), "")
    curves = {
        name: curve_of(method)(evaluations[evaluations["phase"] == name])
        for name, method in methods.items()
    }
    ax, ways = axes_for(ax), ways or {}
    best = best if best is not None and 0 < best[1] < math.inf else None
    least = _least(curves, ways) | ({} if best is None else {"": best[1]})
    if not any(0 < each < math.inf for each in least.values()):
        return write_instead(ax, "no search has a finite error other than 0")
    differences = []
    styles = styles_of(evaluations, ["", *curves])  # none has that of the reference
    colours = {name: styles[name]["color"] for name in curves}
    if len({*colours.values()}) < len(curves):  # only a palette has so many colours
        colours = {name: colormaps["viridis"](k / len(curves)) for k, name in enumerate(curves)}
    handles, kinds = [], dict[str, str]()
    labels = dict(zip(curves, _labels(curves, ways), strict=True))
    for position, (name, curve) in enumerate(curves.items()):
        base = least[ways.get(name, "")]
        look = {"color": colours[name], "marker": _MARKERS[position % len(_MARKERS)], "mew": 0}
        handles.append(Line2D([], [], label=verbatim(labels[name]), ms=marker(0.9), **look))
        for kind, errors in curve.items():
            above = 100 * (errors / base - 1)
            differences += above.dropna().tolist()
            dashes = "-" if kind == "average" else "--"
            kinds["solid" if kind == "average" else "dashed"] = str(kind)
            ax.plot(
                above.index, above, ls=dashes, label=f"{verbatim(name)}, {kind}",
                markevery=(0.2 * position / len(curves), 0.2), ms=marker(0.9), **look,
            )  # fmt: skip
    by_label = {phrase_of(style["label"]): style["color"] for style in styles.values()}
    for line, dashes in ((best, "-"), (None if best == reference else reference, ":")):
        if line is not None and math.isfinite(line[1]) and 0 < least.get("", 0.0) < math.inf:
            text = verbatim(f"{line[0]}: {line[1]:.4g}")
            differences.append(100 * (line[1] / least[""] - 1))
            colour = by_label.get(line[0], GREY)
            line_at = differences[-1]
            handles.append(ax.axhline(line_at, color=colour, lw=thin(0.9), ls=dashes, label=text))
    _scale(ax, np.array(differences))
    ax.set_xlabel("number of evaluated sets")
    lowest = "the lowest one" if best is None else "lowest compared set"
    ax.set_ylabel(f"estimated error above\n{lowest} [%]")
    ax.set_xlim(left=0)
    ax.margins(y=0.08)
    said = ", ".join(f"{dashes}: {kind}" for dashes, kind in kinds.items())
    legend_above(ax, handles, columns=_columns(labels.values()), title=said)
    return ax


def _least(curves: Mapping[str, pd.DataFrame], ways: Mapping[str, str]) -> dict[str, float]:
    """The least error of all searches that estimate alike, by the way in which they estimate."""
    least = dict.fromkeys((ways.get(name, "") for name in curves), math.inf)
    for name, curve in curves.items():
        way = ways.get(name, "")
        least[way] = min(least[way], *curve.min().dropna(), math.inf)
    return least


def _scale(ax: Axes, differences: np.ndarray[Any, Any]) -> None:
    """Choose a linear axis for small differences, else an axis that is linear only near 0."""
    sizes = np.abs(differences[differences != 0])
    if sizes.size and sizes.max() > _LINEAR:
        near = 10 ** np.floor(np.log10(np.clip(np.quantile(sizes, 0.1), 0.1, 1.0)))
        ax.set_yscale("symlog", linthresh=near, linscale=0.5)
        ax.yaxis.set_major_locator(SymmetricalLogLocator(base=10, linthresh=near, subs=(1, 3)))
        ax.yaxis.set_minor_locator(
            SymmetricalLogLocator(base=10, linthresh=near, subs=range(1, 10))
        )
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: minus(f"{value:g}")))


def legend_inches(names: Collection[str]) -> float:
    """Height of a panel's legend over searches of these labels, with its title."""
    return _LEGEND_LINE * (2 + math.ceil((2 + len(names)) / _columns(names)))


def _columns(names: Collection[str]) -> int:
    return 2 if max(map(len, names)) <= _LONGEST_NAME else 1


@figure("compared", applies=lambda run: bool(named_sets(run)))
def compared_figure(tables: Tables) -> Plot:
    """Expected MSE of each compared set, with the 95 % interval of its difference from the best."""
    ranks = table_of(tables.run, "run", "ranks")
    title = "Bars: 95 % intervals of the difference from the best set."
    return Plot(_height(ranks), lambda panels: comparison(ranks, ax=panels[0]), title=title)


def _height(ranks: pd.DataFrame) -> float:
    return height_of_rows(min(len(ranks), _MOST_ROWS), _ROW)


def comparison(ranks: Run | pd.DataFrame, *, ax: Axes | None = None) -> Axes:
    """Draw the expected MSE of each set, the best on top, and how far it is from the best.

    The bar of a set is the 95 % interval of the difference from the best set on the same draws.

    Parameters
    ----------
    ranks : Run or DataFrame
        A run, or its table ``ranks``.
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
        return write_instead(ax, "no expected MSE is finite")
    at = least + table["difference"].to_numpy()
    bars = np.stack([table["difference"] - table["low"], table["high"] - table["difference"]])
    ax.axvline(least, color=GREY, lw=thin(0.6), ls=(0, (4, 1.5)), zorder=0)
    styles = styles_of(table, table["name"])
    for row, name in enumerate(table["name"]):
        style = styles[name] | {"ls": "", "ms": marker(0.9), "label": None}
        ax.errorbar(
            at[row], row, xerr=np.nan_to_num(bars[:, [row]]), elinewidth=thin(1.2),
            capsize=marker(0.5), capthick=thin(), **style,
        )  # fmt: skip
    ax.set_ylim(len(table) - 0.5, -0.5)
    step = math.ceil(len(table) / _MOST_ROWS)
    named = [styles[name]["label"] for name in table["name"]]
    ax.set_yticks(range(0, len(named), step), named[::step])
    ax.tick_params(axis="y", length=0)
    label_error(ax, table)
    ax.set_xlabel(ax.get_ylabel())
    ax.set_ylabel("set")
    return ax
