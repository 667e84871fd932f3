"""The time to measure next, from a run and the measurements so far."""

import warnings
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from datetime import datetime
from itertools import chain
from operator import itemgetter
from pathlib import Path
from typing import Any

import pandas as pd
from numpy.typing import ArrayLike

from pfdist.common.estimate import Estimate
from pfdist.common.parts import Facts, Page, Section, Text
from pfdist.common.plugins import asked
from pfdist.common.rounding import with_error, with_interval
from pfdist.common.shown import Shown
from pfdist.errors import ArgumentError, PfdistWarning
from pfdist.filters.cloud import Prior
from pfdist.filters.estimate import Evaluation
from pfdist.filters.filter_estimate import FilterEstimate
from pfdist.plugins.online.planner import Planner
from pfdist.problem.clock import Clock, Time
from pfdist.problem.measurements import Measurements, Reading, read_measurements
from pfdist.problem.problem import JobSource
from pfdist.questions.planned_run import (
    Columns,
    PlannedRun,
    UserTable,
    instant_now,
    next_in_words,
    planned_run,
    reading_of,
    system_of_table,
    table_argument,
)
from pfdist.questions.subject import number_of
from pfdist.questions.surprises import IMPROBABLE, SEE_SURPRISE, few_at, surprise_of
from pfdist.results import Run, finite
from pfdist.runner.progress import Say, silent

_SHOWN = 4  # planned times that are named


@dataclass(frozen=True, repr=False)
class NextTime(Shown):
    """Result of `next_time`.

    Parameters
    ----------
    run : Path or None
        None if the job has no run.
    name : str
        Name of the compared set whose times were planned before anything was measured; empty
        without a run.
    measured : tuple of int or float
        Times with a measurement, on the clock of the job, as all times below.
    now : int or float
        The last time that has passed. Errors are expected from it on.
    plan : tuple of int or float
        Times that are left to be measured, the next first; empty if the budget is spent.
    left : int or None
        Number of measurements that are left of the budget; None if they have prices.
    planned_before : tuple of int or float
        Times of the first plan that are left.
    expected, expected_before : Evaluation
        Expected MSE from `now` to T with both plans, on the same fresh simulated systems. An exact
        engine needs none. `expected_before` is None if the first plan is no longer possible.
    surprise : float or None
        P-value of the most surprising among all measurements (Bonferroni), if there is one.
    clock : Clock
        That of the job.
    collapsed : int or float, optional
        The first time at which few particles or few values of a constant are left, if it comes.
        The plan then starts from a few particles.
    in_flight : tuple of int or float
        Times of measurements whose values arrive after `now`.
    always : tuple of int or float
        Planned times of sensors that measure at required times alone: those that are always on.
    failed : tuple of int or float
        Times of measurements that were made without a value, which are spent, too.
    """

    run: Path | None
    name: str
    measured: tuple[Time, ...]
    now: Time
    plan: tuple[Time, ...]
    left: int | None
    planned_before: tuple[Time, ...]
    expected: Evaluation
    expected_before: Evaluation | None
    surprise: float | None
    clock: Clock
    collapsed: Time | None = None
    in_flight: tuple[Time, ...] = ()
    always: tuple[Time, ...] = ()
    failed: tuple[Time, ...] = ()

    @property
    def difference(self) -> Estimate | None:
        """`expected` less `expected_before`, paired by simulated system; None without the second.

        Its `interval()` is the 95 % confidence interval.
        """
        before = self.expected_before
        return None if before is None else self.expected.difference(before)

    @property
    def time_unit(self) -> str:
        """The unit of the clock; empty if the job has none."""
        return self.clock.time_unit

    @property
    def next(self) -> Time | None:
        """The time to measure next; None if the budget is spent."""
        return self._chosen[0] if self.plan else None

    @property
    def _chosen(self) -> tuple[Time, ...]:
        """The planned times but those of sensors that are always on, if there are others."""
        return tuple(each for each in self.plan if each not in self.always) or self.plan

    @property
    def is_improbable(self) -> bool:
        """Whether the right model gives such measurements in less than 1 % of systems."""
        return self.surprise is not None and self.surprise < IMPROBABLE

    def as_json(self) -> dict[str, Any]:
        """The result as JSON values."""
        before, apart = self.expected_before, self.difference
        low, high = apart.interval() if apart else (None, None)
        answer = {
            "run": self.run and str(self.run),
            "planned": self.name or None,
            "measured": self.measured,
            **({"failed": self.failed} if self.failed else {}),
            **({"in_flight": self.in_flight} if self.in_flight else {}),
            "now": self.now,
            "next": self.next,
            "plan": self.plan,
            "left": self.left,
            "expected_mse": self.expected.expected_mse,
            "standard_error": self.expected.standard_error,
            "planned_before": self.planned_before,
            "expected_mse_before": before and before.expected_mse,
            "standard_error_before": before and before.standard_error,
            "difference": apart and apart.value,
            "difference_low": low,
            "difference_high": high,
            "draws": self.expected.draws,
            "surprise_of_all": self.surprise,
            "is_improbable": self.is_improbable,
            "collapsed": self.collapsed,
            **({"time_unit": self.time_unit} if self.time_unit else {}),
        }
        return finite(answer)

    def _page(self) -> Page:
        number, clock = number_of(len(self.measured), "measurement"), self.clock
        facts, every = [("expected MSE", self._expected(self.expected))], list[tuple[str, str]]()
        if self.plan:
            following, *later = self._chosen
            said = f"Measure next {next_in_words(clock, following, is_last=not later)}"
            if later:
                at = "on about" if clock.has_dates else "at about"
                said += f"; then {at} {self._listed(later[:_SHOWN])}"
            if more := len(later[_SHOWN:]):
                said += f", and {more} more"
                every.append(("all times", self._listed(self._chosen)))
            measured = clock.listed(self.measured)
            where = f"{number}{', at t = ' * bool(measured)}{measured}"
            to_come = f"of t = {clock.listed(self.in_flight)}"
            waiting = [("values to come", to_come)] * bool(self.in_flight)
            on = [("required", f"t = {clock.listed(self.always)}")] * bool(self.always)
            facts = [("measured", where), *self._failures(), *waiting, *on, *facts, *self._before()]
        elif self.left == 0:
            said = f"The budget is spent: {number}"
            facts = [*self._failures(), *facts]
        else:
            said = f"No further measurement is possible after {number}"
        blocks = Text(f"{said}.", prominent=True), Facts(every, detail=True), Facts(facts)
        section = Section("", blocks)
        alarms = [*few_at(self.collapsed, clock), *[SEE_SURPRISE] * self.is_improbable]
        return Page("", "", [section], alarms=alarms)

    def _failures(self) -> list[tuple[str, str]]:
        """The measurements that failed, among all that are spent."""
        made = len(self.failed) + len(self.measured)
        failed = f"{len(self.failed)} of {made}, t = {self.clock.listed(self.failed)}"
        return [("failed", failed)] * bool(self.failed)

    def _listed(self, times: Iterable[Time]) -> str:
        is_dated = self.clock.has_dates
        return ", ".join(self.clock.in_words(times)) if is_dated else self.clock.listed(times)

    def _before(self) -> list[tuple[str, str]]:
        """The plan that was made before these measurements, if it differs."""
        if self.run is None or self.planned_before == self.plan:
            return []
        times = self.clock.listed(self.planned_before)
        if not times:
            return [("planned before", "no further measurement")]
        if self.expected_before is None:
            return [("planned before", f"t = {times}, no longer possible")]
        apart = self.expected.difference(self.expected_before)
        value, *ends = with_interval(apart.value, *apart.interval())
        interval = f"(95 % CI {' to '.join(ends)})" if apart.standard_error else "(exact)"
        return [("planned before", f"t = {times}"),
                ("its expected MSE", self._expected(self.expected_before)),
                ("new less old plan", f"{value} {interval}")]  # fmt: skip

    def _expected(self, evaluation: Evaluation) -> str:
        mse = with_error(evaluation.expected_mse, evaluation.standard_error)
        return f"{mse} from t = {self.clock.listed([self.now])} on"


