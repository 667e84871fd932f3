"""Real measurements of one system, filtered as a run filters its draws."""

import warnings
from collections.abc import Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import ArrayLike

from pfdist.common.component_names import Component
from pfdist.common.parts import (
    Block,
    Cell,
    Facts,
    Page,
    Section,
    Table,
    Text,
    without_empty_columns,
)
from pfdist.common.rounding import rounded
from pfdist.common.shown import Shown
from pfdist.errors import PfdistWarning
from pfdist.filters.cloud import Prior
from pfdist.filters.filter_estimate import FEW, FilterEstimate, few_particles
from pfdist.filters.variants import at_the_moment
from pfdist.models.base import StateSpaceModel, within_half_turn
from pfdist.problem.clock import Clock, Time
from pfdist.problem.measurements import Measurements, read_measurements
from pfdist.problem.problem import JobSource
from pfdist.questions.planned_run import (
    Columns,
    UserTable,
    check_files,
    files_beside,
    filter_of,
    on_clock_of,
    planned_run,
    reading_of,
    table_argument,
)
from pfdist.questions.report import write_page
from pfdist.questions.subject import number_of
from pfdist.questions.surprises import IMPROBABLE, few_at
from pfdist.results import Run, finite
from pfdist.runner.filter import LEAST, SUSPICIOUS, Filter
from pfdist.runner.identity import time_columns
from pfdist.runner.progress import Say, heard, silent
from pfdist.store import FILTERED_PERCENTS, SMOOTHED_START, filtered_schema, frame_of
from pfdist.store.schema import components_in
from pfdist.store.user_tables import write_user_table

_P_DIGITS = 2
_FEW_ANCESTORS = 20
_SMOOTHED_SIZE = f"{SMOOTHED_START}effective_sample_size"
_TIMES = ("measured", "missing", "extra", "to_come")
_FACTS = ("surprise_of_all", "is_improbable", "collapsed", "log_evidence", "why_no_evidence")
_BELIEF = "Mean of the quantity of interest over time with 50 and 90 % bands, by the filter."
_SIZE = "Effective sample size of the filter's particles at each instant."


