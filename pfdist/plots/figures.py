"""Draw all figures of a run and save them."""

from collections.abc import Callable
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


def draw_figures(run: Run) -> list[Path]:
    """Draw the paper's figures from the tables of a run, into its folder ``figures``.

    One of the searches' cost; and for each search one of a draw and one of the gain.

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
        The comparison has not begun, so there is nothing to draw.
    """
    if run.state == "searching" or not run.draws_compared:
        raise StoreError(f"{run.path} has no compared draws yet: run the job on, then plot")
    with mpl.rc_context(STYLE):
        return [
            *_save(run.path, "cost", 2.4, lambda axes: _cost(run, axes)),
            *(
                file
                for name in run.names[1:]
                for figure, height, plot in (
                    (f"draw-{name}", 2.6, _draw),
                    (f"gain-{name}", 2.3, _gain),
                )
                for file in _save(run.path, figure, height, lambda axes: plot(run, name, axes))  # noqa: B023
            ),
        ]


def _save(path: Path, name: str, height: float, plot: Callable[[Axes], None]) -> list[Path]:
    figure = Figure(figsize=(COLUMN_INCHES, height), layout="constrained")
    plot(figure.subplots())
    folder = path / "figures"
    folder.mkdir(exist_ok=True)
    files = [folder / f"{name}.{kind}" for kind in FORMATS]
    for file in files:
        # No date in the file: the same figure is the same bytes.
        figure.savefig(file, metadata={"Date": None} if file.suffix == ".svg" else None)
    return files


def _cost(run: Run, axes: Axes) -> None:
    one_by_one = {search["name"] for search in run.job["search"] if search["method"] in ONE_BY_ONE}
    regular = run.comparison()[f"mse_{run.names[0]}"].mean()
    plot_cost(axes, run.evaluations(), one_by_one, float(regular))


def _draw(run: Run, name: str, axes: Axes) -> None:
    trajectories = run.trajectories()
    gains = run.gains().set_index("draw")[f"gain_{name}"].dropna()
    shown = gains[gains.index.isin(trajectories["draw"])]
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
    plot_gain_histogram(axes, finite, name, summary.mean_relative_gain, summary.positive_fraction)
