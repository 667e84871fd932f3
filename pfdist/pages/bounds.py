"""The budget curve, and the lower bound against the work of its proof."""

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from pfdist.common.percent import at_most, idle_bound
from pfdist.pages.figure import Plot, Tables, figure, one_number
from pfdist.pages.panel import (
    BAND,
    axes_for,
    cut_outliers,
    label_ends,
    label_error,
    legend_above,
    marker,
    points,
    styles_of,
    table_of,
    thin,
    write_instead,
)
from pfdist.pages.style import RED, set_style
from pfdist.problem.set_key import KINDS, phrase_of
from pfdist.results import Run, reaching
from pfdist.results.budget_curve import best_reference

_BOUND: dict[str, Any] = {"color": "black", "label": "lower bound"}


def _styles(table: pd.DataFrame) -> dict[str, Any]:
    """The style of each kind of sets, with its label; that of the found sets is the last."""
    kinds = [kind for kind in KINDS if kind in {*table["kind"]}]
    return {kind: set_style(place) | {"label": KINDS[kind]} for place, kind in enumerate(kinds)}


@figure("budget", applies=lambda run: "budget" in run.job)
def budget_figure(tables: Tables) -> Plot:
    """Expected MSE against the number of measurements or the price, evenly spaced and planned."""
    table = table_of(tables.run, "run", "sets")
    return Plot(2.5, lambda panels: budget(table, ax=panels[0]), title=_title(table))


def _title(table: pd.DataFrame) -> str:
    """Say how many planned times do what evenly spaced times do."""
    errors = table.pivot_table(index="budget", columns="kind", values="expected_mse")
    both = errors.dropna()
    if both.empty:
        return "No number of measurements has an expected MSE with both kinds of times."
    other, found = _styles(table)
    lower = 100 * (1 - both[found] / both[other])
    sign, word = (1, "lower") if lower.max() >= 0 else (-1, "higher")
    ends = dict.fromkeys(f"{end:z.0f}" for end in sorted(sign * lower.agg(["min", "max"])))
    first, last, which = both.index[0], both.index[-1], "N"
    amounts = f"{first:.0f} to {last:.0f} measurements"
    if _is_money(table):
        amounts, which = f"a total price of {first:g} to {last:g}", "the price"
    return (
        f"With {amounts}, the expected MSE of the plan is "
        f"{' to '.join(ends)} % {word} than that of {KINDS[other]} times"
        f"{f', depending on {which}' * (len(ends) > 1)}."
    )


def _is_money(table: pd.DataFrame) -> bool:
    """Whether sets are chosen for total prices, rather than for numbers of measurements."""
    return "price" in table and bool(table["price"].notna().any())


def budget(table: Run | pd.DataFrame, *, ax: Axes | None = None) -> Axes:
    """Draw the expected MSE against N with its 95 % intervals, and the lower bound if there is one.

    An arrow shows how many planned measurements do as well as the best number of evenly spaced
    ones.

    Parameters
    ----------
    table : Run or DataFrame
        A run for several numbers of measurements, or its table ``sets``.
    ax : matplotlib Axes, optional
        By default those of a new figure.

    Returns
    -------
    matplotlib Axes
    """
    table, ax, curves = table_of(table, "table", "sets"), axes_for(ax), []
    ends, styles = [], _styles(table)
    for kind, style in styles.items():
        rows = table[table["kind"] == kind]
        mean = rows["expected_mse"].to_numpy()
        errors = np.array([mean - rows["expected_mse_low"], rows["expected_mse_high"] - mean])
        ax.errorbar(
            rows["budget"], mean, errors, lw=thin(0.8), ms=marker(0.8), elinewidth=thin(0.6),
            **style,
        )  # fmt: skip
        curves.append(points(rows["budget"], mean, style["color"], style["label"]))
        ends += [(y, style["label"], style["color"]) for y in mean[np.isfinite(mean)][-1:]]
    rows = table[table["kind"] == "found"]
    numbers, low, limit = rows["budget"], rows["bound"], rows["bound_low"]
    if low.notna().any():
        ax.plot(numbers, low, lw=thin(0.9), **_BOUND)
        ax.fill_between(numbers, limit, low, color="black", alpha=0.2, linewidth=0)
        for curve, text in ((low, "lower bound"), (limit.where(limit < low), "its 95 % limit")):
            ends += [(y, text, "black") for y in curve.dropna()[-1:]]
    ax.set_xlabel("total price" if _is_money(table) else "number of measurements $N$")
    label_error(ax, table)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True, steps=[1, 2, 5, 10]))
    cut_outliers(ax, curves)
    _mark_spared(ax, table)
    label_ends(ax, ends)
    legend_above(ax, [line for line in ax.get_lines() if "off the axis" in str(line.get_label())])
    return ax


def _mark_spared(ax: Axes, table: pd.DataFrame) -> None:
    """Draw an arrow from the best evenly spaced times to the fewer planned ones that do as well."""
    number, mse, error = best_reference(table)[["budget", "expected_mse", "standard_error"]]
    least = reaching(table, mse, error)["found"]["measurements"]
    if least is not None and least < number:
        look = {"arrowstyle": "->", "color": RED, "lw": thin(), "shrinkA": 0, "shrinkB": 0}
        ax.annotate("", (least, mse), (number, mse), arrowprops=look)
        text = f"at least as good: {least} instead of {number:.0f}"
        ax.text(0.98, 0.9, text, ha="right", c=RED, size="small", transform=ax.transAxes)


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
