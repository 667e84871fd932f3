"""Draw all figures of a run and save them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from pfdist.analysis import Gain, Run
from pfdist.analysis.reference import label
from pfdist.errors import StoreError
from pfdist.plots.budget import plot_budget
from pfdist.plots.cost import curve_of, legend_inches, plot_cost
from pfdist.plots.gain_histogram import plot_gain_histogram
from pfdist.plots.library import styled
from pfdist.plots.one_draw import MOST_COMPONENTS, components, plot_one_draw, typical_draw
from pfdist.plots.style import COLUMN_INCHES
from pfdist.plots.why import plot_profile, plot_removals, plot_shifts
from pfdist.store import remove_file, write_file


@dataclass(frozen=True)
class _Plot:
    """A figure: its height in inches, how many panels it has, and what draws them."""

    height: float
    draw: Callable[[Sequence[Axes]], None]
    panels: int = 1


_Plots = dict[str, _Plot]

FORMATS = ("png", "svg")


def figure_files(run: Run) -> list[Path]:
    """List the files of a run's figures: the searches' cost, and two for each search.

    Of a run for several numbers of measurements it is one, of the cost of each.
    """
    names = ["budget"]
    if not run.has_budget:
        names = ["cost", *(f"{kind}-{name}" for name in run.names[1:] for kind in ("draw", "gain"))]
    return [file for name in names for file in _files(run, name)]


def remove_figures(path: Path) -> None:
    """Remove the figures of the run in this folder."""
    for file in (path / "figures").glob("*.*"):
        if file.suffix.removeprefix(".") in FORMATS:
            remove_file(file)


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
        The comparison has not begun, so there is nothing to draw; or a table cannot be read, or a
        figure not be written.
    """
    if run.state == "searching" or not run.draws_compared:
        raise StoreError(f"{run.path} has no compared draws yet: run the job on, then plot")
    return _drawn(run, _budget_plot(run, "budget") if run.has_budget else _plots(run))


def draw_target(run: Run, target: float) -> list[Path]:
    """Draw which numbers of measurements reach a target, into ``figures``, beside the others.

    Parameters
    ----------
    run : Run
        For several numbers of measurements.
    target : float
        An expected MSE.

    Returns
    -------
    list of Path
        The files written.
    """
    return _drawn(run, _budget_plot(run, f"budget-target-{target:g}", target))


def _drawn(run: Run, plots: _Plots) -> list[Path]:
    files = []
    with styled():
        for name, plot in plots.items():
            figure = Figure(figsize=(COLUMN_INCHES, plot.height), layout="constrained")
            plot.draw(figure.subplots(plot.panels, squeeze=False)[:, 0].tolist())
            files += _saved(run, name, figure)
    return files


def _saved(run: Run, name: str, figure: Figure) -> list[Path]:
    files = _files(run, name)
    for file in files:
        write_file(file, partial(_save, figure, file.suffix.removeprefix(".")))
    return files


def _files(run: Run, name: str) -> list[Path]:
    return [run.path / "figures" / f"{name}.{kind}" for kind in FORMATS]


def _budget_plot(run: Run, name: str, target: float | None = None) -> _Plots:
    table = run.budget()
    return {name: _Plot(2.6, lambda panels: plot_budget(panels[0], table, target))}


def _plots(run: Run) -> _Plots:
    known, kinds = run.statistics(), _kinds(run)
    cost = partial(_cost, run, kinds, known.mse[run.names[0]].mean)
    tallest = max(map(legend_inches, kinds.values()))
    plots: _Plots = {"cost": _Plot((1.9 + tallest) * len(kinds), cost, len(kinds))}
    trajectories = run.trajectories()
    gains = run.gains(draws=int(trajectories["draw"].max()) + 1).set_index("draw")
    panels = min(components(trajectories), MOST_COMPONENTS)
    for name, gain in known.gains.items():
        shown = gains[f"gain_{name}"].dropna()
        draw = partial(_draw, run, name, trajectories, shown)
        number = panels if len(shown) else 1
        plots[f"draw-{name}"] = _Plot(1.2 + 1.4 * number, draw, number)
        plots[f"gain-{name}"] = _Plot(2.3, partial(_gain, run, gain, name))
    return plots


