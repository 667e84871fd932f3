"""Real measurements: the run that planned them, if any, the tables of a user, and the filter."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from functools import cache, partial
from numbers import Real
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
import pyarrow as pa
from numpy.typing import ArrayLike

from pfdist.common.arguments import columns_argument, path_argument
from pfdist.common.measurement_times import Times
from pfdist.common.nearest import must_be
from pfdist.errors import (
    JobError,
    MeasurementsError,
    MeasurementTimesError,
    RunMismatchError,
    StoreError,
    relative,
    shown,
)
from pfdist.filters.cloud import Prior
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.user_prior import as_prior
from pfdist.models.base import repeated
from pfdist.problem.added_sections import has_amounts
from pfdist.problem.calendar import names_dates
from pfdist.problem.clock import Clock, Time
from pfdist.problem.measurements import NO_CODES, Measurements, Reading
from pfdist.problem.problem import JobSource, as_job
from pfdist.questions.run_of_job import built_for_run, path_of_run, run_and_job
from pfdist.results import Run, open_run
from pfdist.results.sets import recommended
from pfdist.results.stored_run import job_of, measured_of
from pfdist.runner.build import Built, build, say_model_files
from pfdist.runner.filter import Filter, settings_of_job
from pfdist.runner.progress import Say, heard
from pfdist.runner.replicates import evaluator_on, follows_clock
from pfdist.store.folder import check_page_replaceable
from pfdist.store.user_tables import check_table_replaceable, is_parquet

Columns = Mapping[str, str] | str | Sequence[str]
"""Names of columns, as a mapping, a text ``t=time,y0=conc``, or a list of such texts."""
UserTable = str | Path | pd.DataFrame
"""The path of a table in CSV or Parquet, or a table in memory."""


def table_argument(name: str, value: Any) -> Path | pd.DataFrame:
    """An argument as a path or a DataFrame; an `ArgumentError` if it is neither."""
    return value if isinstance(value, pd.DataFrame) else path_argument(name, value)


def files_beside(
    table: Path | pd.DataFrame, out: str | Path, name: str, ending: str
) -> tuple[Path, ...]:
    """The table, the figure and the report that a question writes beside a table of a user.

    A table in memory has no folder: without `out` there are no files, and with it they begin with
    `name`.
    """
    folder = path_argument("out", out)
    if isinstance(table, pd.DataFrame):
        if not str(out):
            return ()
        table = folder / f"{name}.csv"
    folder = folder if str(out) else table.parent
    suffix = "parquet" if is_parquet(table) else "csv"
    return tuple(folder / f"{table.stem}.{ending}.{end}" for end in (suffix, "png", "html"))


def check_files(files: Sequence[Path], schema: pa.Schema, title: str) -> None:
    """Raise a `StoreError` if one of these files exists that an earlier call did not write.

    They are a table with this schema, a figure with this title, and a report, or only the first.
    """
    # Not above: the help of the command waits for no Matplotlib.
    from pfdist.pages.figure import check_figure_replaceable  # noqa: PLC0415

    check_table = partial(check_table_replaceable, schema=schema)
    check_figure = partial(check_figure_replaceable, title=title)
    checks: list[Callable[[Path], None]] = [check_table, check_figure, check_page_replaceable]
    for file, check in zip(files, checks, strict=False):
        check(file)


def next_in_words(clock: Clock, time: Time | str, *, is_last: bool = True) -> str:
    """When to measure next; dates have weekdays, as those of a plan.

    Beside sensors, the unit of time stands at the end: with later times, unless it is the last.
    """
    each = time.split(", ") if isinstance(time, str) else [time]
    if clock.has_dates:
        return f"on {', '.join(clock.in_words(each))}"
    is_bare = isinstance(time, str) and not is_last
    return f"at t = {time if is_bare else clock.listed(each)}"


class PlannedRun(NamedTuple):
    """A finished run of a job if it has one, the set that was planned, and what filters need.

    Parameters
    ----------
    run : Run or None
    name : str
        Name of the compared set whose times were planned; empty without a run.
    times : tuple of int
    built : Built
        The run's job, built.
    prior : Cloud, Gaussian or None
        Particles from which the filter starts, if the user gives some.
    """

    run: Run | None
    name: str
    times: Times
    built: Built
    prior: Prior | None

    @property
    def path(self) -> Path | None:
        """The folder of the run."""
        return None if self.run is None else self.run.path


def planned_run(
    job: JobSource | Run,
    results: str | Path | None,
    changes: Iterable[str],
    say: Say,
    planned: str,
    prior: UserTable | Prior | ArrayLike,
    *,
    must_be: bool = False,
) -> PlannedRun:
    """The finished run of a job, the set that was planned, and what filters need.

    If the job has no such run, the answer has no plan; with `must_be`, or a named set, this is an
    error. The other arguments are those of `pfdist.next_time`, and the errors those of
    `run_and_job`, of `_planned_set` and of `as_prior`.
    """
    table: Any = prior
    if isinstance(prior, str | Path):  # a model may change the working folder
        table = path_argument("prior", prior) if str(prior) else None
    if isinstance(job, Run):
        results, job = results or job.path, job_of(job) or job.path
    finished = run_and_job if must_be or planned else _run_if_any
    run, built = finished(job, results, changes, say)
    name = "" if run is None else _planned_set(run, planned)
    times = Times() if run is None else measured_of(run)[name]
    model, clock = built.evaluator.believed, built.job.problem.clock
    start = as_prior(table, model, clock.readers(), clock.instant_of_t)
    return PlannedRun(run, name, times, built, start)


def _run_if_any(
    job: JobSource, results: str | Path | None, changes: Iterable[str], say: Say
) -> tuple[Run | None, Built]:
    """The finished run of a job if it has one, and the job with its models; `say` hears why not.

    Raises a `StoreError` if the user names the folder of a different run, or of a run that cannot
    be read.
    """
    folder = path_of_run(as_job(job), results)
    why = f"{results} holds no run" if results else ""
    try:
        if folder and (run := open_run(folder)).state == "finished":
            return run, built_for_run(run, job, changes, say)
        if folder:
            why = f"{folder} is not finished ({run.state})"
    except StoreError as error:
        if results:
            raise
        why = str(error).partition("; ")[0]
        if isinstance(error, RunMismatchError):
            why = f"{folder} holds a different run ({error.differences[0]})"
    if why:
        heard(say, f"{relative(why)}: the answer uses no plan")
    alone = as_job(job, changes)
    say_model_files([alone], say)
    return None, build(alone, follows=True)


def _planned_set(run: Run, name: str) -> str:
    """The name of the set that was planned.

    Parameters
    ----------
    run : Run
    name : str
        Name of a compared set; if it is empty, that of the answer, see `recommended`.

    Raises
    ------
    JobError
        The run has no set of this name, or sets of several numbers of measurements and no name.
    """
    sets = run.sets
    if name in sets:
        return name
    if name:
        rule = f"a compared set of {run.path}, {', '.join(sets)}"
        raise JobError(must_be("planned", rule, name, sets), argument="planned")
    if has_amounts(run.job):
        raise JobError(
            f"{run.path} has times of several numbers of measurements: planned must say which, "
            f"for instance {list(sets)[-1]}",
            argument="planned",
        )
    own: str = recommended(run).name
    return own


def reading_of(built: Built, columns: Columns | None, within: float | None, say: Say) -> Reading:
    """How tables of a user are read: names of columns, and times that the job's clock lacks."""
    any_time = cache(partial(follows_clock, built))
    problem, note = built.job.problem, partial(heard, say)
    given = problem.given or {}
    return Reading(
        columns_argument(columns), within, any_time, note, problem.sensed, given=given,
        codes=problem.measurements or NO_CODES,
    )  # fmt: skip


