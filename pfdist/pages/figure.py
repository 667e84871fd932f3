"""Figures of a run: how a figure is declared, which a run has, and their files.

A module of `pfdist.plots` declares its figures. `pfdist plot` and the folder of a run have all of
them; a report shows those that a chapter of `pfdist.questions` names.
"""

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.figure import Figure as Canvas
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.text import Text
from matplotlib.transforms import Bbox

from pfdist.common.registry import Registry
from pfdist.common.stopping import check
from pfdist.errors import StoreError, one_line, printable
from pfdist.pages.panel import scaled, table_of
from pfdist.pages.style import styled
from pfdist.problem.added_sections import has_amounts
from pfdist.results import ComparisonStatistics, Run
from pfdist.results.stored_run import statistics_of
from pfdist.store import holds_run, record_pages, write_file
from pfdist.store.files import begins_with, check_replaceable
from pfdist.store.folder import FIGURES_FOLDER, FORMATS

Applies = Callable[[Run], bool]
_OWN = FORMATS[0]  # of every figure
_START = 4096  # number of bytes at the start of a file that contain its title
_WIDER = (1.0, 1.6, 2.0)  # width of a figure with so many columns, over that of the style


@dataclass(frozen=True)
class Plot:
    """The size of a figure, and what draws it.

    Parameters
    ----------
    height : float
        In inches, for a font of 8 points; it scales with the font of the style. The style gives
        the width.
    draw : callable
        Draws into the panels, from top to bottom.
    panels : int
        Number of panels in a column.
    share_x : bool
        Whether the panels share one horizontal axis.
    title : str
        The finding, in a sentence. It is not drawn; reports show it beside the figure, and files
        have it as their title.
    heights : sequence of float, optional
        Relative heights of the rows of panels; by default all are equal.
    columns : int
        Number of columns of panels. Panels are drawn row by row.
    """

    height: float
    draw: Callable[[Sequence[Axes]], Any]
    panels: int = 1
    share_x: bool = False
    title: str = ""
    heights: Sequence[float] | None = None
    columns: int = 1


class Tables:
    """A run, and the tables of it that several figures need, each read once.

    Parameters
    ----------
    run : Run
    """

    def __init__(self, run: Run) -> None:
        self.run = run

    @cached_property
    def statistics(self) -> ComparisonStatistics:
        """Statistics of the comparison."""
        return statistics_of(self.run)

    @cached_property
    def trajectories(self) -> pd.DataFrame:
        """Truth, measurements and estimates of the first draws."""
        return table_of(self.run, "run", "trajectories")

    @cached_property
    def gains_of_trajectories(self) -> pd.DataFrame:
        """Relative gains of the draws that have trajectories, by draw."""
        draws = int(self.trajectories["draw"].max()) + 1
        return self.run.table("gains", draws).set_index("draw")


@dataclass(frozen=True)
class Figure:
    """A figure that a run can have.

    Parameters
    ----------
    name : str
        File name without suffix; with ``each_set`` the first part of it.
    description : str
        The figure in one line: what it shows of any run. Reports take it as alternative text.
    plot : callable
        The plot of `Tables`; with ``each_set`` of `Tables` and the name of a set.
    applies : callable
        Whether a run has the figure.
    each_set : bool
        Whether there is a file ``<name>-<set>`` for each compared set but the reference.
    """

    name: str
    description: str
    plot: Callable[..., Plot]
    applies: Applies
    each_set: bool = False

    def files(self, run: Run) -> list[str]:
        """Names of the figure's files of a run, without suffix."""
        return list(self._arguments(run))

    def plots(self, tables: Tables) -> Iterator[tuple[str, Plot]]:
        """The name of each file, without suffix, and the plot in it."""
        for file, arguments in self._arguments(tables.run).items():
            yield file, self.plot(tables, *arguments)

    def _arguments(self, run: Run) -> dict[str, tuple[str, ...]]:
        """Arguments of ``plot``, beside the tables, by the name of the file."""
        if not self.applies(run):
            return {}
        if self.each_set:
            return {f"{self.name}-{name}": (name,) for name in run.names[1:]}
        return {self.name: ()}


FIGURES: Registry[Figure] = Registry("pfdist.pages", hook="figures")


def one_number(run: Run) -> bool:
    """Whether the sets of a run have one number of measurements."""
    return not has_amounts(run.job)


def figure(
    name: str, *, applies: Applies = lambda run: True, each_set: bool = False
) -> Callable[[Callable[..., Plot]], Callable[..., Plot]]:
    """Declare a function as a figure; the first line of the docstring describes the figure.

    Parameters
    ----------
    name : str
        File name without suffix; with ``each_set`` the first part of it.
    applies : callable
        Whether a run has the figure; by default every run has it.
    each_set : bool
        Whether there is a file ``<name>-<set>`` for each compared set but the reference. The
        function is then called with the name of a set, too.
    """

    def declare(plot: Callable[..., Plot]) -> Callable[..., Plot]:
        description = (plot.__doc__ or "").partition("\n")[0]
        FIGURES.declare(name, Figure(name, description, plot, applies, each_set))
        return plot

    return declare


def draw_missing_figures(run: Run, there: Collection[Path]) -> list[Path]:
    """Draw those figures of a run whose files are not all there. The comparison has begun.

    Parameters
    ----------
    run : Run
    there : collection of Path
        Files that exist and are of the tables as they are now; others are replaced.

    Returns
    -------
    list of Path
        The files that were drawn.
    """
    tables = Tables(run)
    missing = (
        figure
        for figure in FIGURES.values()
        if not all(file in there for name in figure.files(run) for file in _files(run.path, name))
    )
    return save_plots(run.path, (plot for figure in missing for plot in figure.plots(tables)))


