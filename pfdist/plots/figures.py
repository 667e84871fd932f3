"""Draw all figures of a run and save them."""

from collections.abc import Callable
from functools import partial
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pfdist.analysis import Run, summarise_gain
from pfdist.errors import StoreError
from pfdist.plots.cost import plot_cost
from pfdist.plots.gain_histogram import plot_gain_histogram
from pfdist.plots.one_draw import plot_one_draw, typical_draw
from pfdist.plots.style import COLUMN_INCHES, STYLE

FORMATS = ("png", "svg")
ONE_BY_ONE = {"random"}  # methods without populations


def figure_files(run: Run) -> list[Path]:
    """List the files of a run's figures: the searches' cost, and two for each search."""
    names = ["cost", *(f"{kind}-{name}" for name in run.names[1:] for kind in ("draw", "gain"))]
    return [run.path / "figures" / f"{name}.{kind}" for name in names for kind in FORMATS]


def remove_figures(path: Path) -> None:
    """Remove the figures of the run in this folder."""
    for file in (path / "figures").glob("*.*"):
        if file.suffix.removeprefix(".") in FORMATS:
            file.unlink(missing_ok=True)


def draw_figures(run: Run) -> list[Path]:
    """Draw the paper's figures from the tables of a run, into its folder ``figures``.

    Parameters
    ----------
    run : Run

    Returns
    -------
    list of Path
        The files written.

    Raises
    ------
    StoreError
        The comparison has not begun, so there is nothing to draw; or a table cannot be read.
    """
    if run.state == "searching" or not run.draws_compared:
        raise StoreError(f"{run.path} has no compared draws yet: run the job on, then plot")
    plots: dict[str, tuple[float, Callable[[Axes], None]]] = {"cost": (2.4, partial(_cost, run))}
    for name in run.names[1:]:
        plots[f"draw-{name}"] = (2.6, partial(_draw, run, name))
        plots[f"gain-{name}"] = (2.3, partial(_gain, run, name))
    files = figure_files(run)
    with mpl.rc_context(STYLE):
        for name, (height, plot) in plots.items():
            figure = Figure(figsize=(COLUMN_INCHES, height), layout="constrained")
            plot(figure.subplots())
            for file in (file for file in files if file.stem == name):
                file.parent.mkdir(exist_ok=True)
                # No date in the file: the same figure is the same bytes.
                date = {"Date": None} if file.suffix == ".svg" else None
                figure.savefig(file, metadata=date)
    return files


def _cost(run: Run, axes: Axes) -> None:
    one_by_one = {search["name"] for search in run.job["search"] if search["method"] in ONE_BY_ONE}
    regular = run.comparison()[f"mse_{run.names[0]}"].mean()
    plot_cost(axes, run.evaluations(), one_by_one, float(regular))


def _draw(run: Run, name: str, axes: Axes) -> None:
    trajectories = run.trajectories()
    gains = run.gains().set_index("draw")[f"gain_{name}"].dropna()
    shown = gains[gains.index.isin(trajectories["draw"])]
    if shown.empty:
        _say_so(axes, "no draw that is kept has a gain")
        return
    draw = typical_draw(shown, float(gains.mean()))
    times = run.compared().set_index("name")["measurement_times"]
    chosen = {key: times[key].tolist() for key in (run.names[0], name)}
    rows = trajectories[trajectories["draw"] == draw]
    plot_one_draw(axes, rows, chosen, float(shown[draw]))


def _gain(run: Run, name: str, axes: Axes) -> None:
    rows = run.comparison()
    summary = summarise_gain(rows[f"mse_{name}"].to_numpy(), rows[f"mse_{run.names[0]}"].to_numpy())
    gain = run.gains()[f"gain_{name}"].dropna().to_numpy()
    finite = gain[np.isfinite(gain)]
    if not finite.size:
        _say_so(axes, "no draw has a finite gain")
        return
    plot_gain_histogram(axes, finite, name, summary.mean_relative_gain, summary.positive_fraction)


def _say_so(axes: Axes, text: str) -> None:
    """In the place of a figure there is nothing to make of."""
    axes.set_axis_off()
    axes.text(0.5, 0.5, text, ha="center", va="center", transform=axes.transAxes)
