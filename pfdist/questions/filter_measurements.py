"""Real measurements of one system, filtered as a run filters its draws."""

import warnings
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import ArrayLike

from pfdist.common.arguments import path_argument
from pfdist.common.clock import Time
from pfdist.common.component_names import Component
from pfdist.common.parts import Page
from pfdist.common.shown import Shown
from pfdist.errors import PfdistWarning
from pfdist.filters.cloud import Prior
from pfdist.filters.filter import Filter
from pfdist.filters.filter_estimate import Estimate
from pfdist.filters.measurements import Measurements, read_measurements
from pfdist.models.base import within_half_turn
from pfdist.problem.source import JobSource
from pfdist.questions.filtered import filtered_answer, filtered_page
from pfdist.questions.planned_run import (
    Table,
    filter_of,
    planned_run,
    prior_argument,
    table_argument,
)
from pfdist.questions.report import write_page
from pfdist.questions.run_of_job import run_and_job
from pfdist.results import Run, finite
from pfdist.runner.progress import Say, silent
from pfdist.store import FILTERED_PERCENTS, ClockColumns, filtered_schema, frame_of
from pfdist.store.folder import check_page_replaceable
from pfdist.store.user_tables import check_table_replaceable, is_parquet, write_user_table

IMPROBABLE = 0.01  # for the most surprising of all measurements: the model may be wrong


@dataclass(frozen=True, repr=False)
class FilteredMeasurements(Shown):
    """Result of `filter_measurements`.

    Parameters
    ----------
    run : Path
    measurements : Path
        The file with the measurements.
    name : str
        Name of the compared set whose times were planned.
    measured : tuple of int or float
        Times with a measurement, on the clock of the job, as all times below.
    missing, extra, to_come : tuple of int or float
        Planned times up to the last measurement that were not measured, measured times that were
        not planned, and planned times after the last measurement.
    table : DataFrame
        A row for each instant, with the columns of `pfdist.store.filtered_schema`.
    log_evidence : float or None
        The log evidence of all measurements, by the filter's model.
    why_no_evidence : str
        Why there is no log evidence; empty if there is.
    files : tuple of Path
        The table, the figure, and the report if it was wanted; none for a DataFrame without `out`.
    time_unit : str
        The unit of the clock; empty if the job has none.
    """

    run: Path
    measurements: Path
    name: str
    measured: tuple[Time, ...]
    missing: tuple[Time, ...]
    extra: tuple[Time, ...]
    to_come: tuple[Time, ...]
    table: pd.DataFrame
    log_evidence: float | None
    why_no_evidence: str
    files: tuple[Path, ...]
    time_unit: str = ""

    @property
    def most_surprising(self) -> tuple[Time, float] | None:
        """Time and p-value of the most surprising measurement, if there is a measurement."""
        if not self.measured:
            return None
        row = int(np.nanargmin(self.table["surprise"]))
        return self.table["t"][row].item(), float(self.table["surprise"][row])

    @property
    def surprise_of_all(self) -> float | None:
        """P-value of the most surprising among all measurements (Bonferroni), if there is one."""
        most = self.most_surprising
        return None if most is None else min(1.0, len(self.measured) * most[1])

    @property
    def is_improbable(self) -> bool:
        """Whether a right model has such measurements in less than 1 % of systems."""
        among_all = self.surprise_of_all
        return among_all is not None and among_all < IMPROBABLE

    def as_json(self) -> dict[str, Any]:
        """The result as JSON values, with the table as the path of its file."""
        most = self.most_surprising
        files = dict(zip(("table", "figure", "report"), map(str, self.files), strict=False))
        answer = {
            "run": str(self.run),
            "measurements": str(self.measurements),
            "planned": self.name,
            "measured": self.measured,
            "missing": self.missing,
            "extra": self.extra,
            "to_come": self.to_come,
            "most_surprising": most and {"t": most[0], "surprise": most[1]},
            "surprise_of_all": self.surprise_of_all,
            "is_improbable": self.is_improbable,
            "log_evidence": self.log_evidence,
            "why_no_evidence": self.why_no_evidence,
            **({"time_unit": self.time_unit} if self.time_unit else {}),
            **{name: files.get(name) for name in ("table", "figure", "report")},
        }
        return finite(answer)

    def _page(self) -> Page:
        return filtered_answer(self.as_json())


