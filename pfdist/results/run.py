"""A run on disk, as Python and notebooks see it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pfdist.common.arguments import path_argument
from pfdist.common.parts import Cell, Page, Section, Table
from pfdist.common.percent import cost, percent_with_interval
from pfdist.common.rounding import with_error
from pfdist.common.shown import Shown
from pfdist.errors import PfdistError, StoreError
from pfdist.results.stored_run import StoredRun, check_one_number, gains_of, problem_of
from pfdist.results.summary import SetResult, Summary, summary_of
from pfdist.store.schema import components_in

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
        """How far the run is, and what it has found; see `pfdist.results.summary.Summary`."""
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

            Times are those of the job's clock.

        Raises
        ------
        PfdistError
            xarray is not installed.
        StoreError
            A file cannot be read.
        """
        try:
            import xarray  # noqa: PLC0415  an optional library
        except ModuleNotFoundError:
            raise PfdistError(
                "to_datatree needs xarray, which is not installed: pip install 'pfdist[notebook]'"
            ) from None
        groups = {
            "comparison": _comparison,
            "trajectories": _trajectories,
            "evaluations": _evaluations,
        }
        tree = {name: group(self) for name, group in groups.items() if name in self.tables}
        about = {"run": str(self.path), "state": self.state, "model": self.job["model"]["name"]}
        problem = problem_of(self)
        if problem.has_clock:
            about["time_unit"] = problem.clock.unit
        return xarray.DataTree.from_dict({"/": xarray.Dataset(attrs=about), **tree})

    def _page(self) -> Page:
        try:
            summary = self.summary()
        except PfdistError:
            return Page("", _title(self), [])
        warnings = list(filter(None, [summary.unproved]))
        head = ("times", "measurements", "expected MSE ± standard error", "below the reference")
        rows = [[Cell(text) for text in _row(name, each)] for name, each in summary.results.items()]
        return Page("", _title(self), [Section("", [Table("", head, rows)])], warnings)


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
    return Run(path_argument("run", path))


def _title(run: Run) -> str:
    """A run in a line: its folder, its state and how many draws are compared."""
    try:
        return f"run {run.path}: {run.state}, {run.draws_compared:,} draws compared"
    except StoreError:
        return f"run {run.path}: cannot be read"


def _row(name: str, result: SetResult) -> tuple[str, ...]:
    mse = gain = ""
    if result.is_compared:
        mse = with_error(cost(result.expected_mse), result.standard_error)
    if result.gain_draws is not None:
        gain = percent_with_interval(result.gain_of_means, result.gain_of_means_interval)
    return name, str(result.measurements), mse, gain


def _comparison(run: StoredRun) -> xarray.Dataset:
    import xarray  # noqa: PLC0415  an optional library

    errors, gains = run.table("comparison").set_index("draw"), gains_of(run).set_index("draw")
    # A reference has no gain over itself.
    gains = gains.reindex(columns=[f"gain_{name}" for name in run.names])
    mse = errors[[f"mse_{name}" for name in run.names]]
    group = xarray.Dataset(
        {"mse": (("draw", "set"), mse.to_numpy()), "gain": (("draw", "set"), gains.to_numpy())},
        {"draw": errors.index, "set": run.names},
    )
    return group.assign(scenario=("draw", errors["scenario"])) if "scenario" in errors else group


def _trajectories(run: StoredRun) -> xarray.Dataset:
    import xarray  # noqa: PLC0415  an optional library

    rows = run.table("trajectories")
    quantities = [each.suffix for each in components_in(rows, "z_")]
    measured = [each.suffix for each in components_in(rows, "y_")]
    cube = rows.set_index(["draw", "t"]).to_xarray().rename(t="time")

    def stacked(columns: list[str], *shape: int) -> Any:
        """Columns as the last axes of an array, (draw, time, ...)."""
        values = np.stack([cube[column].to_numpy() for column in columns], axis=-1)
        return values.reshape(*values.shape[:2], *shape)

    estimates = [f"estimate_{name}_{suffix}" for name in run.names for suffix in quantities]
    arrays = {
        "z": (("draw", "time", "component"), stacked([f"z_{each}" for each in quantities], -1)),
        "y": (("draw", "time", "measured"), stacked([f"y_{each}" for each in measured], -1)),
        "estimate": (
            ("draw", "time", "set", "component"),
            stacked(estimates, len(run.names), len(quantities)),
        ),
    }
    names = {"set": run.names, "component": quantities, "measured": measured}
    return xarray.Dataset(arrays, {"draw": cube["draw"], "time": cube["time"], **names})


def _evaluations(run: StoredRun) -> xarray.Dataset:
    rows = run.table("evaluations")
    # Sets have several lengths, and an array of texts can be saved.
    texts = [", ".join(map(str, times)) for times in rows["measurement_times"]]
    return rows.assign(measurement_times=texts).rename_axis("row").to_xarray()