@dataclass(frozen=True, repr=False)
class FilteredMeasurements(Shown):
    """Result of `filter_measurements`.

    Parameters
    ----------
    run : Path or None
        None if the job has no run.
    job : str
        Name of the job.
    measurements : Path
        The file with the measurements.
    name : str
        Name of the compared set whose times were planned; empty without a run.
    measured : tuple of int or float
        Times with a measurement, on the clock, as all times below.
    missing, extra, to_come : tuple of int or float
        Planned times up to the last measurement that were not measured, measured times that were
        not planned, failed ones, too, and planned times after the last measurement.
    table : DataFrame
        A row for each instant, with the columns of `pfdist.store.filtered_schema`.
    log_evidence : float or None
        The log evidence of all measurements, by the filter's model.
    why_no_evidence : str
        Why there is no log evidence; empty if there is.
    files : tuple of Path
        The table, the figure, and the report if it was wanted; none for a DataFrame without `out`.
    clock : Clock
        That of the job, with the times of the table if the filter can have them.
    collapsed : int or float, optional
        The first time at which few particles or few values of a constant are left, if it comes;
        see `pfdist.filters.filter_estimate.FilterEstimate`. From it on, the estimate is that of a
        few particles, not the model's.
    is_smoothed : bool
        Whether the estimate of the job uses later measurements: `problem.estimate`, `problem.lag`.
    failed : tuple of int or float
        Times of measurements that were made without a value, by sensors with `fails` or `works`, or
        as codes of the table say.
    readings : mapping of str to list of (float, float)
        For each component of z whose name and unit a component of y has, by its suffix: the times
        and the values of that component.
    """

    run: Path | None
    job: str
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
    clock: Clock
    collapsed: Time | None = None
    is_smoothed: bool = False
    failed: tuple[Time, ...] = ()
    readings: Mapping[str, list[tuple[float, float]]] = field(default_factory=dict)

    @property
    def time_unit(self) -> str:
        """The unit of the clock; empty if the job has none."""
        return self.clock.time_unit

    @property
    def marked(self) -> tuple[tuple[Time, ...], ...]:
        """The times that a figure marks, each kind in its way."""
        return tuple(getattr(self, name) for name in _TIMES)

    @property
    def most_surprising(self) -> tuple[Time, float] | None:
        """Time and p-value of the most surprising measurement, if there is a measurement."""
        if not self.table["surprise"].notna().any():
            return None
        row = int(np.nanargmin(self.table["surprise"]))
        return self.table["t"][row].item(), float(self.table["surprise"][row])

    @property
    def surprise_of_all(self) -> float | None:
        """P-value of the most surprising among all measurements (Bonferroni), if there is one."""
        most = self.most_surprising
        return None if most is None else min(1.0, self.tested * most[1])

    @property
    def tested(self) -> int:
        """Number of p-values; failed measurements that say something about x have one, too."""
        return max(len(self.measured), int(self.table["surprise"].notna().sum()))

    @property
    def is_improbable(self) -> bool:
        """Whether the right model gives such measurements in less than 1 % of systems."""
        among_all = self.surprise_of_all
        return among_all is not None and among_all < IMPROBABLE

    def as_json(self) -> dict[str, Any]:
        """The result as JSON values, with the table as the path of its file."""
        most = self.most_surprising
        files = dict(zip(("table", "figure", "report"), map(str, self.files), strict=False))
        answer = {
            "run": self.run and str(self.run),
            "measurements": str(self.measurements),
            "planned": self.name or None,
            **{name: getattr(self, name) for name in _TIMES},
            **({"failed": self.failed} if self.failed else {}),
            "most_surprising": most and {"t": most[0], "surprise": most[1]},
            **{name: getattr(self, name) for name in _FACTS},
            **({"time_unit": self.time_unit} if self.time_unit else {}),
            **{name: files.get(name) for name in ("table", "figure", "report")},
        }
        return finite(answer)

    def _page(self) -> Page:
        facts = _facts(self)
        if surprise := _surprise(self):
            at, p, among = surprise
            facts.append(("most surprising", f"t = {at}, p {p} ({among} among all measurements)"))
        evidence = self.log_evidence
        none = f"none: {self.why_no_evidence}"
        facts.append(("log evidence", none if evidence is None else rounded(evidence)))
        section = Section("", [Text(_estimate(self), prominent=True), Facts(facts)])
        return Page("", "", [section], alarms=_alarms(self))


