"""The expected error over time, and what each measurement is worth, for two sets of times.

The reference is blue with hollow markers; the other set is red with filled markers.
"""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from numpy.typing import NDArray

from pfdist.analysis import Run
from pfdist.plots.figure import Plot
from pfdist.plots.figures import save_plots
from pfdist.plots.style import BLUE, GREY, RED

Array = NDArray[np.float64]

_BAND = 1.96  # standard errors in half of a 95 % interval
_STYLES: tuple[dict[str, Any], ...] = (
    {"color": BLUE, "ls": (0, (4, 1.5)), "mfc": "white", "mew": 0.6},
    {"color": RED, "ls": "-", "mfc": RED, "mew": 0.6},
)
_SIZE = 2.8  # of a marker, in points


def draw_why(run: Run, profile: pd.DataFrame, measurements: pd.DataFrame, draws: int) -> list[Path]:
    """Draw what each measurement is worth, a figure for each found set and the reference.

    Parameters
    ----------
    run : Run
    profile, measurements : DataFrame
        As of `pfdist.api.why.Why`.
    draws : int
        Number of draws behind the estimates; 0 if they are exact.

    Returns
    -------
    list of Path
        The files written.
    """
    reference, *found = run.names
    return save_plots(
        run,
        (
            (
                f"why-{name}",
                Plot(
                    5.2,
                    partial(_draw, profile, measurements, draws, (reference, name)),
                    panels=3,
                    share_x=True,
                ),
            )
            for name in found
        ),
    )


def _draw(
    profile: pd.DataFrame,
    measurements: pd.DataFrame,
    draws: int,
    names: tuple[str, str],
    panels: Sequence[Axes],
) -> None:
    above, middle, below = panels
    plot_profile(above, profile, names, draws)
    plot_removals(middle, measurements, names)
    plot_shifts(below, measurements, names)


def plot_profile(axes: Axes, profile: pd.DataFrame, names: tuple[str, str], draws: int) -> None:
    """Draw the expected error over time with its 95 % band, and the measurement times.

    Parameters
    ----------
    axes : matplotlib Axes
    profile : DataFrame
        Columns name, t, measured, error and standard_error, as of `pfdist.api.why.Why`.
    names : (str, str)
        Names of the two sets, the reference first.
    draws : int
        Number of draws behind the estimates; 0 if they are exact.
    """
    for name, style in zip(names, _STYLES, strict=True):
        rows = profile[profile["name"] == name]
        t, error = rows["t"].to_numpy(), rows["error"].to_numpy()
        half = _BAND * rows["standard_error"].to_numpy()
        axes.fill_between(t, error - half, error + half, color=style["color"], alpha=0.2, lw=0)
        label = f"{name}, mean {error.mean():.4g}"
        measured = np.flatnonzero(rows["measured"])
        axes.plot(t, error, marker="o", markevery=measured, ms=_SIZE, lw=0.9, label=label, **style)
    axes.set_ylim(bottom=0)
    axes.set_ylabel("expected error $e(t)$")
    drawn = f"on {draws:,} draws of their own; " if draws else ""
    _legend(axes, title=f"{drawn}markers: measured there")


def plot_removals(axes: Axes, measurements: pd.DataFrame, names: tuple[str, str]) -> None:
    """Draw the rise of the expected MSE if a measurement is removed, with 95 % intervals.

    Parameters
    ----------
    axes : matplotlib Axes
    measurements : DataFrame
        Columns name, t, removed and removed_error, as of `pfdist.api.why.Why`.
    names : (str, str)
        Names of the two sets, the reference first.
    """
    for name, style, aside in zip(names, _STYLES, (-0.2, 0.2), strict=True):
        rows = measurements[measurements["name"] == name]
        t, rise = rows["t"].to_numpy() + aside, rows["removed"].to_numpy()
        axes.vlines(t, 0.0, rise, color=style["color"], lw=0.7)
        _intervals(axes, t, rise, rows["removed_error"].to_numpy(), "o", style)
        axes.plot([], [], "o", ms=_SIZE, label=name, **style | {"ls": ""})
    _zero(axes)
    axes.set_ylabel("MSE rise if removed")
    _legend(axes)


def plot_shifts(axes: Axes, measurements: pd.DataFrame, names: tuple[str, str]) -> None:
    """Draw the rise of the expected MSE if a measurement is shifted by one instant.

    Parameters
    ----------
    axes : matplotlib Axes
    measurements : DataFrame
        Columns name, t, earlier, later and their errors, as of `pfdist.api.why.Why`.
    names : (str, str)
        Names of the two sets, the reference first.
    """
    for change, marker, aside in (("earlier", "<", -0.3), ("later", ">", 0.3)):
        for name, style in zip(names, _STYLES, strict=True):
            rows = measurements[measurements["name"] == name].dropna(subset=change)
            t, rise = rows["t"].to_numpy() + aside, rows[change].to_numpy()
            _intervals(axes, t, rise, rows[f"{change}_error"].to_numpy(), marker, style)
        axes.plot([], [], marker, color=GREY, ms=_SIZE, label=f"one instant {change}")
    _zero(axes)
    axes.set_ylabel("MSE rise if shifted")
    axes.set_xlabel("$t$")
    _legend(axes)


def _intervals(
    axes: Axes, t: Array, rise: Array, error: Array, marker: str, style: dict[str, Any]
) -> None:
    half = _BAND * error
    axes.errorbar(t, rise, half, marker=marker, ms=_SIZE, elinewidth=0.6, **style | {"ls": ""})


def _zero(axes: Axes) -> None:
    axes.axhline(0.0, color=GREY, lw=0.6, zorder=0)


def _legend(axes: Axes, title: str = "") -> None:
    axes.legend(
        ncols=2,
        loc="lower center",
        bbox_to_anchor=(0.5, 0.98),
        borderaxespad=0.2,
        title=title or None,
        title_fontsize=7,
    )
