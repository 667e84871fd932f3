"""Which figures a run has; draw them and save them."""

from collections.abc import Iterable
from functools import partial
from pathlib import Path

from matplotlib import rcParams
from matplotlib.figure import Figure as Canvas

from pfdist.analysis import Run
from pfdist.errors import StoreError
from pfdist.plots.figure import FIGURES, Plot, Tables
from pfdist.plots.library import styled
from pfdist.plots.panel import scaled
from pfdist.store import remove_file, write_file
from pfdist.store.folder import FIGURES_FOLDER, FORMATS, figures_in


def figure_files(run: Run) -> list[Path]:
    """List the files of all figures that a run has.

    Parameters
    ----------
    run : Run
        Its comparison has begun.
    """
    names = [name for figure in FIGURES.values() for name in figure.files(run)]
    return [file for name in names for file in _files(run, name)]


def remove_figures(path: Path) -> None:
    """Remove the figures of the run in this folder."""
    for file in figures_in(path):
        remove_file(file)


def draw_figures(run: Run, only: str = "") -> list[Path]:
    """Draw all figures of a run from its tables, or one, into its folder ``figures``.

    Parameters
    ----------
    run : Run
    only : str
        Name of the one figure that is wanted, as its file declares it; empty for all.

    Returns
    -------
    list of Path
        The files written.

    Raises
    ------
    StoreError
        The comparison has not begun, so there is nothing to draw; a table cannot be read; or a
        file cannot be written.
    """
    if run.state == "searching" or not run.draws_compared:
        raise StoreError(f"{run.path} has no compared draws yet: run the job on, then plot")
    tables, wanted = Tables(run), [FIGURES[only]] if only else FIGURES.values()
    return save_plots(run, (plot for figure in wanted for plot in figure.plots(tables)))


def save_plots(run: Run, plots: Iterable[tuple[str, Plot]]) -> list[Path]:
    """Draw plots in the style for print and save them into the folder ``figures`` of a run.

    Parameters
    ----------
    run : Run
    plots : iterable of (str, Plot)
        Names of files, without suffix, and what is drawn into them.

    Returns
    -------
    list of Path
        The files written, one for each plot and format.
    """
    files = []
    with styled():
        for name, plot in plots:
            files += _saved(run, name, drawn(plot), plot.title)
    return files


def save_plot(path: Path, plot: Plot, title: str) -> None:
    """Draw a plot in the style for print and save it as a PNG file anywhere.

    Parameters
    ----------
    path : Path
    plot : Plot
    title : str
        In ASCII. The file holds it unseen near its start.

    Raises
    ------
    StoreError
        The file cannot be written.
    """
    with styled():
        canvas = drawn(plot)
        write_file(path, partial(canvas.savefig, format="png", metadata={"Title": title}))


def drawn(plot: Plot) -> Canvas:
    """Draw a plot, as large as the style in use makes it.

    Parameters
    ----------
    plot : Plot

    Returns
    -------
    matplotlib Figure
        It belongs to no window.
    """
    width, height = rcParams["figure.figsize"][0], scaled(plot.height)
    canvas = Canvas(figsize=(width, height), layout="constrained")
    panels = canvas.subplots(plot.panels, squeeze=False, sharex=plot.share_x)
    plot.draw(panels[:, 0].tolist())
    return canvas


def _saved(run: Run, name: str, canvas: Canvas, title: str) -> list[Path]:
    files = _files(run, name)
    for file in files:
        write_file(file, partial(_save, canvas, file.suffix.removeprefix("."), title))
    return files


def _files(run: Run, name: str) -> list[Path]:
    return [run.path / FIGURES_FOLDER / f"{name}.{suffix}" for suffix in FORMATS]


def _save(canvas: Canvas, suffix: str, title: str, path: Path) -> None:
    about: dict[str, str | None] = {"Title": title} if title else {}
    if suffix == "svg":
        about["Date"] = None  # without a date, the same figure gives the same bytes
    canvas.savefig(path, format=suffix, metadata=about)
