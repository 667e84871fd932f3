"""Plan the measurements that are left, from what a filter knows of the system now.

A plan is sought on simulated systems that start from the filter's particles. Fresh simulated
systems then decide, by a paired test, whether it takes the place of the plan at hand. So a plan is
replaced only by a better one, but for chance.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pfdist.common.streams import stream_key
from pfdist.evaluation.estimate import Purpose, SearchEvaluation
from pfdist.evaluation.problem import Problem
from pfdist.evaluation.work import Estimation
from pfdist.filters.draws import Draws
from pfdist.kernels.noise import generator
from pfdist.search.base import Candidate, SearchOptimiser
from pfdist.search.methods import METHODS
from pfdist.search.paired import difference
from pfdist.search.section import SearchSection
from pfdist.sequential.one_filter import OneFilter
from pfdist.times.feasible import Feasible
from pfdist.times.measurement_times import Times
from pfdist.times.rest import rest_of

ONLINE = Purpose("online", SearchEvaluation)
_BETTER = 1.0  # standard errors by which a new plan must be better
_ROUNDING = 1e-9  # relative difference of exact costs that counts as none
_POLICY = "leave_out"  # for degenerate draws: one of many must not decide about a plan


@dataclass(frozen=True)
class Planning:
    """How the measurements that are left are planned.

    Parameters
    ----------
    search : SearchSection
        The search method and its settings.
    draws : int
        Number of simulated systems on which the search compares plans.
    judging_draws : int
        Number of fresh simulated systems that decide between the new plan and the plan at hand.
    estimation : Estimation
        Particles, resampling and estimator of the filters that are simulated.
    """

    search: SearchSection
    draws: int
    judging_draws: int
    estimation: Estimation

    def optimiser(self, rest: Feasible, start: Times | None = None) -> SearchOptimiser:
        """Make the optimiser of the measurements that are left; see `pfdist.search.methods`.

        Raises
        ------
        JobError
            The method cannot search this problem.
        """
        method = METHODS[self.search.method]
        return method.make(rest, self.draws, self.search.settings, start)


@dataclass(frozen=True)
class Replanner:
    """Plans the measurements that are left, for a problem and its constraints.

    Parameters
    ----------
    problem : Problem
        The problem from t = 0: its model simulates systems, and its filter model filters them.
    feasible : Feasible
        The feasible sets of the whole horizon.
    planning : Planning
    stream : int
        Key of all noise of the planning, 64 bits.
    """

    problem: Problem
    feasible: Feasible
    planning: Planning
    stream: int

    def plan(self, filtering: OneFilter, taken: Times, plan: Times, draw: int = 0) -> Times:
        """Give the plan for what is left: the plan at hand, or a better one.

        Parameters
        ----------
        filtering : OneFilter
            The filter now.
        taken : tuple of int
            Times that were measured so far.
        plan : tuple of int
            The plan at hand; empty if there is none. It is kept only if it is feasible.
        draw : int
            Index of the system, which keys the noise.

        Raises
        ------
        ModelError
            A formula failed.
        """
        first = filtering.t + filtering.measured
        rest = rest_of(self.feasible, taken, first)
        if rest is None:
            return ()
        plan = tuple(time - first for time in plan)
        at_hand = [plan] if rest.accepts(plan) else []
        outlook = _Outlook(self, filtering, first, stream_key(self.stream, draw, filtering.t))
        found = outlook.search(rest, plan if at_hand else None)
        chosen = outlook.better([*at_hand, *found] or [rest.regular()])
        return tuple(first + time for time in chosen)


@dataclass(frozen=True)
class _Outlook:
    """Simulated futures of one system. Times count from the first instant still to be measured."""

    replanner: Replanner
    filtering: OneFilter
    first: int
    stream: int

    def search(self, rest: Feasible, start: Times | None) -> list[Times]:
        """Search for a plan, from a start; empty if every plan has a degenerate draw."""
        planning = self.replanner.planning
        optimiser, draws = planning.optimiser(rest, start), self._draws(range(planning.draws))
        state, generation = optimiser.init(), 0
        while not optimiser.done(state):
            asked = optimiser.ask(state, generator(self.stream, "search", generation))
            state = optimiser.tell(state, self._evaluated(draws, asked))
            generation += 1
        found = [each for each in optimiser.finalists(state)[:1] if math.isfinite(each.cost)]
        return [each.measurement_times for each in found]

    def better(self, plans: Sequence[Times]) -> Times:
        """Give the first of one or two plans, unless the second is better on fresh draws."""
        plans = list(dict.fromkeys(plans))
        if len(plans) == 1:
            return plans[0]
        planning = self.replanner.planning
        fresh = range(planning.draws, planning.draws + planning.judging_draws)
        kept, new = self._evaluated(self._draws(fresh), [Candidate(times) for times in plans])
        gain = difference(new, kept)
        real = gain.mean < -_ROUNDING * kept.cost
        return plans[1] if real and gain.is_better(_BETTER) else plans[0]

    def _draws(self, index: range) -> Draws | None:
        return None if self.problem.exact else self.problem.draws(index, self.stream)

    def _evaluated(
        self, draws: Draws | None, candidates: Sequence[Candidate]
    ) -> list[SearchEvaluation]:
        """Evaluate candidates on common draws with common noise."""
        problem, last = self.problem, self.problem.horizon
        sets = [tuple(self.first + time for time in each.measurement_times) for each in candidates]
        ends = [last if each.end is None else self.first + each.end for each in candidates]
        if draws is None:
            costs = problem.expected_mse(sets, ends)
            return [
                SearchEvaluation(
                    each.measurement_times, np.empty(0), _POLICY, float(cost), each.end
                )
                for each, cost in zip(candidates, costs, strict=True)
            ]
        noise = stream_key(self.stream, "filter")
        draws = draws[: max(each.draws or len(draws.index) for each in candidates)]
        mse = problem.mse_of_sets(draws, sets, ends, noise, self.replanner.planning.estimation)
        return [
            SearchEvaluation(each.measurement_times, column[: each.draws], _POLICY, None, each.end)
            for each, column in zip(candidates, mse.T, strict=True)
        ]

    @property
    def problem(self) -> Problem:
        """The problem from now on."""
        return replace(self.replanner.problem, prior=self.filtering.settings.prior)