def next_time(
    job: JobSource | Run,
    measurements: UserTable,
    *,
    now: Time | str | datetime | None = None,
    planned: str = "",
    prior: UserTable | Prior | ArrayLike = "",
    columns: Columns | None = None,
    within: float | None = None,
    rule: bool = False,
    results: str | Path | None = None,
    changes: Iterable[str] = (),
    say: Say = silent,
) -> NextTime | Shown:
    """Choose when to measure a system next, from the measurements so far.

    Parameters
    ----------
    job : Problem, Job, str, Path or Run
        A job file, or the folder of a run. Without a finished run of the job, the measurements
        alone plan.
    measurements : str, Path or DataFrame
        Table in CSV or Parquet, or a DataFrame, with the columns t, y0, y1, ... (or ``y_NAME``),
        and sensor if the model has sensors; any times, or no rows. An empty cell is a missing
        component, a row without any value a missed time (of a sensor with fails or works a spent
        measurement, of one with a delay a value on its way), a second row at a time a repeat.
    now : int, float, str or datetime, optional
        The last time that has passed, or its date, if nothing was measured at the end. Times
        planned up to it are planned again for later.
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
    rule : bool
        Measure by the rule that ``pfdist rule`` tuned last for the run, instead of a new plan.
    results : str or Path, optional
        Folder of the run; by default ``results/NAME`` of a job ``NAME.toml``, or
        ``results/NAME-plan`` if only that holds a run.
    changes : iterable of str, optional
        Other values of keys of the job, as ``seed=3 filter.particles=200``.
    say : callable, optional
        Receives a line for each model file before the file is run. Without it, an improbable
        measurement and an estimate of a few particles are a `pfdist.errors.PfdistWarning`, too.

    Returns
    -------
    NextTime, or the answer of the rule

    Raises
    ------
    StoreError
        The folder that is named has a run of another job or of other models; or with `rule`, there
        is no finished run with a rule.
    JobError
        The run has no set of this name.
    MeasurementsError, PriorError
        A table does not fit, or a value in it is wrong.
    ModelError
        The model cannot be loaded, or a formula failed.
    """
    table = table_argument("measurements", measurements)
    ask = asked("online.next") if rule else _next_by_plan
    if ask is None:
        raise ArgumentError("rule needs the plugin rule", argument="rule")
    plan = planned_run(job, results, changes, say, planned, prior, must_be=rule)
    result = ask(plan, table, now, reading_of(plan.built, columns, within, say))
    for line in result._page().alarms if say is silent else ():
        warnings.warn(line, PfdistWarning, stacklevel=2)
    return result


