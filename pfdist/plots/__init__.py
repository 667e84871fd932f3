"""The figures, one a file: DataFrames in, Axes out. They read tables alone."""

from pfdist.plots import library  # noqa: F401  first: it decides how Matplotlib is imported
from pfdist.plots.figures import draw_figures, draw_target, draw_why, figure_files, remove_figures

__all__ = ["draw_figures", "draw_target", "draw_why", "figure_files", "remove_figures"]