def filter_measurements(
    job: JobSource | Run,
    measurements: UserTable,
    *,
    planned: str = "",
    prior: UserTable | Prior | ArrayLike = "",
    columns: Columns | None = None,
    within: float | None = None,
    out: str | Path = "",
    results: str | Path | None = None,
    changes: Iterable[str] = (),
    report: bool = True,
    say: Say = silent,
) -> FilteredMeasurements:
    """Filter real measurements of one system, with the filter of a job.

    The estimate of z(t) uses the measurements up to t. Beside it stand smoothed estimates, from all
    measurements, or with problem.lag from those until a lag after t. They are left out if particles
    times squared instants are more than a billion.

    It writes a table, ``NAME.filtered.csv`` or ``.parquet`` like the measurements, a figure,
    ``NAME.filtered.png``, and a report, ``NAME.filtered.html``. They replace those of an earlier
    call, and no other file.

    Parameters
    ----------
    job : Problem, Job, str, Path or Run
        A job file, or the folder of a run. If a finished run of the job exists, its plan is
        compared with the times of the measurements.
    measurements : str, Path or DataFrame
        Table in CSV or Parquet, or a DataFrame, with the columns t, y0, y1, ... (or ``y_NAME``),
        and sensor if the model has sensors; any times, or no rows. An empty cell is a missing
        component, a row without any value a missed time (of a sensor with fails or works a spent
        measurement, of one with a delay a value on its way), a second row at a time a repeat.
    planned : str, optional
        Name of the compared set that was planned; by default the found set with the lowest expected
        MSE.
    prior : str, Path, DataFrame, Cloud or array, optional
        Table of particles from which the filter starts: columns x0, x1, ... (or ``x_NAME``), and
        optionally weight, and t, their time (by default the first).
    columns : mapping of str to str, or list of str, optional
        Names of the table's columns that have other names there, as ``t=time,y0=conc``.
    within : float, optional
        Largest distance from a time to the instant that is used instead, if the model's step does
        not read p.dt; by default half a step.
    out : str or Path, optional
        Folder of the table, the figure and the report; by default that of the given table.
    results : str or Path, optional
        Folder of the run; by default ``results/NAME`` of a job ``NAME.toml``, or
        ``results/NAME-plan`` if only that holds a run.
    changes : iterable of str, optional
        Other values of keys of the job, as ``seed=3 filter.particles=200``.
    report : bool
        Whether to write the report.
    say : callable, optional
        Receives a line for each model file before the file is run. Without it, an improbable
        measurement and an estimate of a few particles are a `pfdist.errors.PfdistWarning`, too.

    Returns
    -------
    FilteredMeasurements

    Raises
    ------
    StoreError
        The folder that is named has a run of another job or of other models, or a file cannot be
        written.
    JobError
        The run has no set of this name.
    MeasurementsError, PriorError
        A table does not fit, or a value in it is wrong.
    ModelError
        The model cannot be loaded, or a formula failed.
    """
    # Not above: the help of the command waits for no Matplotlib.
    from pfdist.plugins.filter import figure  # noqa: PLC0415

    table = table_argument("measurements", measurements)
    files = files_beside(table, out, "measurements", "filtered")[: 3 if report else 2]
    plan = planned_run(job, results, changes, say, planned, prior)
    of_job, believed = plan.built.job.problem.points, plan.built.evaluator.believed
    quantities = believed.named("z")
    schema = filtered_schema(quantities)
    check_files(files, time_columns(of_job).table(schema.empty_table()).schema, figure.TITLE)
    filtering = filter_of(plan.built, plan.prior)
    reading = reading_of(plan.built, columns, within, say)
    rows = read_measurements(table, believed, of_job.clock, filtering.now.t, reading)
    if rows.clock is not of_job.clock or rows.repeats > 1 or rows.given:
        plan = on_clock_of(plan, rows)
        filtering = filter_of(plan.built, plan.prior, repeats=rows.repeats)
    clock, points = rows.clock, replace(of_job, clock=rows.clock)
    made = rows.made_with(believed)
    # A planned time was measured if the nearest instant of the job to a measurement is that.
    places = [clock.instant(t) for t in of_job.clock.times]
    moved = [points.first(places[of_job.instant(t)]) + of_job.way(t) for t in plan.times]
    # Which of its repeats measures does not matter.
    wanted = points.canonical(t for t in moved if t >= points.first(filtering.now.t))
    tried = sorted({*made, *rows.failed})
    nearest = of_job.clock.nearest(clock.times[points.instant(t)] for t in tried)
    meant = [points.first(places[k]) + points.way(t) for k, t in zip(nearest, tried, strict=True)]
    filtered_estimates, lag = [*_estimates(filtering, rows)], plan.built.evaluator.lag
    if delays := plan.built.evaluator.delays:
        moment = replace(plan.built, evaluator=at_the_moment(plan.built.evaluator))
        prior_then = plan.prior and plan.prior.remembered(max(delays))
        late = filter_of(moment, prior_then, repeats=rows.repeats)
        filtered_estimates = [*_estimates(late, rows.arriving(believed, delays))]
    elif plan.built.job.problem.waited_for:
        heard(say, "Estimates at the moment leave the delay out: times are not on the job's clock")
    smoothed = list[FilterEstimate]()
    if len(filtered_estimates) <= filtering.unmeasured.most_smoothed:
        smoothed = filtering.smoothed(filtering.horizon, lag or None)
    estimates = _table(filtered_estimates, smoothed, quantities, believed.is_angle, schema)
    estimates = time_columns(points).table(estimates)
    collapsed = filtering.now.collapsed
    after = points.first(max((*rows.t, *rows.missed), default=-1) + 1)
    extra = [t for t, m in zip(tried, meant, strict=True) if plan.run and m not in wanted]
    result = FilteredMeasurements(
        plan.path,
        plan.built.job.path.stem,
        Path("measurements") if isinstance(table, pd.DataFrame) else table,
        plan.name,
        tuple(points.written_of(made)),
        tuple(points.written_of(t for t in wanted if t < after and t not in meant)),
        tuple(points.written_of(extra)),
        tuple(points.written_of(t for t in wanted if t >= after and t not in meant)),
        frame_of(estimates),
        filtering.log_evidence,
        filtering.why_no_evidence,
        files,
        clock,
        None if collapsed is None else clock.time(collapsed),
        lag != 0,
        tuple(points.written_of(rows.failed)),
        {} if of_job.delays else _readings(rows, believed),
    )
    if files:
        write_user_table(files[0], estimates)
        figure.draw_filtered(
            files[1],
            figure.filtered_plot(result.table, result.marked, result.is_smoothed, result.readings),
        )
    for file in files[2:]:
        write_page(_report_of(result), file)
    for line in _alarms(result) if say is silent else ():
        warnings.warn(line, PfdistWarning, stacklevel=2)
    return result


