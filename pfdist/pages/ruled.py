"""The figure of a rule: one draw, the spread by which it is measured, and how often draws are."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from pfdist.common.component_names import Component
from pfdist.pages.figure import Plot, save_plots
from pfdist.pages.panel import label_instants, label_quantity, legend_above, marker, thin
from pfdist.pages.style import BLUE, GREY, RED
from pfdist.problem.clock import Clock
from pfdist.results.sets import typical_error
from pfdist.runner.ruling import RuledDraw

Array = NDArray[np.float64]


def draw_rule(
    folder: Path, shown: RuledDraw, numbers: Array, what: str, quantities: Sequence[Component],
    is_angle: bool, clock: Clock,
) -> list[Path]:  # fmt: skip
    """Draw the figure ``rule`` into a run's folder.

    Parameters
    ----------
    folder : Path
    shown : RuledDraw
    numbers : array of float64, (D,)
        Numbers of measurements of all draws, or prices.
    what : str
        Which of these.
    quantities : sequence of Component
        The components of z, of which the first is shown.
    is_angle : bool
        Whether the first is an angle.
    clock : Clock
        That of the job.
    """

    def draw(panels: Sequence[Axes]) -> None:
        _estimate(shown, quantities, is_angle, clock, panels[0])
        _spread(shown, clock, panels[1])
        values, counts = np.unique(numbers, return_counts=True)
        panels[2].bar(values, 100 * counts / numbers.size, color=BLUE, lw=0)
        panels[2].set_xlabel(f"{what} of a draw")
        panels[2].set_ylabel("share of draws [%]")
        panels[2].xaxis.set_major_locator(MaxNLocator(integer=True))

    title = f"Draw {shown.draw} of {numbers.size:,}: {len(shown.measured)} measurements."
    return save_plots(folder, [("rule", Plot(5.0, draw, panels=3, title=title))])


def _estimate(
    shown: RuledDraw, quantities: Sequence[Component], is_angle: bool, clock: Clock, ax: Axes
) -> None:
    times = np.array(clock.times)
    path, mean = times[shown.instants], shown.mean[:, 0]
    apart = np.array([min(typical_error(v, is_angle), np.pi if is_angle else np.inf)
                      for v in shown.variance[:, 0].tolist()])  # fmt: skip
    ax.plot(times, shown.z[:, 0], color="black", lw=thin(), label="truth")
    ax.plot(path, mean, color=BLUE, label="estimate, with its standard deviation")
    ax.fill_between(path, mean - apart, mean + apart, color=BLUE, alpha=0.2, lw=0)
    label_quantity(ax, quantities, 0)
    label_instants(ax, clock)
    legend_above(ax)


def _spread(shown: RuledDraw, clock: Clock, ax: Axes) -> None:
    path, times = (np.array(clock.times)[at] for at in (shown.instants, shown.measured))
    deviation = np.sqrt(shown.variance.sum(axis=1))
    level = np.where(np.isfinite(shown.level), shown.level, np.nan)
    marks: dict[str, Any] = {"ms": marker(), "mew": 0, "clip_on": False, "zorder": 5}
    ax.plot(path, deviation, color=GREY, label="standard deviation of z")
    for sensor in range(level.shape[1]):
        label = "level of the rule" * (sensor == 0)
        ax.plot(path, level[:, sensor], color=RED, ls="--", lw=thin(), label=label or None)
    ax.plot(times, 0.0 * times, "^", color=RED, label="measured", **marks)
    ax.set_ylim(bottom=0.0)
    ax.set_ylabel("standard deviation")
    label_instants(ax, clock)
    legend_above(ax)
