"""The sampling windows of a set: how far each measurement alone can be moved at a small loss."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from pfdist.analysis import Run
from pfdist.analysis.sampling_windows import (
    STRICT,
    WIDE,
    SamplingWindow,
    runs_of,
    sentences,
    windows_of,
)
from pfdist.common.told_times import told_time
from pfdist.plots.figure import Plot, Tables, figure
from pfdist.plots.panel import (
    axes_for,
    chosen,
    label_times,
    legend_above,
    marker,
    table_of,
    thin,
    write_instead,
)
from pfdist.plots.style import BLUE, GREY, RED
from pfdist.times.clock import Time

_ROW, _EDGES = 0.14, 0.95  # inches of a row, and of the legend and the labels
_TALLEST = 6.0
_MOST_LABELS = 30  # rows that have room for their names
_LENGTH = 0.8  # of a bar, in instants
_BARS = ((WIDE, BLUE, 0.28), (STRICT, RED, 0.72))  # level, colour and height over that of a row


def _has_windows(run: Run) -> bool:
    return run.has("sampling_windows") and run.has("jitter")


@figure("sampling_windows", applies=_has_windows, each_set=True)
def sampling_windows_figure(tables: Tables, name: str) -> Plot:
    """Sampling windows: instants to which each measurement alone can move at a small loss."""
    table, jitter = tables.run.sampling_windows(), tables.run.jitter()
    rows, is_found = table[table["name"] == name], name in tables.run.found
    return Plot(
        _height(rows["t"].nunique()),
        lambda panels: sampling_windows(rows, name, ax=panels[0]),  # none: it measures nothing
        title=_title(name, rows, jitter[jitter["name"] == name], is_found=is_found),
    )


def _height(rows: int) -> float:
    return min(_EDGES + _ROW * max(rows, 3), _TALLEST)


def _title(name: str, rows: pd.DataFrame, jitter: pd.DataFrame, *, is_found: bool) -> str:
    """Say whether the optimum is flat, or else which measurements must be kept exactly."""
    said = sentences(rows.to_dict("records"), jitter.to_dict("records"), is_found=is_found)
    return f"Sampling windows of {name}. {said[0] if said else 'Nothing can move.'}"


def sampling_windows(table: object, name: str = "", *, ax: Axes | None = None) -> Axes:
    """Draw the instants to which each measurement alone can move at a loss of at most 1 and 5 %.

    Each measurement is a row. A thick bar covers the instants within 1 %, a thin bar those within
    5 %. Hollow bars cover the instants that the draws leave open. A grey line ends where the job or
    a neighbouring measurement ends what was tried.

    Parameters
    ----------
    table : DataFrame or object
        A table with the columns t, moved_to, within_1 and within_5, and name if there are several
        sets. Or an object that has it as ``sampling_windows``, such as a run or the result of
        `pfdist.why`.
    name : str
        The set that is drawn; by default the last set.
    ax : matplotlib Axes, optional
        By default those of a new figure.

    Returns
    -------
    matplotlib Axes

    Raises
    ------
    JobError
        The table has no set of this name.
    """
    rows = _of_a_set(table_of(table, "table", "sampling_windows"), name)
    if rows.empty:
        return write_instead(axes_for(ax), "there is no measurement that can be moved")
    measurements = rows["t"].nunique()
    ax = axes_for(ax, _height(measurements))
    tried = rows.groupby("t")["moved_to"].agg(["min", "max"])
    places = range(measurements)
    ax.hlines(places, tried["min"], tried["max"], color=GREY, lw=thin(0.6), zorder=1)
    records, length = rows.to_dict("records"), _LENGTH * _step(rows)
    for order, (percent, color, height) in enumerate(_BARS, start=2):
        _draw_bars(ax, windows_of(records, percent), (height, length), color, order)
    ax.plot(tried.index, places, "o", color="black", ms=marker(0.5), zorder=5)
    _label_rows(ax, tried.index.tolist())
    label_times(ax, rows)
    legend_above(ax, _handles(), columns=2)
    return ax


def _of_a_set(table: pd.DataFrame, name: str) -> pd.DataFrame:
    """Give the rows of a set of the table, in order of the measurements."""
    if "name" in table and not table.empty:
        known = list(dict.fromkeys(map(str, table["name"])))
        table = table[table["name"] == (chosen(name, known, "name") if name else known[-1])]
    return table.sort_values(["t", "moved_to"])


def _draw_bars(
    ax: Axes,
    windows: Sequence[SamplingWindow],
    size: tuple[float, float],
    color: str,
    order: int,
) -> None:
    """Draw the windows of one level: filled where they are sure, hollow where they are open.

    The size is the height of a bar, and the length of the bar over a single instant.
    """
    height, length = size
    for place, window in enumerate(windows):
        y = (place - height / 2, height)
        ax.broken_barh(_spans(window.inside, length), y, color=color, lw=0, zorder=order)
        if window.open:
            ax.broken_barh(
                _spans(window.open, length), y, fc="none", ec=color, lw=thin(0.5), zorder=order
            )  # fmt: skip


def _spans(instants: Mapping[Time, int], length: float) -> list[tuple[float, float]]:
    """Give the first end and the length of the bar over each stretch of successive instants."""
    return [(run[0] - length / 2, run[-1] - run[0] + length) for run in runs_of(instants)]


def _step(rows: pd.DataFrame) -> float:
    """Give the least difference of two instants in the table; 1 where instants are counted."""
    known = np.unique(rows["moved_to"].to_numpy())
    return float(np.diff(known).min()) if known.dtype.kind == "f" and known.size > 1 else 1.0


def _label_rows(ax: Axes, times: Sequence[int]) -> None:
    """Put the first measurement on top, and name as many rows as there is room for."""
    step = -(-len(times) // _MOST_LABELS)
    ax.set_ylim(max(len(times), 3) - 0.4, -0.6)
    ax.set_yticks(range(0, len(times), step), [told_time(t) for t in times[::step]])
    ax.tick_params(axis="y", length=0)
    ax.set_ylabel("measurement at")


def _handles() -> list[Patch | Line2D]:
    (_, thin_color, _), (_, thick_color, _) = _BARS
    return [
        Patch(fc=thick_color, lw=0, label=f"loss at most {STRICT} %"),
        Patch(fc=thin_color, lw=0, label=f"at most {WIDE} % (thin)"),
        Patch(fc="white", ec=thick_color, lw=thin(0.5), label="open (hollow)"),
        Line2D([], [], color=GREY, lw=thin(0.6), marker="o", mfc="black", mec="black",
               ms=marker(0.5), label="kept; tried up to here"),
    ]  # fmt: skip