def _next_by_plan(
    plan: PlannedRun, table: Path | pd.DataFrame, now: Any, reading: Reading
) -> NextTime:
    """The answer by a new plan of what is left."""
    believed = plan.built.evaluator.believed
    clock, points = plan.built.job.problem.clock, plan.built.job.problem.points
    times = points.written_of(plan.times) if plan.run else None
    planner = Planner(plan.built, times, prior=plan.prior)
    feasible = planner.feasible
    start = clock.instant(planner.estimate().t)
    rows = read_measurements(table, believed, clock, start, reading)
    made, is_own = rows.made_with(believed), rows.clock is clock and rows.repeats == 1
    is_own = (is_own and not rows.given) or not (rows.t or rows.missed)
    late = (point for point in made if points.made_at(point) < points.instant(point))
    rest = planner.rest
    rest.count(in_flight=(*rows.in_flight, *late))
    with warnings.catch_warnings(action="ignore", category=PfdistWarning):  # the answer says it
        last, surprise = _tell(planner, rows) if is_own else (-1, None)
        if not is_own:
            last, surprise = _tell_all(planner, plan, rows, now, reading.note)
        elif now is not None:
            instant = instant_now(now, max(last, start), clock, reading.note)
            if instant > last:
                planner.missed(clock.time(instant))
            last = instant
    is_number = feasible.measurement_budget is not None
    spent = tuple(sorted((*rest.taken, *rest.in_flight)))
    left = max(0, feasible.total - len(spent)) if is_number else None
    first = max(last + 1, start)
    kept = [t for t in plan.times if t not in spent and points.made_at(t) >= first]
    before = tuple(sorted(sorted(kept, key=points.made_at)[:left]))
    left_now = feasible.left(rest.taken, first, rest.in_flight)
    still = plan.run is not None and left_now.may_all(before)
    expected, *expected_before = planner.expected(
        planner.plan(), *([points.written_of(before)] if still else [])
    )
    if expected_before and expected.difference(expected_before[0]).interval()[0] > 0:
        # A short search has found less than what was planned before.
        rest.keep(before)
        expected = expected_before[0]
    chosen = {points.sensor(point) for point in feasible.optional}
    always = [point for point in rest.plan if chosen and points.sensor(point) not in chosen]
    return NextTime(
        plan.path,
        plan.name,
        tuple(replace(points, clock=rows.clock).written_of(made)),
        planner.estimate().t,
        planner.plan(),
        left,
        tuple(points.written_of(before)),
        expected,
        expected_before[0] if expected_before else None,
        surprise,
        clock,
        planner.estimate().collapsed,
        planner.in_flight,
        tuple(points.written_of(always)),
        tuple(replace(points, clock=rows.clock).written_of(rows.failed)),
    )


def _tell(planner: Planner, rows: Measurements) -> tuple[int, float | None]:
    """Add all measurements to a planner in the order of time.

    Returns
    -------
    int
        The last instant that has a row, or -1.
    float or None
        The p-value of the most surprising among all measurements.
    """
    estimates, clock, points = list[FilterEstimate](), planner.clock, planner.feasible.points
    missed = ((t, None) for t in rows.missed)
    instants = sorted(chain(zip(rows.t, rows.y, strict=True), missed), key=itemgetter(0))
    for t, y in instants:
        planner.rest.count(point for point in rows.failed if points.instant(point) == t)
        if y is None:
            planner.missed(clock.time(t))
        else:
            estimates.append(planner.update(y, clock.time(t)))
    return instants[-1][0] if instants else -1, surprise_of(estimates)


def _tell_all(
    planner: Planner, plan: PlannedRun, rows: Measurements, now: Any, note: Callable[[str], Any]
) -> tuple[int, float | None]:
    """Add measurements whose clock has further instants, or that are repeated; as `_tell`.

    The job's instants count: the plan goes on from the first that no measurement follows.
    """
    clock = planner.clock
    end = rows.clock.times[max((*rows.t, *rows.missed))]
    until = len(clock.between(clock.times[0], end))
    if passed := abs(clock.times[until - 1] - end) <= clock.slack:
        until -= 1
    if now is not None:
        instant = instant_now(now, until - (not passed), clock, note)
        if instant >= until:
            until, passed = instant, True
    estimates = planner._follow(system_of_table(plan, rows), rows, until, passed=passed)
    return until - (not passed), surprise_of(estimates)
