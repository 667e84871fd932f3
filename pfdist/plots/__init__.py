"""The figures of a run, one a file: from tables to axes. Figures read tables alone."""

from pfdist.plots import library  # noqa: F401  first: it decides how Matplotlib is imported
from pfdist.plots.budget import draw_target
from pfdist.plots.figures import draw_figures, figure_files, remove_figures
from pfdist.plots.filtered import check_figure_replaceable, draw_filtered
from pfdist.plots.why import draw_why

__all__ = [
    "check_figure_replaceable",
    "draw_figures",
    "draw_filtered",
    "draw_target",
    "draw_why",
    "figure_files",
    "remove_figures",
]