def _readings(rows: Measurements, model: StateSpaceModel) -> dict[str, list[tuple[float, float]]]:
    """The times and values of components of y with the name and unit of one of z, by its suffix."""
    suffixes = {each.label: each.suffix for each in model.named("z") if each.label}
    y = rows.y.reshape(len(rows.t), rows.repeats, model.components[1])
    times = rows.clock.times_of(rows.t)
    return {
        suffixes[each.label]: [
            (t, float(value))
            for t, values in zip(times, y[:, :, k], strict=True)
            for value in values[np.isfinite(values)]
        ]
        for k, each in enumerate(model.named("y"))
        if each.label in suffixes
    }


def _estimates(filtering: Filter, rows: Measurements) -> Iterable[FilterEstimate]:
    measured = dict(zip(rows.t, rows.y, strict=True))
    for t in range(filtering.now.t, filtering.horizon + 1):
        known = t in measured  # the answer warns
        yield filtering.update(t, measured[t], warn=False) if known else filtering.predict(t)


def _table(
    estimates: Iterable[FilterEstimate],
    smoothed: Sequence[FilterEstimate],
    quantities: Sequence[Component],
    is_angle: Sequence[bool],
    schema: pa.Schema,
) -> pa.Table:
    """The table of estimates; an angle is written at most half a turn from its last mean."""
    rows, mean = list[dict[str, Any]](), np.zeros(len(quantities))
    for estimate, later in zip_longest(estimates, smoothed):
        row: dict[str, Any] = {"t": estimate.t, "measured": estimate.measured}
        row["surprise"] = estimate.surprise
        mean = within_half_turn(estimate.mean, mean, is_angle)
        row |= _moments(estimate, mean, quantities, is_angle)
        if later is not None:
            around = within_half_turn(later.mean, mean, is_angle)
            moments = _moments(later, around, quantities, is_angle)
            row |= {f"{SMOOTHED_START}{name}": value for name, value in moments.items()}
        rows.append(row)
    return pa.Table.from_pylist(rows, schema=schema)


def _moments(
    estimate: FilterEstimate, mean: Any, quantities: Sequence[Component], is_angle: Sequence[bool]
) -> dict[str, float | None]:
    """The columns of an estimate, with angles around this mean."""
    levels = [percent / 100 for percent in FILTERED_PERCENTS]
    quantiles = within_half_turn(estimate.quantiles(levels), mean, is_angle)
    row: dict[str, float | None] = {"effective_sample_size": estimate.effective_sample_size}
    for k, component in enumerate(quantities):
        end = component.suffix
        row[f"mean_{end}"] = float(mean[k])
        row[f"sd_{end}"] = float(estimate.standard_deviation[k])
        for percent, values in zip(FILTERED_PERCENTS, quantiles, strict=True):
            row[f"q{percent:02d}_{end}"] = float(values[k])
    return row


