"""The budget curve."""

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from pfdist.pages.figure import Plot, Tables, figure
from pfdist.pages.panel import (
    axes_for,
    cut_outliers,
    label_ends,
    label_error,
    legend_above,
    marker,
    points,
    table_of,
    thin,
)
from pfdist.pages.style import RED, set_style
from pfdist.plugins.budget.page import KINDS, best_reference
from pfdist.problem.added_sections import has_amounts
from pfdist.results import Run, reaching

_BOUND: dict[str, Any] = {"color": "black", "label": "lower bound"}


def _styles(table: pd.DataFrame) -> dict[str, Any]:
    """The style of each kind of sets, with its label; that of the found sets is the last."""
    kinds = [kind for kind in KINDS if kind in {*table["kind"]}]
    return {kind: set_style(place) | {"label": KINDS[kind]} for place, kind in enumerate(kinds)}


@figure("budget", applies=lambda run: has_amounts(run.job))
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