def on_clock_of(plan: PlannedRun, rows: Measurements) -> PlannedRun:
    """The planned run, whose evaluator and prior are on the clock of a table; the job stays.

    The evaluator's models have the parameters that came with the table's readings.
    """
    own = plan.built.job.problem.clock
    if rows.clock is own and not rows.given:
        return plan
    evaluator = evaluator_on(plan.built, None if rows.clock is own else rows.clock, rows.given)
    built, prior = replace(plan.built, evaluator=evaluator), plan.prior
    at = None if prior is None else replace(prior, t=rows.clock.instant(own.times[prior.t]))
    return plan._replace(built=built, prior=at)


def filter_of(built: Built, prior: Prior | None = None, draw: int = 0, repeats: int = 1) -> Filter:
    """The filter of a job for one system, with the job's [model.filter], [filter] and seed.

    Parameters
    ----------
    built : Built
    prior : Cloud or Gaussian, optional
        The distribution of x(s), instead of the model's `initial`.
    draw : int
        Number of the system, which keys the noise.
    repeats : int
        Number of rows of each sensor in a measurement.

    Raises
    ------
    PriorError
        The prior does not fit the model.
    """
    settings = settings_of_job(built)
    settings["model"] = repeated(built.evaluator.believed, repeats)
    return Filter(**settings, prior=prior, draw=draw)


