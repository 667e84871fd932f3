"""A run on disk, as Python and notebooks see it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from pfdist.analysis.datatree import datatree_of
from pfdist.analysis.stored_run import StoredRun, check_one_number
from pfdist.analysis.summary import SetResult, Summary, summary_of
from pfdist.common.percent import cost, percent_with_interval
from pfdist.common.rounding import with_error
from pfdist.documents.notebook import Shown
from pfdist.documents.parts import Cell, Page, Section, Table
from pfdist.errors import StoreError, shown

if TYPE_CHECKING:
    import xarray


class Run(StoredRun, Shown):
    """A run on disk, finished or not; made by `open_run`.

    Attributes
    ----------
    path : Path
        Its folder.
    job : dict
        The resolved job.
    """

    @property
    def best(self) -> SetResult:
        """The times to measure at, and their results: the found set of least expected MSE.

        The errors are those of the comparison; of the worst scenario, if the job asks for it. If no
        search has run, it is the best of the job's own sets.

        Raises
        ------
        StoreError
            The comparison has not begun, or the run has times of several numbers of measurements.
        """
        check_one_number(self)
        summary = self.summary()
        result = summary.results[summary.by_error[0]]
        if not result.is_compared:
            raise StoreError(f"{self.path} has compared no draws yet: it is {summary.state}")
        return result

    def summary(self) -> Summary:
        """How far the run is, and what it has found; see `pfdist.analysis.summary.Summary`."""
        return summary_of(self)

    def to_datatree(self) -> xarray.DataTree:
        """The run as a tree of labelled arrays, for xarray and ArviZ.

        Returns
        -------
        xarray.DataTree
            A group for each of these tables that the run has:

            - ``comparison``: mse and gain (draw, set). A reference has no gain.
            - ``trajectories``: z (draw, time, component), y (draw, time, measured), and estimate
              (draw, time, set, component).
            - ``evaluations``: the columns of the table (row).

            Times are those of the job's clock. Errors of degenerate draws are NaN.

        Raises
        ------
        PfdistError
            xarray is not installed.
        StoreError
            A file cannot be read.
        """
        return datatree_of(self)

    def _page(self) -> Page:
        return run_card(self)

    def __repr__(self) -> str:
        return f"<{title_of(self)}>"


def open_run(path: str | Path) -> Run:
    """A run in a folder, opened for reading.

    Parameters
    ----------
    path : str or Path

    Returns
    -------
    Run

    Raises
    ------
    StoreError
        The folder holds no run, or one that cannot be read.
    """
    if not isinstance(path, str | Path):
        raise StoreError(f"a run must be the path of its folder, got {shown(path)}", argument="run")
    return Run(Path(path))


def title_of(run: Run) -> str:
    """A run in a line: its folder, its state and how many draws are compared.

    Parameters
    ----------
    run : Run
    """
    try:
        return f"run {run.path}: {run.state}, {run.draws_compared:,} draws compared"
    except StoreError:
        return f"run {run.path}: cannot be read"


def run_card(run: Run) -> Page:
    """The sets of a run with their expected MSE and gain."""
    try:
        results = run.summary().results
    except StoreError:
        return Page("", title_of(run), [])
    head = ("times", "measurements", "expected MSE", "below the reference")
    rows = [[Cell(text) for text in _row(name, each)] for name, each in results.items()]
    return Page("", title_of(run), [Section("", [Table("", head, rows)])])


def _row(name: str, result: SetResult) -> tuple[str, ...]:
    mse = gain = ""
    if result.is_compared:
        mse = with_error(cost(result.expected_mse), result.standard_error)
    if result.gain_draws is not None:
        gain = percent_with_interval(result.gain_of_means, result.gain_of_means_interval)
    return name, str(result.measurements), mse, gain