# --- the pages ------------------------------------------------------------------------------------


def _report_of(answer: FilteredMeasurements) -> Page:
    sections = [_belief(answer), _fit(answer), _instants(answer.table, answer.clock)]
    file = answer.measurements.name
    whose = f"the run {answer.run.name}" if answer.run else f"the job {answer.job}"
    number = number_of(len(answer.measured), "measurement")
    subtitle = f"{number} of {file}, by the filter of {whose}"
    source = f"from the measurements {file} by the filter of {whose}"
    alarms = _alarms(answer)
    return Page("Filtered measurements", subtitle, sections, source=source, alarms=alarms)


def _facts(answer: FilteredMeasurements) -> list[tuple[str, str]]:
    times = {"measured at t": answer.measured}
    if answer.run is not None:
        times |= {
            "planned, missing": answer.missing,
            "planned, to come": answer.to_come,
            "measured, not planned": answer.extra,
        }
    facts = [(name, answer.clock.listed(each) or "none") for name, each in times.items()]
    if answer.failed:
        made = len(answer.failed) + len(answer.measured)
        failed = f"{len(answer.failed)} of {made}, t = {answer.clock.listed(answer.failed)}"
        facts.insert(1, ("failed", failed))
    few = _few_ancestors(answer)
    return [*facts, *[("smoothed estimates", few)] * bool(few)]


def _few_ancestors(answer: FilteredMeasurements) -> str:
    """The remedy for smoothed estimates of few particles; empty if there are enough."""
    rows = answer.table[answer.table[_SMOOTHED_SIZE] < _FEW_ANCESTORS]
    if not len(rows):
        return ""
    least = rows.iloc[rows[_SMOOTHED_SIZE].argmin()]
    at = answer.clock.listed([least["t"]])
    return (
        f"few ancestors: {least[_SMOOTHED_SIZE]:.0f} at t = {at}; more particles help, or "
        "problem.lag"
    )


def _surprise(answer: FilteredMeasurements) -> tuple[str, str, str] | None:
    """Time and p-value of the most surprising measurement, and the p-value among all."""
    if answer.most_surprising is None:
        return None
    (t, p), words = answer.most_surprising, ("= ", "")
    if answer.collapsed is not None and p < SUSPICIOUS:  # it may lie beyond all particles
        p, words = max(p, LEAST), ("at most ",) * 2
    values = p, min(1.0, answer.tested * p)
    alone, among = (
        f"{word}{rounded(each, _P_DIGITS)}" for word, each in zip(words, values, strict=True)
    )
    return answer.clock.listed([t]), alone, among


def _estimate(answer: FilteredMeasurements) -> str:
    """The estimate at the last measurement, or else at t = 0; and whether the model fits."""
    measured = answer.table[answer.table["measured"]]
    row = (measured if len(measured) else answer.table[::-1]).iloc[-1].to_dict()
    estimates, quantities = [], components_in(answer.table, "mean_")
    for each in quantities:
        values = (row[f"{key}_{each.suffix}"] for key in ("mean", "q05", "q95"))
        mean, low, high = (rounded(value, 3) for value in values)
        name = each.name or "z" + each.suffix * (len(quantities) > 1)
        unit = f" {each.unit}" * bool(each.unit)
        band = f"90 % band {low} to {high}" if low != high else "no band: few values are left"
        estimates.append(f"{name} = {mean}{unit} ({band})")
    at = answer.clock.listed([row["t"]])
    fits = "do not fit" if answer.is_improbable else "fit"
    made = number_of(len(answer.measured), "measurement")
    said = f" The {made} {fits if len(answer.measured) > 1 else fits.replace('do', 'does')}"
    is_known = bool(answer.measured) and answer.collapsed is None
    return f"At t = {at}: {', '.join(estimates)}." + f"{said} the model." * is_known


