"""The survivor programme for every number of measurements at once.

A prefix of n measurements is the same whatever N it becomes a set of. So one programme passes
through n = 1, 2, ...: the survivors with n measurements are extended to n + 1, and closed, as sets
of N = n, by the error of measuring no more.

Its limits are those of `pfdist.search.survivors`, wide enough for every N that a prefix may belong
to: the longest gap is that of the smallest such N, and the corridor reaches from where the largest
N would put the measurement to where the smallest would.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pfdist.evaluation import SearchEvaluation
from pfdist.feasible import Feasible
from pfdist.measurement_times import Times
from pfdist.search.base import Candidate
from pfdist.search.survivors import GAPS, PLACES, WIDER, surviving


@dataclass(frozen=True)
class BudgetState:
    """How far the programme is.

    Parameters
    ----------
    wider : float
        By how much its limits are wider than at first.
    front : tuple of tuples of int
        The survivors, of as many measurements each.
    whole : tuple of SearchEvaluation
        The best set of each N, by N.
    before : tuple of tuples of int
        The best sets when the limits were narrower.
    done : bool
    """

    wider: float = 1.0
    front: tuple[Times, ...] = ((),)
    whole: tuple[SearchEvaluation, ...] = ()
    before: tuple[Times, ...] = ()
    done: bool = False


@dataclass(frozen=True)
class Budgets:
    """Survivor dynamic programme for every N of a range.

    Parameters
    ----------
    feasible : Feasible
        Of the largest N; the smaller ones have the same constraints.
    least : int
        Smallest N.
    survivors : int
        How many survive in each state.
    by_previous : bool
        Whether a state is the last two measured times, or the last alone.
    """

    feasible: Feasible
    least: int
    survivors: int = 2
    by_previous: bool = False

    @property
    def most(self) -> int:
        """Largest N."""
        return self.feasible.total

    @property
    def generations(self) -> int:
        """About how often it will ask: each measurement, and the end."""
        return self.most + 1

    @property
    def evaluations(self) -> float:
        """About how many whole evaluations its work amounts to."""
        state, instants = self.init(), len(self.feasible.allowed)
        filtered = 0  # instants: each survivor goes on unmeasured, and is measured at each
        for number in range(self.most):
            first, last = self._corridor(state, number) if number else (-1, -1)
            longest = self._longest_gap(state, number)
            places = range(max(first, number - 1), min(last, instants - 1) + 1)
            filtered += sum(2 * min(longest, instants - 1 - place) for place in places)
        return self.survivors * filtered / instants

    def init(self) -> BudgetState:
        """Give the state before the first asking."""
        return BudgetState()

    def ask(self, state: BudgetState, rng: np.random.Generator) -> list[Candidate]:
        """Give the survivors' extensions up to their last time, and what are sets up to T."""
        return [
            *(Candidate((*times, t), t) for times, t in self._extended(state)),
            *(Candidate(times) for times in self._closed(state)),
        ]

    def tell(self, state: BudgetState, evaluations: Sequence[SearchEvaluation]) -> BudgetState:
        """Let the best of each state survive; at the end, widen limits that were in the way."""
        best = {len(evaluation.measurement_times): evaluation for evaluation in state.whole}
        for evaluation in evaluations:
            number = len(evaluation.measurement_times)
            if evaluation.end is None and (
                number not in best or evaluation.cost < best[number].cost
            ):
                best[number] = evaluation
        prefixes = [evaluation for evaluation in evaluations if evaluation.end is not None]
        front = surviving(prefixes, self.survivors, self.by_previous)
        state = replace(
            state, front=tuple(front), whole=tuple(best[number] for number in sorted(best))
        )
        return state if front else self._ended(state)

    def done(self, state: BudgetState) -> bool:
        """Whether its limits are in the way no more."""
        return state.done

    def finalists(self, state: BudgetState) -> tuple[SearchEvaluation, ...]:
        """Give the best set of each N, the best of all first."""
        return tuple(sorted(state.whole, key=lambda evaluation: evaluation.cost))

    @cached_property
    def _of(self) -> dict[int, Feasible]:
        """The sets of each N."""
        return {
            number: replace(self.feasible, measurement_budget=number)
            for number in range(self.least, self.most + 1)
        }

    def _extended(self, state: BudgetState) -> list[tuple[Times, int]]:
        """The survivors, each with the times that may come next."""
        every = [(times, t) for times in state.front for t in self._following(times)]
        number = len(state.front[0]) + 1
        first, last = self._corridor(state, number)
        longest, place = self._longest_gap(state, number), self.feasible.place
        return [
            (times, t)
            for times, t in every
            if first <= place[t] <= last and place[t] - self._last(times) <= longest
        ] or every  # the limits leave nothing

    def _following(self, times: Times) -> list[int]:
        """The times that may come next in a set of some N: as few as can be leave most room."""
        waiting = sum(time > (times[-1] if times else -1) for time in self.feasible.required)
        # One of those required, or another time before them.
        totals = {max(self.least, len(times) + waiting + more) for more in (0, 1)}
        sets = [self._of[total] for total in totals if total <= self.most]
        return sorted({time for feasible in sets for time in feasible.extensions(times)})

    def _closed(self, state: BudgetState) -> list[Times]:
        """The survivors that are whole sets, and do not end too early."""
        feasible = self._of.get(len(state.front[0]))
        every = [times for times in state.front if feasible and feasible.accepts(times)]
        longest = self._longest_gap(state, len(state.front[0]))
        near = [
            times for times in every if len(self.feasible.allowed) - self._last(times) <= longest
        ]
        return near or every

    def _last(self, times: Times) -> int:
        """Place of the last measurement, -1 before the first."""
        return self.feasible.place[times[-1]] if times else -1

    def _longest_gap(self, state: BudgetState, number: int) -> int:
        """Largest difference of a measurement's place and that before it."""
        mean_gap = len(self.feasible.allowed) / max(number, self.least)
        return max(2, math.ceil(GAPS * state.wider * mean_gap))

    def _corridor(self, state: BudgetState, number: int) -> tuple[int, int]:
        """First and last place of a measurement by its number, counted from 1."""
        narrow, wide = (
            len(self.feasible.allowed) / measurements
            for measurements in (self.most, max(number, self.least))
        )
        half, off = number - 0.5, PLACES * state.wider
        first = half * narrow - 0.5 - max(2.0, off * narrow)
        return math.floor(first), math.ceil(half * wide - 0.5 + max(2.0, off * wide))

    def _ended(self, state: BudgetState) -> BudgetState:
        best = tuple(evaluation.measurement_times for evaluation in state.whole)
        lacking = len(best) <= self.most - self.least
        leaning = any(self._leans(state, times) for times in {*best} - {*state.before})
        unlimited = PLACES * state.wider >= self.most  # as far as all of them are apart
        if unlimited or not (lacking or leaning):
            return replace(state, done=True)
        return BudgetState(WIDER * state.wider, whole=state.whole, before=best)

    def _leans(self, state: BudgetState, times: Times) -> bool:
        """Whether a gap is the longest, or a time at the edge of its place, that was allowed."""
        places = [self.feasible.place[time] for time in times]
        return any(self._limited(state, places, number) for number in range(1, len(places) + 1))

    def _limited(self, state: BudgetState, places: list[int], number: int) -> bool:
        place, instants = places[number - 1], len(self.feasible.allowed)
        gap = place - (places[number - 2] if number > 1 else -1)
        first, last = self._corridor(state, number)
        return (
            self._longest_gap(state, number) <= gap < instants
            # The others before and after it need room.
            or number - 1 < place <= first
            or last <= place < instants - 1 - (len(places) - number)
        )
