"""Figures of a backtest: real against foreseen errors, and some replicates in full."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from pfdist.common.component_names import Component
from pfdist.pages.figure import Plot
from pfdist.pages.panel import (
    label_instants,
    legend_above,
    marker,
    thin,
    verbatim,
)
from pfdist.pages.style import BLUE, GREY, OCHRE, RED
from pfdist.problem.clock import Clock

TITLE = "pfdist: backtest"
"""By which the file of a figure is recognised."""
_WIDE = 10.0  # ratio of two errors that needs a logarithmic axis
_SETS = ((RED, "o"), (BLUE, "s"), (GREY, "^"), (OCHRE, "D"))  # the plan, the grids, another set


def by_replicate(table: pd.DataFrame, sets: Mapping[str, str]) -> Plot:
    """Plot of the real error against the foreseen error of each replicate, with the means.

    Parameters
    ----------
    table : DataFrame
        With the columns of `pfdist.store.backtest_schema`.
    sets : mapping of str to str
        Sets with their names in sentences, the plan first.
    """
    plan = table[table["set"] == next(iter(sets))]
    above = int((plan["real"] > plan["foreseen"]).sum())
    title = (
        f"With the plan, the real error is larger than the foreseen error in {above} of "
        f"{len(plan)} replicates."
    )
    return Plot(2.9, lambda panels: _errors(table, sets, panels[0]), title=title)


def _errors(table: pd.DataFrame, sets: Mapping[str, str], ax: Axes) -> None:
    for (name, label), (colour, shape) in zip(sets.items(), _SETS, strict=False):
        rows = table[table["set"] == name]
        short = verbatim(label.replace("evenly spaced times", "").strip(" ,"))
        alike: dict[str, Any] = {"color": colour, "mew": thin(2.0)}
        ax.plot(rows["foreseen"], rows["real"], shape, ms=marker(0.8), mec="none", alpha=0.6,
                label=short, **alike)  # fmt: skip
        foreseen, real = rows["foreseen"].mean(), rows["real"].mean()
        ax.plot(foreseen, real, shape, ms=marker(2.2), mfc="white", **alike)
    for column, set_scale in (("foreseen", ax.set_xscale), ("real", ax.set_yscale)):
        if table[column].max() > _WIDE * table[column].min() > 0:
            set_scale("log")
    ends = ax.get_xlim()
    equal = np.linspace(*ends, 100)  # a curve if one axis is logarithmic
    ax.plot(equal, equal, color="black", lw=thin(), label="as foreseen")
    ax.set_xlim(*ends)
    ax.set_xlabel("foreseen error / variance of judged values (large: means)")
    ax.set_ylabel("real error / variance")
    legend_above(ax)


def in_full(shown: Sequence[Any], quantity: Component, clock: Clock) -> Plot:
    """Plot of some replicates: the measurements, and the prediction with the plan.

    Parameters
    ----------
    shown : sequence of ShownReplicate
    quantity : Component
        The first component of what is judged.
    clock : Clock
        That of the job.
    """

    def draw(panels: Sequence[Axes]) -> None:
        for each, ax in zip(shown, panels, strict=True):
            _prediction(each, ax)
            ax.set_ylabel(verbatim(quantity.label or "y"))
        legend_above(panels[0])
        label_instants(panels[-1], replace(clock, counts=False))

    title = "Replicates from one with little gain to one with much; a band holds 90 % by the model."
    return Plot(0.9 + 1.25 * len(shown), draw, panels=len(shown), title=title)


def _prediction(shown: Any, ax: Axes) -> None:
    low, mean, high = (each[0, :, 0] for each in shown.errors.intervals)
    ax.fill_between(shown.times, low, high, color=BLUE, alpha=0.2, lw=0)
    ax.plot(shown.times, mean, color=BLUE, label="prediction with the plan; band: 90 %")
    used = np.isin(np.arange(len(shown.times)), shown.used)
    points: tuple[tuple[Any, dict[str, Any], str], ...] = (
        (~used, {"ms": marker(0.6), "mew": thin(), "mfc": "white", "color": GREY}, "measured"),
        (used, {"ms": marker(0.9), "mew": 0, "color": RED}, "measured by the plan"),
    )
    for which, style, label in points:
        ax.plot(shown.times[which], shown.measured[which, 0], "o", label=label, **style)
    name = verbatim(shown.name)
    ax.text(1.0, 1.0, name, transform=ax.transAxes, ha="right", va="top", color=GREY)