def draw_figures(run: Run, only: str = "", formats: Sequence[str] = ()) -> list[Path]:
    """The files of all figures of a run, or of one, drawn from its tables into ``figures``.

    Parameters
    ----------
    run : Run
    only : str
        Name of one figure of `FIGURES`; empty for all.
    formats : sequence of str
        Further formats, of `FORMATS`. Every figure is a PNG file; a file of another format that is
        there already is drawn again, too.

    Returns
    -------
    list of Path

    Raises
    ------
    StoreError
        The comparison has not begun, so there is nothing to draw; a table cannot be read; or a
        file cannot be written.
    """
    if run.state == "searching" or not run.draws_compared:
        raise StoreError(
            f"{run.path} has no compared draws yet: resume it first, `pfdist run {run.path}`"
        )
    tables, wanted = Tables(run), [FIGURES[only]] if only else FIGURES.values()
    plots = (plot for figure in wanted for plot in figure.plots(tables))
    return save_plots(run.path, plots, formats)


def save_plots(
    folder: Path, plots: Iterable[tuple[str, Plot]], formats: Sequence[str] = ()
) -> list[Path]:
    """The files of plots, drawn in the style for print into ``figures`` of a run or a sweep.

    Each plot comes with the name of its files, without suffix. For the formats see `draw_figures`.
    """
    saved = []
    with styled():
        for name, plot in plots:
            canvas, files = drawn(plot), _files(folder, name, formats)
            for file in files:
                write_file(file, partial(_save, canvas, file.suffix.removeprefix("."), plot.title))
            saved += files
    if holds_run(folder):
        record_pages(folder, saved)
    return saved


def save_plot(path: Path, plot: Plot, title: str) -> None:
    """Draw a plot in the style for print into any PNG file.

    The title, in ASCII, is not drawn. It is metadata near the start of the file, by which a later
    call recognises an earlier figure. Raises as `check_figure_replaceable`.
    """
    check_figure_replaceable(path, title)
    with styled():
        write_file(path, partial(_save, drawn(plot), "png", title))


def check_figure_replaceable(path: Path, title: str) -> None:
    """Raise a `StoreError` if a file exists that is no earlier figure with this title."""
    check_replaceable(path, partial(begins_with, mark=title.encode(), most=_START))


def drawn(plot: Plot) -> Canvas:
    """A canvas with a plot, in the size that the style in use gives; it has no window.

    The layout is computed here, once. A canvas with a layout engine would draw everything twice
    for each format.
    """
    check()
    dots = rcParams["savefig.dpi"]  # an inch; "figure" in styles that have no number
    canvas = Canvas(figsize=_size(plot), dpi=None if dots == "figure" else dots)
    canvas.set_layout_engine("none")  # in any style
    _fill(canvas, plot)
    _remove_control_characters(canvas)
    ConstrainedLayoutEngine().execute(canvas)
    for panel in canvas.axes:  # the last bits of a layout differ, and are part of names in SVG
        panel.set_position(Bbox.from_bounds(*np.round(panel.get_position().bounds, _DIGITS)))
    return canvas


def shown_by_pyplot(plot: Plot) -> Sequence[Axes]:
    """The panels of a plot in a new figure of pyplot, row by row."""
    from matplotlib import pyplot  # noqa: PLC0415  chooses a backend, which files do not need

    canvas = pyplot.figure(layout="constrained")
    canvas.set_size_inches(_size(plot))
    return _fill(canvas, plot)


def _size(plot: Plot) -> tuple[float, float]:
    return rcParams["figure.figsize"][0] * _WIDER[plot.columns - 1], scaled(plot.height)


_DIGITS = 9  # of the places of panels, as shares of the canvas


def _fill(canvas: Canvas, plot: Plot) -> Sequence[Axes]:
    panels = canvas.subplots(
        plot.panels, plot.columns, squeeze=False, height_ratios=plot.heights,
        sharex="col" if plot.share_x else False,
    )  # fmt: skip
    plot.draw(every := panels.ravel().tolist())
    return every


def _remove_control_characters(canvas: Canvas) -> None:
    """Replace control characters: a run from elsewhere may have them in its names."""
    for axis in (axis for panel in canvas.axes for axis in (panel.xaxis, panel.yaxis)):
        labels = [label.get_text() for label in axis.get_ticklabels()]
        if (shown := [*map(printable, labels)]) != labels:
            axis.set_ticks(axis.get_ticklocs(), shown)
    for text in canvas.findobj(Text):
        text.set_text(printable(text.get_text()))


def _files(folder: Path, name: str, formats: Sequence[str] = ()) -> list[Path]:
    files = {suffix: folder / FIGURES_FOLDER / f"{name}.{suffix}" for suffix in FORMATS}
    return [
        files[suffix] for suffix in files if suffix in (_OWN, *formats) or files[suffix].exists()
    ]


def _save(canvas: Canvas, suffix: str, title: str, path: Path) -> None:
    about: dict[str, str | None] = {"Title": one_line(title)} if title else {}
    if suffix != "png":  # without a date, the same figure gives the same bytes
        about["CreationDate" if suffix == "pdf" else "Date"] = None
    canvas.savefig(path, format=suffix, metadata=about)
