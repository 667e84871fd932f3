"""Plans for the remaining measurements, given a filter's current particles.

A search finds a new plan on simulated systems that start from the filter's particles. Then a paired
test on fresh simulated systems decides whether the new plan replaces the current plan. So, except
by chance, a feasible plan is replaced only by a better one.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from pfdist.common.measurement_times import Times
from pfdist.common.streams import stream_key
from pfdist.filters.cloud import Prior
from pfdist.filters.draws import Draws
from pfdist.filters.estimate import Evaluation
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.exact import exact_mse
from pfdist.filters.one_filter import Followed
from pfdist.filters.work import Estimation
from pfdist.kernels.estimators import SQUARED_ERROR
from pfdist.kernels.variates import generator
from pfdist.plugins.online.section import Online, online_of
from pfdist.problem.feasible import Feasible
from pfdist.problem.job import Job
from pfdist.problem.methods import METHODS
from pfdist.problem.search_section import SearchSection
from pfdist.runner.searches import Settings
from pfdist.search.base import Candidate, Optimiser

_BETTER = 1.0  # standard errors by which a new plan must be better than the plan at hand
_ROUNDING = 1e-9  # relative difference of exact errors that counts as none


@dataclass(frozen=True)
class Planning:
    """The settings with which the remaining measurements are planned."""

    search: SearchSection  # the method and its settings
    draws: int  # simulated systems on which the search compares plans
    judging_draws: int  # fresh simulated systems that decide between the new plan and that at hand
    estimation: Estimation  # of the simulated filters

    def optimiser(self, rest: Feasible, start: Times | None = None) -> Optimiser:
        """The optimiser of the remaining measurements; see `pfdist.problem.methods`.

        Raises `JobError` if the method cannot search this problem.
        """
        method = METHODS[self.search.method]
        made: Optimiser = method.make(rest, self.draws, self.search.settings, start)
        return made


class Now(NamedTuple):
    """The state of a filter of one system at an instant t, for which a plan is made."""

    prior: Prior | None = None  # of x(t); None before anything is measured: `initial` gives x(0)
    measured: bool = False  # whether t was measured, or can no longer be
    extra: int = 0  # instants before t that the clock of prior and evaluator has, not the job's

    @property
    def t(self) -> int:
        """The instant, of the job."""
        return 0 if self.prior is None else self.prior.t - self.extra

    @property
    def first(self) -> int:
        """The first instant that may still be measured."""
        return self.t + self.measured


@dataclass(frozen=True)
class Replanner:
    """A planner of the remaining measurements, for a model and constraints.

    Raises `ModelError` if the filter's model has states of another size than the true model.
    """

    # Its model simulates systems, and its filter model filters them, both from `Now.prior`. Its
    # clock may have more instants before now.
    evaluator: Evaluator
    feasible: Feasible  # of the whole horizon
    planning: Planning
    stream: int  # key of all noise of the planning, 64 bits

    def plan(
        self, now: Now, taken: Times, plan: Times, draw: int = 0, in_flight: Times = ()
    ) -> Times:
        """The plan for the remaining measurements: the current plan, or a better one.

        If the current plan is not feasible, the search starts from the better of two plans: one
        that keeps as many of its times as possible, and regular times. The new plan then replaces
        this start if its mean error is lower.

        Parameters
        ----------
        now : Now
        taken : tuple of int
            Times that were measured so far, sorted.
        plan : tuple of int
            The current plan: times from `now.first` on. It may be empty.
        draw : int
            Index of the system, which is part of the key of the noise.
        in_flight : tuple of int
            Measurements that were made, sorted, whose values arrive from `now.first` on. The plan
            contains them.

        Returns
        -------
        tuple of int
            Times from `now.first` on; empty if no measurement is left or fits.

        Raises
        ------
        ModelError
            A formula failed.
        """
        rest = self.feasible.rest(taken, now.first, in_flight)
        if rest is None:
            return ()
        stream = stream_key(self.stream, draw, now.first, len(taken))
        first = self.feasible.points.first(now.first)
        at_hand, outlook = tuple(time - first for time in plan), _Outlook(self, now, stream)
        start, keep = at_hand, rest.accepts(at_hand)
        if not keep:  # as much of it as can be, or regular times
            repaired = rest.repair(at_hand, generator(stream, "repair"))
            start = outlook.better([repaired, rest.regular()], keep=False)
        chosen = outlook.better([start, *outlook.search(rest, start)], keep=keep)
        return tuple(first + time for time in rest.canonical(chosen))

    def expected(
        self,
        now: Now,
        plans: Sequence[Times],
        draws: int,
        estimation: Estimation,
        draw: int = 0,
        clouds: Sequence[Prior | None] = (),
    ) -> list[Evaluation]:
        """Evaluations of plans by the expected MSE from now on, on draws that chose no plan.

        `draws` is the number of simulated systems, and `draw` the index of the system. Each of
        `clouds`, which are independent priors for now, starts an equal part of the systems; without
        any, all start from the prior of `now`. Raises `ModelError` if a formula failed.
        """
        stream = stream_key(self.stream, draw, now.first, "expected")
        ends = [self.evaluator.horizon] * len(plans)
        evaluations, index = list[list[Evaluation]](), range(-(-draws // max(1, len(clouds))))
        for number, prior in enumerate(clouds or [now.prior]):
            key = stream_key(stream, number) if clouds else stream
            outlook = _Outlook(self, now._replace(prior=prior), key)
            sets = [outlook.there(now.extra, plan) for plan in plans]
            evaluations.append(outlook.of_sets(outlook.draws(index), sets, ends, estimation))
        each_plan = (Evaluation.together(parts) for parts in zip(*evaluations, strict=True))
        return [replace(evaluation, purpose="evaluate") for evaluation in each_plan]


class Replanning:
    """A strategy: the measurements that are left are planned again after each one.

    Parameters
    ----------
    replanner : Replanner
    plan : tuple of int
        The first plan. Its times before `now.first` count as measured.
    now : Now
    draw : int
        Index of the system, which is part of the key of the noise.
    """

    def __init__(self, replanner: Replanner, plan: Times, now: Now, draw: int) -> None:
        points = replanner.feasible.points
        first = points.first(now.first)
        self.replanner, self.now, self.draw, self._points = replanner, now, draw, points
        self.plan = tuple(point for point in plan if point >= first)
        """The points whose values are to arrive; those in flight are among them."""
        self.taken = tuple(point for point in plan if point < first)
        self.in_flight = tuple(each for each in self.plan if points.made_at(each) < now.first)

    def decide(self, belief: Followed, t: int) -> list[str]:
        """The sensors that measure at an instant; see `pfdist.filters.strategy.Strategy`."""
        first = self._points.first(t)
        if arrived := [point for point in self.in_flight if point < first]:
            self.again(Now(belief.with_truths(), measured=True), arrived)
        return self.measure(t)

    def measure(self, t: int) -> list[str]:
        """Make the measurements that are planned for an instant; the names of their sensors."""
        due = (each for each in self.plan if self._points.made_at(each) == t)
        chosen = [each for each in due if each not in self.in_flight]
        self.in_flight = tuple(sorted((*self.in_flight, *chosen)))
        return [self._points.names[self._points.way(point)] for point in chosen]

    def again(self, now: Now, taken: Iterable[int] = ()) -> None:
        """Plan again what is left from now on; more measurements were taken."""
        first = self._points.first(now.first)
        self.now, self.taken = now, tuple(sorted({*self.taken, *taken}))
        self.in_flight = tuple(point for point in self.in_flight if point >= first)
        left = tuple(point for point in self.plan if point >= first)
        self.plan = self.replanner.plan(now, self.taken, left, self.draw, self.in_flight)

    def count(self, taken: Iterable[int] = (), in_flight: Iterable[int] = ()) -> None:
        """Count further measurements as taken, or as in flight."""
        self.taken = tuple(sorted({*self.taken, *taken}))
        self.in_flight = tuple(sorted({*self.in_flight, *in_flight}))

    def keep(self, plan: Times) -> None:
        """Replace the plan by another of what is left; what is in flight stays in it."""
        self.plan = tuple(sorted({*self.in_flight, *plan}))


@dataclass(frozen=True)
class _Outlook:
    """Simulated futures of one system. Times count from the first instant still to be measured."""

    replanner: Replanner
    now: Now
    stream: int

    def search(self, rest: Feasible, start: Times) -> list[Times]:
        """The best plan of a search from a start, in a list.

        The list is empty if the error of every plan is infinite.
        """
        planning = self.replanner.planning
        optimiser, draws = planning.optimiser(rest, start), self.draws(range(planning.draws))
        state, generation = optimiser.init(), 0
        while not optimiser.done(state):
            candidates = optimiser.ask(state, generator(self.stream, "search", generation))
            state = optimiser.tell(state, self._evaluated(draws, candidates, planning.estimation))
            generation += 1
        best = [each for each in optimiser.finalists(state)[:1] if math.isfinite(each.expected_mse)]
        return [each.measurement_times for each in best]

    def better(self, plans: Sequence[Times], *, keep: bool) -> Times:
        """The second plan if it is better than the first on fresh draws; else the first.

        With `keep`, its mean error must be lower by more than a standard error of the paired
        difference; without, it must only be lower. A single plan is returned at once.
        """
        plans = list(dict.fromkeys(plans))
        if len(plans) == 1:
            return plans[0]
        planning = self.replanner.planning
        fresh = range(planning.draws, planning.draws + planning.judging_draws)
        candidates = [Candidate(times) for times in plans]
        # The squared error decides: particles may be close together but far from the true state.
        estimation = replace(planning.estimation, estimator=SQUARED_ERROR.name)
        first, new = self._evaluated(self.draws(fresh), candidates, estimation)
        gain = new.difference(first)
        rounding = _ROUNDING * first.expected_mse if math.isfinite(first.expected_mse) else 0.0
        lower = gain.value < -rounding and gain.is_negative(_BETTER if keep else 0.0)
        return plans[1] if lower else plans[0]

    def draws(self, index: range) -> Draws | None:
        """Simulated systems; None if the engine is exact."""
        return None if self.evaluator.exact else self.evaluator.draws(index, self.stream)

    def _evaluated(
        self, draws: Draws | None, candidates: Sequence[Candidate], estimation: Estimation
    ) -> list[Evaluation]:
        """Evaluations of candidates on common draws with common noise."""
        last, first = self.evaluator.horizon, self.now.first + self.now.extra
        sets = [self.there(first, each.measurement_times) for each in candidates]
        ends = [last if each.end is None else first + each.end for each in candidates]
        if draws is not None:
            draws = draws[: max(each.draws or len(draws.index) for each in candidates)]
        evaluations = self.of_sets(draws, sets, ends, estimation)
        return [
            replace(
                evaluation.first(len(evaluation.mse) if each.draws is None else each.draws),
                measurement_times=each.measurement_times,
                end=each.end,
                purpose="online",
            )
            for each, evaluation in zip(candidates, evaluations, strict=True)
        ]

    def of_sets(
        self,
        draws: Draws | None,
        sets: Sequence[Times],
        ends: Sequence[int],
        estimation: Estimation,
    ) -> list[Evaluation]:
        """Evaluations of sets up to their ends on common draws with common noise."""
        exact = exact_mse(self.evaluator, sets, ends)
        if exact is not None or draws is None:
            each_set = zip(sets, [] if exact is None else exact.tolist(), strict=True)
            return [Evaluation.exactly(times, mse) for times, mse in each_set]
        noise = stream_key(self.stream, "filter")
        found = self.evaluator.filter_sets(draws, sets, ends, noise, estimation)
        rows = zip(sets, found.mse.T.copy(), found.degenerate.T, strict=True)
        return [Evaluation(times, row, degenerate=of_set) for times, row, of_set in rows]

    def there(self, first: int, times: Times) -> Times:
        """Points of the job as the evaluator counts them, from an instant of its clock on.

        It may have more instants before now, and more rows of each sensor after those of the job.
        """
        ways, rows = self.replanner.feasible.points.ways, self.replanner.evaluator.points.ways
        return tuple((first + time // ways) * rows + time % ways for time in times)

    @property
    def evaluator(self) -> Evaluator:
        """The evaluator from now on."""
        return replace(self.replanner.evaluator, prior=self.now.prior, estimations=())


def planning_of(job: Job, variance_is_error: bool) -> Planning:
    """The settings for planning the remaining measurements, from [online] or its defaults."""
    online = online_of(job) or Online()
    settings = Settings.from_job(job, online.search.evaluation, variance_is_error)
    return Planning(online.search, settings.draws, online.judging_draws, settings.estimation)