class SystemOfTable(NamedTuple):
    """The system of a table of measurements, on the clock of the table."""

    filtering: Filter  # a new filter
    evaluator: Evaluator
    taken: Times  # the points of the job nearest to those measured; one without a value is spent
    written: tuple[Any, ...]  # those measured, as the user reads them


def system_of_table(plan: PlannedRun, rows: Measurements) -> SystemOfTable:
    """The filter and the evaluator of a table's system, and what was measured."""
    points = plan.built.job.problem.points
    on, fine = replace(points, clock=rows.clock), on_clock_of(plan, rows)
    made = sorted({*rows.made_with(plan.built.evaluator.believed), *rows.failed})
    near = points.clock.nearest(rows.clock.times[on.instant(point)] for point in made)
    taken = sorted(points.first(k) + points.way(t) for k, t in zip(near, made, strict=True))
    filtering, evaluator = (
        filter_of(fine.built, fine.prior, repeats=rows.repeats),
        fine.built.evaluator,
    )
    if rows.repeats > 1:
        model, believed = (repeated(e, rows.repeats) for e in (evaluator.model, evaluator.believed))
        evaluator = replace(evaluator, model=model, filter_model=believed, estimations=())
    return SystemOfTable(filtering, evaluator, tuple(taken), tuple(on.written_of(made)))


def instant_now(
    now: Time | str | datetime, last: int, clock: Clock, note: Callable[[str], Any]
) -> int:
    """The instant of the last time that has passed, after checking it; `note` hears its reading."""
    number: Any = now
    is_number = isinstance(number, Real) and not isinstance(number, bool)
    may_be_date = isinstance(now, str) or (is_number and not math.isnan(number))
    if clock.has_dates and may_be_date and not names_dates(f"{now}"):
        try:  # as the column t of a table
            (number,) = clock.of_table(
                [number], lambda line: note(line.replace("t of the table", "now"))
            )
            is_number = True
        except ValueError as error:
            text = str(error).removeprefix("t ").replace(" (row 1)", "")
            raise MeasurementsError(f"now {text}", argument="now") from error
    if clock.counts and not (is_number and float(number).is_integer()):
        raise MeasurementsError(f"now must be an integer, got {shown(now)}", argument="now")
    first = clock.times[last]
    try:
        number = number if is_number else clock.times[clock.instant(number, "now")]
        if not first <= number <= clock.times[-1]:
            raise MeasurementsError(
                f"now must lie in {clock.text(first)}..{clock.text(clock.times[-1])}, got "
                f"{clock.text(number)}",
                argument="now",
            )
        return int(number) if clock.counts else clock.instant(number, "now")
    except MeasurementTimesError as error:
        raise MeasurementsError(str(error), argument="now") from error
