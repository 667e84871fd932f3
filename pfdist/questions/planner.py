"""Choose when to measure one real system next, from all that was measured so far."""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from operator import itemgetter
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pfdist.common.measurement_times import Times
from pfdist.common.rounding import unrounded
from pfdist.common.section import checked
from pfdist.common.streams import stream_of
from pfdist.errors import MeasurementsError, MeasurementTimesError, shown
from pfdist.filters.cloud import Cloud, Prior
from pfdist.filters.estimate import Evaluation
from pfdist.filters.filter import Filter
from pfdist.filters.filter_estimate import FilterEstimate
from pfdist.filters.one_filter import again, filter_of_truths, made, with_truths
from pfdist.filters.user_prior import as_prior
from pfdist.problem.clock import Clock, Time
from pfdist.problem.feasible import Feasible
from pfdist.problem.measurements import Measurements, instant_on
from pfdist.problem.methods import METHODS
from pfdist.problem.needs import ON_THE_WAY
from pfdist.problem.problem import JobSource, as_job
from pfdist.questions.options import ComparedDraws
from pfdist.questions.planned_run import filter_of
from pfdist.runner.build import Built, build
from pfdist.runner.planning import Now, Planning, Replanner
from pfdist.runner.searches import planning_of

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
    >>> import pfdist
    >>> planner = pfdist.Planner("jobs/quick.toml")  # doctest: +SKIP
    >>> planner.next_time()  # doctest: +SKIP
    1
    >>> planner.update(1.3)  # doctest: +SKIP
    """

    _taken: Times
    _plan: Times  # with the measurements in flight
    _in_flight: Times

    def __init__(
        self,
        job: JobSource | Built,
        times: Iterable[Time] | None = None,
        *,
        prior: Prior | ArrayLike | None = None,
        draw: int = 0,
    ) -> None:
        built = job if isinstance(job, Built) else build(as_job(job))
        ON_THE_WAY.check("choosing times on the way", built.job, built.evaluator)
        believed, clock = built.evaluator.believed, built.job.problem.clock
        start = as_prior(prior, believed, clock.readers(), clock.instant_of_t)
        planning = planning_of(built.job, built.evaluator.variance_is_error)
        stream = stream_of("online", built.job.seed, "planner")
        self._points = built.job.problem.points
        planned = None if times is None else self._points.checked(times, "times", "times")
        feasible = _feasible(built, planned)
        self._replanner = Replanner(built.evaluator, feasible, planning, stream)
        self._filter = filter_of(built, start, draw)
        self._truths = filter_of_truths(self._filter.unmeasured)
        self._built, self._draw = built, int(draw)
        self._now, self._seen = Now(start), list[tuple[int, NDArray[np.float64] | None]]()
        self._times = self.clock  # of the filter's instants
        if planned is None:
            first = replace(self._replanner, planning=first_planning(planning))
            planned = first.plan(self._now, (), (), self._draw)
        first_left = self._points.first(self._now.first)
        self._plan = tuple(time for time in planned if time >= first_left)
        self._taken = tuple(time for time in planned if time < first_left)
        self._in_flight = tuple(
            time for time in self._plan if self._points.made_at(time) < self._now.first
        )

    def next_time(self) -> Time | None:
        """The time to measure next; None if no measurement is left."""
        return next(iter(self.plan()), None)

    def plan(self) -> tuple[Time, ...]:
        """All planned times that are left, the next first."""
        left = (point for point in self._plan if point not in self._in_flight)
        return tuple(self._points.written_of(sorted(left, key=self._points.made_at)))

    @property
    def clock(self) -> Clock:
        """The clock of the job. All times of a planner are times on this clock."""
        return self._built.job.problem.clock

    @property
    def feasible(self) -> Feasible:
        """The feasible sets of the whole horizon."""
        return self._replanner.feasible

    @property
    def measured(self) -> tuple[Time, ...]:
        """The times that were measured, also those of measurements that failed."""
        return tuple(self._points.written_of(self._taken))

    @property
    def in_flight(self) -> tuple[Time, ...]:
        """The times of measurements that were made, and whose values have not arrived."""
        return tuple(self._points.written_of(self._in_flight))

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
        (point,), points = self._points.checked([given], "t"), self._points
        if not max(points.made_at(point), self._now.first - 1) < points.instant(point):
            raise MeasurementsError(
                f"taken is for a value that arrives later, got {shown(given)}: give its value to "
                "update"
            )
        in_flight = tuple(sorted({*points.canonical((*self._in_flight, point))}))
        (point,) = {*in_flight} - {*self._in_flight} or {point}  # the next of alike repeats
        if point not in self._plan:
            planned = tuple(sorted({*self._plan, point}))
            more = self._draw, in_flight
            self._plan = self._replanner.plan(self._now, self._taken, planned, *more)
        self._in_flight = in_flight

    def update(
        self, y: float | Sequence[float] | NDArray[Any], t: Time | None = None, **given: Any
    ) -> FilterEstimate:
        """Add a measurement, and plan the remaining times again.

        Parameters
        ----------
        y : float or sequence of float, (m,)
            The measurement. NaN marks a missing component, if the model declares that components
            may be missing. All components of a sensor that did not measure are NaN. If all are NaN,
            planned measurements of sensors with `fails` have failed, and are spent.
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
        estimate, measurement = self._filter.update(instant, y, **given), None
        self._truths = replace(self._truths, model=self._filter.model)
        if estimate.measured:
            measurement = np.atleast_1d(np.array(y, np.float64))
            here = made(self._filter.model, instant, measurement)
            self._taken = tuple(sorted({*self._taken, *here}))
        else:
            self._fail(each for each in self._plan if self._points.instant(each) == instant)
        self._plan_anew(estimate.t, measurement)
        return self._on_clock(estimate)

    def _fail(self, points: Iterable[int]) -> None:
        """Count measurements without a value as made, of sensors that may fail."""
        sensings, way = self._built.job.problem.sensed, self._points.way
        more = (each for each in points if sensings.by_way(way(each)).fails)
        self._taken = tuple(sorted({*self._taken, *more}))

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
        nothing = [float("nan")] * self._filter.model.components[1]
        left = [self._points.made_at(each) for each in self._plan if each not in self._in_flight]
        instant = min(left) if t is None and left else self._time(t)
        self._plan_anew(self._filter.update(instant, nothing).t)

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
        first, made_at = self._now.first, self._points.made_at
        wanted = [self._points.checked(plan) for plan in plans or (self.plan(),)]
        for plan in wanted:
            late = {point for point in plan if made_at(point) < first} - {*self._in_flight}
            if late:
                least = self.clock.text(self.clock.times[first])
                got = self.clock.text(self._points.written(min(late)))
                raise MeasurementTimesError(
                    f"times that are left must be at least {least}, got {got}"
                )
        clouds = list[Any]()
        if self._seen and isinstance(self._now.prior, Cloud):
            filters = range(min(_CLOUDS, draws))
            clouds = [again(self._filter.unmeasured, self._seen, number) for number in filters]
            clouds = [_at(self._now.t, each) for each in clouds]
        complete = [tuple(sorted({*plan, *self._in_flight})) for plan in wanted]
        evaluations = self._replanner.expected(
            self._now, complete, draws, self._built.comparing, self._draw, clouds
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
            if instant < self._now.first:
                first = self.clock.text(self.clock.times[self._now.first])
                raise MeasurementsError(
                    f"t must be at least {first}, the first instant that has not passed, got "
                    f"{unrounded(t)}"
                )
            return instant
        if not self._plan:
            raise MeasurementsError(
                f"no measurement is left of the plan, got one without t (measured: "
                f"{shown(self.measured)})"
            )
        return self._points.instant(self._plan[0])

    def _follow(
        self, filtering: Filter, rows: Measurements, taken: Times, until: int, *, passed: bool
    ) -> list[FilterEstimate]:
        """Take all measurements of a table, whose clock may have more instants, and plan once.

        `filtering` is a new filter on the clock of the table. `taken` are the points of the job
        that count as measured, sorted, and `until` is the first instant of the job that no
        measurement follows; if it has `passed`, it can no longer be measured.
        """
        self._filter, self._truths = filtering, filter_of_truths(filtering.unmeasured)
        self._times, estimates = rows.clock, list[FilterEstimate]()
        self._taken = tuple(sorted({*self._taken, *taken}))
        seen: dict[int, Any] = dict.fromkeys(
            (*rows.missed, rows.clock.instant(self.clock.times[until]))
        )
        seen |= dict(zip(rows.t, rows.y, strict=True))
        for t, y in sorted(seen.items(), key=itemgetter(0)):
            nothing = np.full(filtering.model.components[1], np.nan)
            estimates.append(filtering.update(t, nothing if y is None else y))
            prior, self._truths = with_truths(filtering.cloud, self._truths, t, y)
            self._seen.append((t, y))
        self._now = Now(_at(until, prior), passed)
        self._plan_rest()
        return estimates

    def _plan_anew(self, time: int, y: NDArray[np.float64] | None = None) -> None:
        """Plan the remaining times after an instant, which was measured if y is given."""
        prior, self._truths = with_truths(self._filter.cloud, self._truths, time, y)
        self._seen.append((time, y))
        self._now = Now(prior, measured=True)
        self._plan_rest()

    def _plan_rest(self) -> None:
        """Plan again what is left from now on."""
        first = self._points.first(self._now.first)
        self._fail(point for point in self._in_flight if point < first)
        self._in_flight = tuple(point for point in self._in_flight if point >= first)
        left = tuple(planned for planned in self._plan if planned >= first)
        given = self._taken, left, self._draw, self._in_flight
        self._plan = self._replanner.plan(self._now, *given)


def _at(t: int, prior: Prior | None) -> Any:
    """A prior at an instant of another clock at the same time."""
    truths = prior.truths if isinstance(prior, Cloud) else None
    more: Any = {} if truths is None else {"truths": replace(truths, t=t)}
    return None if prior is None else replace(prior, t=t, **more)


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
    if job.budget is not None and planned:
        feasible = job.feasible(len(planned))
    times = tuple(job.problem.points.written_of(planned))
    if broken := feasible.broken(planned):
        raise MeasurementTimesError(
            f"times must satisfy the constraints of the job, got {shown(times)}: "
            f"{'; '.join(f'problem.{sentence}' for sentence in broken)}",
            argument="times",
        )
    return feasible
