"""The figures of a run as pictures of a page."""

from collections.abc import Collection, Iterable, Iterator

from pfdist.plots.figure import FIGURES, Tables
from pfdist.reports.parts import Picture
from pfdist.reports.svg import as_svg


def pictures(
    tables: Tables, names: Iterable[str], sets: Collection[str] | None = None
) -> Iterator[Picture]:
    """Give the figures of these names that a run has; none before the comparison has begun.

    Parameters
    ----------
    tables : Tables
    names : iterable of str
    sets : collection of str, optional
        Found sets that are shown, where each set has a figure; by default all.
    """
    if not tables.run.draws_compared:
        return
    for name in names:
        figure = FIGURES[name]
        shown = None if sets is None else {f"{name}-{found}" for found in sets}
        for file, plot in figure.plots(tables):
            if figure.each_set and shown is not None and file not in shown:
                continue
            yield Picture(plot.title, figure.description, as_svg(plot, file, figure.description))
