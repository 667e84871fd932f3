"""The survivor dynamic programme for every number of measurements N at once.

A prefix of n measurements is the same for every N. So one programme passes through n = 1, 2, ...
It extends the survivors with n measurements to n + 1. It also evaluates them as whole sets of
N = n, with no further measurement.

The limits are those of `pfdist.search.survivors`, wide enough for every N. The largest gap is that
of the smallest N to which the prefix may belong. The corridor reaches from the proportional
position for the largest N to that for the smallest.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pfdist.evaluation.estimate import SearchEvaluation
from pfdist.search.base import Candidate
from pfdist.search.survivors import CORRIDOR_GAPS, LARGEST_GAPS, WIDENING, surviving
from pfdist.times.feasible import Feasible
from pfdist.times.measurement_times import Times


@dataclass(frozen=True)
class EveryBudgetState:
    """Progress of the programme.

    Parameters
    ----------
    widening : float
        Factor by which the limits are wider than at first.
    front : tuple of tuples of int
        The survivors; all have the same number of measurements.
    whole : tuple of SearchEvaluation
        The best set of each N, sorted by N.
    before : tuple of tuples of int
        The best sets that were found under narrower limits.
    done : bool
    """

    widening: float = 1.0
    front: tuple[Times, ...] = ((),)
    whole: tuple[SearchEvaluation, ...] = ()
    before: tuple[Times, ...] = ()
    done: bool = False


@dataclass(frozen=True)
class EveryBudget:
    """Survivor dynamic programme for every N of a range.

    Parameters
    ----------
    feasible : Feasible
        The feasible sets of the largest N. Smaller N have the same constraints.
    least : int
        Smallest N.
    survivors : int
        Number of prefixes that survive in each state.
    by_previous : bool
        Whether a state is the last two measurement times. Otherwise it is the last alone.
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
        """Approximate number of generations: one for each measurement, and the end."""
        return self.most + 1

    @property
    def evaluations(self) -> float:
        """Approximate work, in evaluations of whole sets."""
        state, instants = self.init(), len(self.feasible.allowed)
        filtered = 0  # instants: a survivor is propagated over a gap, and measured at each instant
        for number in range(self.most):
            first, last = self._corridor(state, number) if number else (-1, -1)
            largest = self._largest_gap(state, number)
            indices = range(max(first, number - 1), min(last, instants - 1) + 1)
            filtered += sum(2 * min(largest, instants - 1 - index) for index in indices)
        return self.survivors * filtered / instants

    def init(self) -> EveryBudgetState:
        """Give the state before the first generation."""
        return EveryBudgetState()

    def ask(self, state: EveryBudgetState, rng: np.random.Generator) -> list[Candidate]:
        """Give extensions of the survivors up to their last time, and whole sets up to T."""
        return [
            *(Candidate((*times, t), t) for times, t in self._extended(state)),
            *(Candidate(times) for times in self._closed(state)),
        ]

    def tell(
        self, state: EveryBudgetState, evaluations: Sequence[SearchEvaluation]
    ) -> EveryBudgetState:
        """Keep the best prefixes of each state; at the end, widen limits that a set reaches."""
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

    def done(self, state: EveryBudgetState) -> bool:
        """Whether the search has ended."""
        return state.done

    def finalists(self, state: EveryBudgetState) -> tuple[SearchEvaluation, ...]:
        """Give the best set of each N, the set with the least cost first."""
        return tuple(sorted(state.whole, key=lambda evaluation: evaluation.cost))

    @cached_property
    def _feasible_by_number(self) -> dict[int, Feasible]:
        """The feasible sets of each N."""
        return {
            number: replace(self.feasible, measurement_budget=number)
            for number in range(self.least, self.most + 1)
        }

    def _extended(self, state: EveryBudgetState) -> list[tuple[Times, int]]:
        """Give pairs of a survivor and a time that may follow it."""
        every = [(times, t) for times in state.front for t in self._following(times)]
        number = len(state.front[0]) + 1
        first, last = self._corridor(state, number)
        largest, index = self._largest_gap(state, number), self.feasible.index
        within = [
            (times, t)
            for times, t in every
            if first <= index[t] <= last and index[t] - self._last(times) <= largest
        ]
        return within or every  # if the limits leave nothing, they do not apply

    def _following(self, times: Times) -> list[int]:
        """Give the times that may follow a prefix, for any N: small N leave the most freedom."""
        waiting = sum(time > (times[-1] if times else -1) for time in self.feasible.required)
        # The next time is a required time, or an optional time before it.
        totals = {max(self.least, len(times) + waiting + more) for more in (0, 1)}
        sets = [self._feasible_by_number[total] for total in totals if total <= self.most]
        return sorted({time for feasible in sets for time in feasible.extensions(times)})

    def _closed(self, state: EveryBudgetState) -> list[Times]:
        """Give the survivors that are whole sets and do not end too early."""
        feasible = self._feasible_by_number.get(len(state.front[0]))
        every = [times for times in state.front if feasible and feasible.accepts(times)]
        largest = self._largest_gap(state, len(state.front[0]))
        near = [
            times for times in every if len(self.feasible.allowed) - self._last(times) <= largest
        ]
        return near or every

    def _last(self, times: Times) -> int:
        """Give the index of the last measurement; -1 for an empty prefix."""
        return self.feasible.index[times[-1]] if times else -1

    def _largest_gap(self, state: EveryBudgetState, number: int) -> int:
        """Give the largest allowed difference of the indices of two successive measurements."""
        mean_gap = len(self.feasible.allowed) / max(number, self.least)
        return max(2, math.ceil(LARGEST_GAPS * state.widening * mean_gap))

    def _corridor(self, state: EveryBudgetState, number: int) -> tuple[int, int]:
        """Give the first and last allowed index of a measurement, by its number from 1."""
        narrow, wide = (
            len(self.feasible.allowed) / measurements
            for measurements in (self.most, max(number, self.least))
        )
        half, gaps = number - 0.5, CORRIDOR_GAPS * state.widening
        first = half * narrow - 0.5 - max(2.0, gaps * narrow)
        return math.floor(first), math.ceil(half * wide - 0.5 + max(2.0, gaps * wide))

    def _ended(self, state: EveryBudgetState) -> EveryBudgetState:
        """End the search, or start again with wider limits."""
        best = tuple(evaluation.measurement_times for evaluation in state.whole)
        lacking = len(best) <= self.most - self.least
        limited = any(self._is_limited(state, times) for times in {*best} - {*state.before})
        unlimited = CORRIDOR_GAPS * state.widening >= self.most  # the corridor holds all times
        if unlimited or not (lacking or limited):
            return replace(state, done=True)
        return EveryBudgetState(WIDENING * state.widening, whole=state.whole, before=best)

    def _is_limited(self, state: EveryBudgetState, times: Times) -> bool:
        """Whether a gap is the largest allowed, or a time lies at the edge of its corridor."""
        indices = [self.feasible.index[time] for time in times]
        numbers = range(1, len(indices) + 1)
        return any(self._at_a_limit(state, indices, number) for number in numbers)

    def _at_a_limit(self, state: EveryBudgetState, indices: list[int], number: int) -> bool:
        index, instants = indices[number - 1], len(self.feasible.allowed)
        gap = index - (indices[number - 2] if number > 1 else -1)
        first, last = self._corridor(state, number)
        return (
            self._largest_gap(state, number) <= gap < instants
            # At the edges of the horizon the other measurements limit a time, not the corridor.
            or number - 1 < index <= first
            or last <= index < instants - 1 - (len(indices) - number)
        )