def _alarms(answer: FilteredMeasurements) -> list[str]:
    """Doubts about the estimate: few particles, an improbable measurement."""
    at, p, among = _surprise(answer) or ("", "", "")
    what = f"The measurement at t = {at} is improbable, p {p} ({among} among all)"
    improbable = f"{what}: the model may be wrong about this system."
    few, sizes = few_at(answer.collapsed, answer.clock), answer.table[_SMOOTHED_SIZE]
    if answer.is_smoothed and sizes.min() < FEW:
        least = answer.clock.listed([answer.table["t"][sizes.argmin()]])
        few.append(few_particles(f"for the smoothed estimate at t = {least}"))
    return [*few, *[improbable] * answer.is_improbable]


def _belief(answer: FilteredMeasurements) -> Section:
    # Not above: the answers without pictures, and the help, wait for no Matplotlib.
    from pfdist.plugins.filter.figure import filtered_plot  # noqa: PLC0415
    from pfdist.questions.pictures import picture  # noqa: PLC0415

    plot = filtered_plot(answer.table, answer.marked, answer.is_smoothed, answer.readings)
    said = Text(_estimate(answer), prominent=True)
    return Section("The estimate", [said, picture(plot, "belief", _BELIEF), Facts(_facts(answer))])


def _fit(answer: FilteredMeasurements) -> Section:
    """The fit of the measurements to the model, and the effective sample size."""
    from pfdist.pages.figure import Plot  # noqa: PLC0415  as in _belief
    from pfdist.plugins.filter.sizes_figure import effective_sample_size  # noqa: PLC0415
    from pfdist.questions.pictures import picture  # noqa: PLC0415

    blocks: list[Block] = []
    if surprise := _surprise(answer):
        at, p, among = surprise
        text = (
            f"The most surprising measurement is that at t = {at}: p {p}, and {among} among all "
            "measurements. A p-value near 0 means that the model hardly ever gives such a "
            "measurement."
        )
        blocks.append(Text(text))
    if answer.log_evidence is not None:
        blocks.append(Text(f"Log evidence of the model: {rounded(answer.log_evidence)}."))
    table = answer.table
    rows = table.dropna(subset="effective_sample_size")
    if len(rows):
        least = rows.iloc[rows["effective_sample_size"].argmin()]
        at, size = answer.clock.listed([least["t"]]), least["effective_sample_size"]
        title = f"The effective sample size is least at t = {at}: {size:.0f}."
        plot = Plot(2.0, lambda panels: effective_sample_size(table, ax=panels[0]), title=title)
        blocks.append(picture(plot, "size", _SIZE))
    return Section("How well they fit the model", blocks)


def _instants(table: pd.DataFrame, clock: Clock) -> Section:
    quantities = components_in(table, "mean_")
    is_single = len(quantities) == 1
    names = [
        f" of {each.label}" if each.label else "" if is_single else f" of z{k}"
        for k, each in enumerate(quantities)
    ]
    head = ["t", "measured", *(f"{what}{name}" for name in names for what in ("mean", "90 % band"))]
    rows = [_row(row, quantities, clock) for row in table.to_dict("records")]
    instants = Table("Estimate at each instant", [*head, "surprise"], rows, detail=True)
    return Section("All instants", [without_empty_columns(instants)])


def _row(row: Mapping[Hashable, Any], quantities: Sequence[Component], clock: Clock) -> list[Cell]:
    cells = [Cell(clock.text(row["t"]), row["t"]), Cell("yes" if row["measured"] else "no")]
    for each in quantities:
        mean, low, high = (row[f"{name}_{each.suffix}"] for name in ("mean", "q05", "q95"))
        cells.append(Cell(rounded(mean), mean))
        cells.append(Cell(f"{rounded(low)} to {rounded(high)}", low))
    surprise = row["surprise"]
    is_known = surprise is not None and not pd.isna(surprise)
    return [*cells, Cell(rounded(surprise, _P_DIGITS), surprise) if is_known else Cell("")]
