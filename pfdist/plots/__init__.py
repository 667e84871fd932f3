"""The figures, one a file: DataFrames in, Axes out. They read tables alone."""

from pfdist.plots.figures import draw_figures, figure_files, remove_figures

__all__ = ["draw_figures", "figure_files", "remove_figures"]
