"""The figure of a rule: one draw, the spread by which it is measured, and how often draws are."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from pfdist.pages.figure import Plot, save_plots
from pfdist.pages.panel import label_instants, legend_above, marker, thin
from pfdist.pages.style import BLUE, GREY, RED
from pfdist.plugins.rule.ruling import RuledDraw
from pfdist.problem.clock import Clock

Array = NDArray[np.float64]


def draw_rule(
    folder: Path, shown: RuledDraw, numbers: Array, what: str, unit: str, clock: Clock
) -> list[Path]:
    """Draw the figure ``rule`` into a run's folder.

    Parameters
    ----------
    folder : Path
    shown : RuledDraw
    numbers : array of float64, (D,)
        Numbers of measurements of all draws, or prices.
    what : str
        Which of these.
    unit : str
        That of the standard deviation of z, or nothing.
    clock : Clock
        That of the job.
    """

    def draw(panels: Sequence[Axes]) -> None:
        spread, counted = panels
        path, times = (np.array(clock.times)[at] for at in (shown.instants, shown.measured))
        marks: dict[str, Any] = {"ms": marker(), "mew": 0, "clip_on": False, "zorder": 5}
        spread.plot(path, shown.deviation, color=GREY, label="standard deviation of z")
        level = np.where(np.isfinite(shown.level), np.maximum(shown.level, 0.0), np.nan)
        lines = spread.plot(path, level, color=RED, ls="--", lw=thin())
        lines[0].set_label("level of the rule")
        spread.plot(times, 0.0 * times, "^", color=RED, label="measured", **marks)
        spread.set_ylim(bottom=0.0)
        spread.set_ylabel(f"standard deviation [{unit}]" if unit else "standard deviation")
        label_instants(spread, clock)
        legend_above(spread)
        values, counts = np.unique(numbers, return_counts=True)
        width = 0.8 * np.diff(values).min(initial=1.0)  # prices may differ by less than 1
        counted.bar(values, 100 * counts / numbers.size, width, color=BLUE, lw=0)
        counted.set_xlabel(f"{what} of a draw")
        counted.set_ylabel("share of draws [%]")
        counted.xaxis.set_major_locator(MaxNLocator(integer=True))

    title = f"Draw {shown.draw} of {numbers.size:,}: {len(shown.measured)} measurements."
    return save_plots(folder, [("rule", Plot(3.4, draw, panels=2, title=title))])
