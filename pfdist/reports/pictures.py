"""The figures of a run as pictures of a page."""

from collections.abc import Iterable, Iterator

from pfdist.plots.figure import FIGURES, Tables
from pfdist.reports.parts import Picture
from pfdist.reports.svg import as_svg


def pictures(tables: Tables, names: Iterable[str]) -> Iterator[Picture]:
    """Give the figures of these names that a run has; none before the comparison has begun.

    Parameters
    ----------
    tables : Tables
    names : iterable of str
    """
    if not tables.run.draws_compared:
        return
    for name in names:
        figure = FIGURES[name]
        for file, plot in figure.plots(tables):
            yield Picture(plot.title, figure.description, as_svg(plot, file, figure.description))
