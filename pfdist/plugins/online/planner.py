"""Choose when to measure one real system next, from all that was measured so far."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from itertools import chain
from numbers import Integral
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfdist.common.measurement_times import Times
from pfdist.common.rounding import unrounded
from pfdist.common.section import checked
from pfdist.common.streams import stream_of
from pfdist.errors import (
    ArgumentError,
    MeasurementsError,
    MeasurementTimesError,
    shown,
)
from pfdist.filters.cloud import Cloud, Prior
from pfdist.filters.estimate import Evaluation
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.filter_estimate import FilterEstimate
from pfdist.filters.one_filter import made
from pfdist.filters.user_prior import as_prior
from pfdist.plugins.online.needs import ON_THE_WAY
from pfdist.plugins.online.planning import Now, Planning, Replanner, Replanning, planning_of
from pfdist.plugins.online.work import affordable
from pfdist.problem.clock import Clock, Time
from pfdist.problem.feasible import Feasible
from pfdist.problem.measurements import Measurements, instant_on
from pfdist.problem.methods import METHODS
from pfdist.problem.problem import JobSource, as_job
from pfdist.questions.options import ComparedDraws
from pfdist.questions.planned_run import SystemOfTable, filter_of
from pfdist.runner.build import Built, build
from pfdist.runner.filter import Filter

EXPECTED_DRAWS = 2000
"""Simulated systems on which an expected MSE is estimated."""
_CLOUDS = 20  # independent filters whose noise is in the standard error of an expected MSE
_FIRST_SEARCH = METHODS["survivors"].section()
_FIRST_DRAWS = 300  # simulated systems for the plan before anything is measured


class Planner:
    """Chooses the next measurement time of one system, again after each measurement.

    The same job, times and measurements give the same plans. So a program that was killed can
    resume: it adds all measurements to a new planner.

    Parameters
    ----------
    job : Problem, Job, str or Path
        A job file, as ``jobs/plan.toml``, or the folder of a run. Its section [online] has the
        settings of plans. A job that is built already is not built again.
    times : iterable of int or float, optional
        The plan before anything is measured, such as the times that `pfdist.plan` found; a feasible
        set of the job, or of one of its measurement budgets. By default a short search finds some.
    prior : Cloud, Gaussian, array or DataFrame, optional
        The distribution of x(s), instead of the model's `initial`; the system then starts at s.
        An array (n, M) holds M particles of x(0); a DataFrame has a row for each, and its t is a
        time on the clock. The t of a `Cloud` is an instant. Planned times before s count as
        measured.
    draw : int
        Number of the system, which keys the noise: give each system another number.

    Raises
    ------
    JobError, ModelError, MeasurementTimesError, PriorError
        The job, the model, the times or the prior are not possible.

    Examples
    --------
    Measure when the planner says so::

        planner = pfdist.Planner("jobs/quick.toml")
        while (t := planner.next_time()) is not None:
            planner.update(measured(t))
    """

    def __init__(
        self,
        job: JobSource | Built,
        times: Iterable[Time] | None = None,
        *,
        prior: Prior | ArrayLike | None = None,
        draw: int = 0,
    ) -> None:
        built = job if isinstance(job, Built) else build(as_job(job), follows=True)
        ON_THE_WAY.check("choosing times on the way", built.job, built.evaluator)
        believed, clock = built.evaluator.believed, built.job.problem.clock
        start = as_prior(prior, believed, clock.readers(), clock.instant_of_t)
        stream = stream_of("online", built.job.seed, "planner")
        self._points = built.job.problem.points
        planned = None if times is None else self._points.checked(times, "times", "times")
        feasible = _feasible(built, planned)
        self._filter, self._built, self._heard = filter_of(built, start, draw), built, 0
        wanted = planning_of(built.job, built.evaluator.variance_is_error)
        planning = affordable(built, feasible, wanted)
        replanner = Replanner(built.evaluator, feasible, planning, stream)
        now = Now(start, self._filter.unmeasured.measured)
        self._times = self.clock  # of the filter's instants
        self._asked = -1  # the last instant of `decide`
        if planned is None:
            first = replace(replanner, planning=affordable(built, feasible, first_planning(wanted)))
            planned = first.plan(now, (), (), int(draw))
        self.rest = Replanning(replanner, planned, now, int(draw))
        """The points that were measured, those in flight, and the plan."""

    def next_time(self) -> Time | None:
        """The time to measure next; None if no measurement is left."""
        return next(iter(self.plan()), None)

    def plan(self) -> tuple[Time, ...]:
        """All planned times that are left, the next first."""
        left = (point for point in self.rest.plan if point not in self.rest.in_flight)
        return tuple(self._points.written_of(sorted(left, key=self._points.made_at)))

    @property
    def clock(self) -> Clock:
        """The clock of the job. All times of a planner but those of `decide` are on this clock."""
        return self._built.job.problem.clock

    @property
    def feasible(self) -> Feasible:
        """The feasible sets of the whole horizon."""
        return self.rest.replanner.feasible

    @property
    def measured(self) -> tuple[Time, ...]:
        """The times that were measured, also those of measurements that failed."""
        return tuple(self._points.written_of(self.rest.taken))

    @property
    def in_flight(self) -> tuple[Time, ...]:
        """The times of measurements that were made, and whose values have not arrived."""
        return tuple(self._points.written_of(self.rest.in_flight))

    def taken(self, t: Time | str | None = None) -> None:
        """Note that a measurement was made whose value arrives later.

        It is spent, unless `update` or `missed` passes its arrival without a value, and its sensor
        cannot fail. If it was not planned, the remaining times are planned again.

        Parameters
        ----------
        t : int, float or str, optional
            The time of the measurement, with its sensor if there are several, as ``12 lab``; by
            default the next time.

        Raises
        ------
        MeasurementsError
            The value does not arrive later, or no measurement is left of the plan.
        MeasurementTimesError
            The time is wrong, or breaks a constraint of the job.
        """
        given = self.next_time() if t is None else t
        if given is None:
            raise MeasurementsError("no measurement is left of the plan, got one without t")
        (point,), points, rest = self._points.checked([given], "t"), self._points, self.rest
        if not max(points.made_at(point), rest.now.first - 1) < points.instant(point):
            raise MeasurementsError(
                f"taken is for a value that arrives later, got {shown(given)}: give its value to "
                "update"
            )
        in_flight = points.canonical((*rest.in_flight, point))
        (point,) = {*in_flight} - {*rest.in_flight} or {point}  # the next of alike repeats
        is_planned = point in rest.plan
        if not is_planned:
            self._check_fits(point)
        rest.in_flight = in_flight
        if not is_planned:
            rest.plan = tuple(sorted({*rest.plan, point}))
            rest.again(rest.now)

    def _check_fits(self, point: int) -> None:
        """Raise `MeasurementTimesError` if a measurement breaks a constraint after those made."""
        rest, feasible = self.rest, self.feasible
        if feasible.left(rest.taken, rest.now.first, rest.in_flight).may(point)[0]:
            return
        made = (*rest.taken, *rest.in_flight)
        known = feasible.broken(made, fewer=True)
        broken = [
            each
            for each in feasible.broken((*made, point), fewer=True)
            if each not in known and not each.startswith("required")
        ]
        (why, *_) = [*broken, "required times to come no longer fit"]
        raise MeasurementTimesError(
            f"a measurement that is taken must keep the constraints, got "
            f"{feasible.formatted(point)}: {why}"
        )

    def decide(self, belief: Filter, t: int) -> list[str]:
        """Decide whether to measure at an instant; what is chosen counts as made.

        So a planner is used in a loop as `pfdist.Rule` is. Values that have arrived in the filter
        since the last call, and measurements that were not made, change the plan of the rest.

        Parameters
        ----------
        belief : Filter
            The filter of the system, with all measurements that have arrived before t. If a
            measurement was not made, the filter moves to t - 1.
        t : int

        Returns
        -------
        list of str
            The sensors that measure now, as `pfdist.Rule.decide` names them.

        Raises
        ------
        ArgumentError
            `belief` is no filter of such a system, or t has passed or lies after T.
        """
        if not isinstance(belief, Filter):
            raise ArgumentError(f"belief must be a Filter, got {shown(belief)}")
        if belief.model.components != self._filter.model.components:
            raise ArgumentError(
                f"belief must be a filter of the planner's model, got one of {belief.model.name}"
            )
        first, last = max(self._asked + 1, self.rest.now.first), self.clock.horizon
        if not (isinstance(t, Integral) and first <= t <= last):
            raise ArgumentError(f"t must be an instant in {first}..{last}, got {shown(t)}")
        self._asked = t
        if belief is not self._filter:
            self._filter, self._heard = belief, 0
        first = self._points.first(t)
        if len(belief.seen) > self._heard or min(self.rest.plan, default=first) < first:
            self._hear(t - 1)
        return self.rest.measure(t)

    def update(
        self, y: float | Sequence[float] | NDArray[Any], t: Time | None = None, **given: Any
    ) -> FilterEstimate:
        """Add a measurement, and plan the remaining times again.

        Parameters
        ----------
        y : float or sequence of float, (m,)
            The measurement. NaN marks a missing component, if the model declares that components
            may be missing. All components of a sensor that did not measure are NaN, and inf if it
            has `works` and failed. If all are NaN, planned measurements of sensors with `fails` or
            `works` have failed, and are spent.
        t : int or float, optional
            The time at which the values arrive, if it is not that of the next planned time. Planned
            times before it count as missed, unless they were `taken`.
        given
            Values of parameters that come with the reading, as for `Filter.update`: ``u=0.2``.

        Returns
        -------
        Estimate
            The estimate of z(t).

        Raises
        ------
        MeasurementsError
            The time or the measurement is wrong, or no particle explains the measurement. The
            planner stays as it was.
        ModelError
            A formula failed in a simulated system. Make a new planner to continue.
        """
        instant = self._time(t)
        here = [each for each in self.rest.plan if self._points.instant(each) == instant]
        estimate = self._filter.update(instant, self._with_failures(y, here), **given)
        self._hear(instant, [] if estimate.measured else here)
        return self._on_clock(estimate)

    def missed(self, t: Time | None = None) -> None:
        """Note that nothing was measured up to t, and plan the remaining times again.

        The measurement is not lost: it may be made later.

        Parameters
        ----------
        t : int or float, optional
            By default the next planned time.

        Raises
        ------
        MeasurementsError
            The time is wrong.
        """
        made_at, instant = self._points.made_at, self._points.instant
        late = {point for point in self.rest.in_flight if made_at(point) < instant(point)}
        due = [made_at(point) for point in self.rest.plan if t is None and point not in late]
        self._hear(min(due) if due else self._time(t))

    def estimate(self, t: Time | None = None) -> FilterEstimate:
        """The estimate of z(t) from all measurements so far.

        Parameters
        ----------
        t : int or float, optional
            Not before the last measurement; by default its time.

        Raises
        ------
        MeasurementsError
            The time is wrong.
        """
        now = self._filter.now
        return self._on_clock(now if t is None else self._filter.predict(instant_on(self.clock, t)))

    @checked
    def expected(
        self, *plans: Iterable[Time], draws: ComparedDraws = EXPECTED_DRAWS
    ) -> list[Evaluation]:
        """The expected MSE from now to T with each plan, on the same fresh simulated systems.

        The systems start from 20 independent filters, which have the same measurements and chose no
        plan. So the standard errors, and those of `pfdist.filters.estimate.difference`, contain
        the noise of the particles.

        Parameters
        ----------
        *plans : iterables of int or float
            Times that are left to be measured; by default those of `plan`. Values in flight arrive
            with each.
        draws : int
            Number of simulated systems, which is rounded up to a multiple of the number of filters.

        Raises
        ------
        MeasurementTimesError
            A time does not lie after the last measurement and up to T.
        ArgumentError
            The number of draws is below 2.
        """
        now, made_at, in_flight = self.rest.now, self._points.made_at, {*self.rest.in_flight}
        wanted = [self._points.checked(plan) for plan in plans or (self.plan(),)]
        for plan in wanted:
            late = {point for point in plan if made_at(point) < now.first} - in_flight
            if late:
                least = self.clock.text(self.clock.times[now.first])
                got = self.clock.text(self._points.written(min(late)))
                raise MeasurementTimesError(
                    f"times that are left must be at least {least}, got {got}"
                )
        clouds = list[Any]()
        if isinstance(now.prior, Cloud) and now.prior.truths:  # something was measured
            filters = range(min(_CLOUDS, draws))
            clouds = [self._filter.again(number) for number in filters]
        complete = [tuple(sorted({*plan, *in_flight})) for plan in wanted]
        evaluations = self.rest.replanner.expected(
            now, complete, draws, self._built.comparing, self.rest.draw, clouds
        )
        return [
            replace(each, measurement_times=tuple(self._points.written_of(plan)))
            for each, plan in zip(evaluations, wanted, strict=True)
        ]

    def _on_clock(self, estimate: FilterEstimate) -> FilterEstimate:
        time: Any = self._times.time(estimate.t)
        few: Any = None if estimate.collapsed is None else self._times.time(estimate.collapsed)
        return replace(estimate, t=time, collapsed=few)

    def _time(self, t: Time | None) -> int:
        """The instant that is meant: that of a given time, or the next planned."""
        if t is not None:
            try:
                instant = instant_on(self.clock, t)
            except MeasurementsError as error:
                times = self.clock.times
                is_within = isinstance(t, int | float) and times[0] < t < times[-1]
                if self.clock.counts or not is_within:
                    raise
                raise MeasurementsError(
                    f"{error}: pfdist.next_time takes measurements at any times"
                ) from error
            if instant < self.rest.now.first:
                first = self.clock.text(self.clock.times[self.rest.now.first])
                raise MeasurementsError(
                    f"t must be at least {first}, the first instant that has not passed, got "
                    f"{unrounded(t)}"
                )
            return instant
        if not self.rest.plan:
            raise MeasurementsError(
                f"no measurement is left of the plan, got one without t (measured: "
                f"{shown(self.measured)})"
            )
        return self._points.instant(self.rest.plan[0])

    def _follow(
        self, system: SystemOfTable, rows: Measurements, until: int, *, passed: bool
    ) -> list[FilterEstimate]:
        """Take all measurements of a table, whose clock may have more instants, and plan once.

        `until` is the first instant of the job that no measurement follows; if it has `passed`, it
        can no longer be measured.
        """
        filtering = self._filter = system.filtering
        self._times, extra = rows.clock, rows.clock.horizon - self.clock.horizon
        last = rows.clock.instant(self.clock.times[until])
        seen: dict[int, Any] = dict.fromkeys((*rows.missed, last))
        seen |= dict(zip(rows.t, rows.y, strict=True))
        estimates = [
            filtering.wait(t) if y is None else filtering.update(t, y)
            for t, y in sorted(seen.items(), key=itemgetter(0))
        ]
        weights = self._built.evaluator.weights
        weights = weights and (1.0,) * extra + weights  # those before now do not count
        evaluator = replace(system.evaluator, weights=weights)
        self._again(Now(filtering.with_truths(), passed, extra), system.taken, evaluator=evaluator)
        return estimates

    def _with_failures(self, y: Any, planned: Sequence[int]) -> Any:
        """A measurement in which planned sensors with `works` have failed if it has no value."""
        values, ways = np.atleast_1d(y), self._filter.model.ways
        asked = [ways[self._points.way(each)] for each in planned]
        failed = [each.y for each in asked if each.model.works]
        if not failed or values.dtype.kind != "f" or not np.isnan(values).all():
            return y
        values = np.full(self._filter.model.components[1], np.nan)
        for each in failed:
            values[each] = np.inf
        return values

    def _hear(self, last: int, failed: Iterable[int] = ()) -> None:
        """Plan again from what the filter has received up to the last instant that has passed."""
        if self._filter.now.t < last:
            self._filter.wait(last)
        new, self._heard = self._filter.seen[self._heard :], len(self._filter.seen)
        here = chain.from_iterable(made(self._filter.model, *each) for each in new)
        self._again(Now(self._filter.with_truths(), measured=True), here, failed)

    def _again(
        self, now: Now, taken: Iterable[int], failed: Iterable[int] = (),
        evaluator: Evaluator | None = None,
    ) -> None:  # fmt: skip
        """Plan again what is left from now on; sensors that may fail are spent without a value."""
        sensings, parts = self._built.job.problem.sensed, self._filter.model.ways
        passed = (e for e in self.rest.in_flight if e < self._points.first(now.first))
        ways = ((each, self._points.way(each)) for each in chain(failed, passed))
        spent = (e for e, way in ways if sensings.by_way(way).fails or parts[way].model.works)
        evaluator = _with_past(evaluator or self._built.evaluator, now)
        self.rest.replanner = replace(self.rest.replanner, evaluator=evaluator)
        self.rest.again(now, chain(taken, spent))


def _with_past(evaluator: Evaluator, now: Now) -> Evaluator:
    """The evaluator with the values that came with readings, so that lines can be continued."""
    lines, own = getattr(now.prior, "lines", None), evaluator.believed
    if lines is None or not (given := lines.given(own, now.t + now.extra)):
        return evaluator
    believed = own.with_parameters(given)
    model = believed if evaluator.model == own else evaluator.model
    return replace(evaluator, model=model, filter_model=believed)


def first_planning(planning: Planning) -> Planning:
    """The settings for a plan before anything is measured, given those for later plans."""
    return replace(planning, search=_FIRST_SEARCH, draws=_FIRST_DRAWS)


def _feasible(built: Built, planned: Times | None) -> Feasible:
    """The feasible sets, of as many measurements as were planned if the job has a range.

    Raises
    ------
    MeasurementTimesError
        The planned times are not feasible.
    """
    job, feasible = built.job, built.feasible
    if planned is None:
        return feasible
    if job.amounts and planned:
        feasible = job.feasible(len(planned))
    times = tuple(job.problem.points.written_of(planned))
    if broken := feasible.broken(planned):
        raise MeasurementTimesError(
            f"times must satisfy the constraints of the job, got {shown(times)}: "
            f"{'; '.join(f'problem.{sentence}' for sentence in broken)}",
            argument="times",
        )
    return feasible