def filter_measurements(
    job: JobSource | Run,
    measurements: Table,
    *,
    planned: str = "",
    prior: Table | Prior | ArrayLike = "",
    out: str | Path = "",
    results: str | Path | None = None,
    changes: Iterable[str] = (),
    report: bool = True,
    say: Say = silent,
) -> FilteredMeasurements:
    """Filter real measurements of one system, with the filter of a job.

    A table, ``NAME.filtered.csv`` or ``.parquet`` as the measurements are, a figure,
    ``NAME.filtered.png``, and a report, ``NAME.filtered.html``, are written. They replace those
    of an earlier call, and no other file.

    Parameters
    ----------
    job : Problem, Job, str, Path or Run
        A job file, whose run is meant, or the folder of a run.
    measurements : str, Path or DataFrame
        Table with the columns t, y0, y1, ... (or ``y_NAME``): a file in CSV or Parquet, or a
        DataFrame. An empty cell is a missing component, a row without any value a missed time. If
        the model has sensors, the column sensor names that of a row.
    planned : str, optional
        Name of the compared set whose times were planned; by default the found set with the lowest
        expected MSE.
    prior : str, Path, DataFrame, Cloud or array, optional
        Table of particles from which the filter starts: columns x0, x1, ... (or ``x_NAME``), if
        wanted weight, and t, their time (by default the first).
    out : str or Path, optional
        Folder of the table, the figure and the report; by default that of the measurements, and
        none for a DataFrame.
    results : str or Path, optional
        Folder of the run; by default ``results/NAME`` of a job ``NAME.toml``, or
        ``results/NAME-plan`` if only that holds a run.
    changes : iterable of str, optional
        Other values of keys of the job, as ``seed=3 filter.particles=200``.
    report : bool
        Whether to write the report, an HTML file that can be sent to anybody.
    say : callable, optional
        Receives a line for each model file before the file is run. Without it, an improbable
        measurement is a `pfdist.errors.PfdistWarning`, too.

    Returns
    -------
    FilteredMeasurements

    Raises
    ------
    StoreError
        There is no finished run of the job, or the run is of another job or of other models,
        or a file cannot be written.
    JobError
        The run has no set of this name.
    MeasurementsError, PriorError
        A table does not fit, or a value in it is wrong.
    ModelError
        The model cannot be loaded, or a formula failed.
    """
    # Not above: the help of the command waits for no Matplotlib.
    from pfdist.pages import filtered  # noqa: PLC0415

    table = table_argument("measurements", measurements)
    files, prior = _files(table, out)[: 3 if report else 2], prior_argument(prior)
    plan = planned_run(run_and_job(job, results, changes, say), planned, prior)
    believed = plan.built.evaluator.believed
    quantities = believed.named("z")
    schema = filtered_schema(quantities)
    check_table = partial(check_table_replaceable, schema=schema)
    checks: Sequence[Callable[[Path], None]]
    checks = check_table, filtered.check_figure_replaceable, check_page_replaceable
    for file, check in zip(files, checks, strict=False):
        check(file)
    filtering = filter_of(plan.built, plan.prior)
    problem = plan.built.job.problem
    clock = problem.clock
    rows = read_measurements(table, believed, clock, filtering.now.t)
    sensors, made = len(believed.parts), rows.made_with(believed)
    wanted = [t for t in plan.times if t >= filtering.now.t * sensors]
    estimates = _table(_estimates(filtering, rows), quantities, believed.is_angle, schema)
    if problem.has_clock:
        estimates = ClockColumns(clock.times, clock.unit).table(estimates)
    last = (max((*rows.t, *rows.missed), default=-1) + 1) * sensors - 1
    result = FilteredMeasurements(
        plan.run.path,
        Path("measurements") if isinstance(table, pd.DataFrame) else table,
        plan.name,
        tuple(clock.written_of(made)),
        tuple(clock.written_of(t for t in wanted if t <= last and t not in made)),
        tuple(clock.written_of(t for t in made if t not in wanted)),
        tuple(clock.written_of(t for t in wanted if t > last)),
        frame_of(estimates),
        filtering.log_evidence,
        filtering.why_no_evidence,
        files,
        clock.unit,
    )
    if files:
        write_user_table(files[0], estimates)
        marked = result.measured, result.missing, result.extra, result.to_come
        filtered.draw_filtered(files[1], filtered.filtered_plot(result.table, marked))
    for file in files[2:]:
        write_page(filtered_page(result.as_json(), result.table), file)
    for line in result._page().warnings if say is silent else ():
        warnings.warn(line, PfdistWarning, stacklevel=2)
    return result


def _files(measurements: Path | pd.DataFrame, out: str | Path) -> tuple[Path, ...]:
    """The files of the result. A table in memory has no folder: without `out` there are none."""
    folder = path_argument("out", out)
    if isinstance(measurements, pd.DataFrame):
        if not str(out):
            return ()
        measurements = folder / "measurements.csv"
    folder = folder if str(out) else measurements.parent
    suffix = "parquet" if is_parquet(measurements) else "csv"
    return tuple(
        folder / f"{measurements.stem}.filtered.{ending}" for ending in (suffix, "png", "html")
    )


def _estimates(filtering: Filter, rows: Measurements) -> Iterable[Estimate]:
    """The belief of the filter at each instant, by the measurements up to it."""
    measured = dict(zip(rows.t, rows.y, strict=True))
    for t in range(filtering.now.t, filtering.horizon + 1):
        yield filtering.update(t, measured[t]) if t in measured else filtering.predict(t)


def _table(
    estimates: Iterable[Estimate],
    quantities: Sequence[Component],
    is_angle: Sequence[bool],
    schema: pa.Schema,
) -> pa.Table:
    """The table of estimates; an angle is written at most half a turn from its last mean."""
    levels = [percent / 100 for percent in FILTERED_PERCENTS]
    rows, mean = list[dict[str, Any]](), np.zeros(len(quantities))
    for estimate in estimates:
        row: dict[str, Any] = {"t": estimate.t, "measured": estimate.measured}
        mean = within_half_turn(estimate.mean, mean, is_angle)
        quantiles = within_half_turn(estimate.quantiles(levels), mean, is_angle)
        for k, component in enumerate(quantities):
            end = component.suffix
            row[f"mean_{end}"] = float(mean[k])
            row[f"sd_{end}"] = float(estimate.standard_deviation[k])
            for percent, values in zip(FILTERED_PERCENTS, quantiles, strict=True):
                row[f"q{percent:02d}_{end}"] = float(values[k])
        row |= {
            "effective_sample_size": estimate.effective_sample_size,
            "surprise": estimate.surprise,
        }
        rows.append(row)
    return pa.Table.from_pylist(rows, schema=schema)