def draw_why(run: Run, profile: pd.DataFrame, measurements: pd.DataFrame, draws: int) -> list[Path]:
    """Draw why the times of every search are what they are, beside the reference's.

    Parameters
    ----------
    run : Run
    profile, measurements : DataFrame
        As of `pfdist.api.why.Why`.
    draws : int
        Likewise.

    Returns
    -------
    list of Path
        The files written.
    """
    files, (reference, *searches) = list[Path](), run.names
    with styled():
        for name in searches:
            figure, both = (
                Figure(figsize=(COLUMN_INCHES, 5.2), layout="constrained"),
                (reference, name),
            )
            above, middle, below = figure.subplots(3, sharex=True)
            plot_profile(above, profile, both, draws)
            plot_removals(middle, measurements, both)
            plot_shifts(below, measurements, both)
            files += _saved(run, f"why-{name}", figure)
    return files


def _save(figure: Figure, kind: str, path: Path) -> None:
    # No date in the file: the same figure is the same bytes.
    figure.savefig(path, format=kind, metadata={"Date": None} if kind == "svg" else None)


def _kinds(run: Run) -> dict[str, list[str]]:
    """Names of the searches that estimate alike, by how: by nothing, if as the comparison does."""
    kinds: dict[str, list[str]] = {}
    for search in run.job["search"]:
        estimation = run.own_estimation(search["name"])
        if search.get("evaluation", {}).get("estimator") == "auto" and not run.knows_estimations:
            estimation["estimator"] = "unknown estimator"
        kinds.setdefault(_kind(estimation), []).append(search["name"])
    return dict(sorted(kinds.items()))


def _kind(estimation: dict[str, Any]) -> str:
    """Say how the costs of a search differ from those of the comparison."""
    particles = f"{estimation['particles']} particles" if "particles" in estimation else ""
    resampling = f"{estimation['resampling']} resampling" if "resampling" in estimation else ""
    estimator = str(estimation.get("estimator", ""))
    parts = (part.replace("_", " ") for part in (estimator, particles, resampling))
    return ", ".join(filter(None, parts))


def _cost(run: Run, kinds: dict[str, list[str]], mse: float, panels: Sequence[Axes]) -> None:
    """Draw a panel for each way to estimate: costs of different estimators are not comparable."""
    methods = {search["name"]: search["method"] for search in run.job["search"]}
    evaluations = run.evaluations()
    if "end" not in evaluations:  # an older run, without prefixes
        evaluations = evaluations.assign(end=run.job["problem"]["horizon"])
    # A search that was done again is shown as it was then: its first costs are not to be believed.
    redone = {f"{name}.again": name for name in methods if run.distrust(name)}
    evaluations = evaluations[~evaluations["phase"].isin(redone.values())]
    evaluations = evaluations.assign(phase=evaluations["phase"].replace(redone))
    reference = (label(run.names[0]), mse)
    for axes, (kind, names) in zip(panels, kinds.items(), strict=True):
        curves = {name: curve_of(methods[name]) for name in names}
        title = f"estimated otherwise than the comparison:\n{kind}" if kind else ""
        plot_cost(axes, evaluations, curves, None if kind else reference, title)


def _draw(
    run: Run,
    name: str,
    trajectories: pd.DataFrame,
    gains: "pd.Series[float]",
    panels: Sequence[Axes],
) -> None:
    if gains.empty:
        _say_so(panels[0], "no draw that is kept has a gain")
        return
    draw = typical_draw(gains)
    times = run.compared().set_index("name")["measurement_times"]
    chosen = {key: times[key].tolist() for key in (run.names[0], name)}
    rows = trajectories[trajectories["draw"] == draw]
    plot_one_draw(panels, rows, chosen, float(gains[draw]))


def _gain(run: Run, gain: Gain, name: str, panels: Sequence[Axes]) -> None:
    if not gain.counts.any():
        _say_so(panels[0], "no draw has a finite gain")
        return
    plot_gain_histogram(panels[0], gain, name, label(run.names[0]))


def _say_so(axes: Axes, text: str) -> None:
    """In the place of a figure there is nothing to make of."""
    axes.set_axis_off()
    axes.text(0.5, 0.5, text, ha="center", va="center", transform=axes.transAxes)
