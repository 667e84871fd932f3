"""Survivor dynamic programming: extends prefixes and keeps the best of each state.

The error up to t depends only on the measurements up to t. So sets are built from the left. The
state of a prefix is its last measurement time (or its last two), and the number of measurements, or
the money spent. The few prefixes with the smallest error survive in each state. Each survivor is
extended by a measurement at every time that is near enough and still allows a feasible set. The
programme would be exact if later errors depended on the state alone. But they also depend on the
particles of the prefix, so several prefixes survive.

All prefixes should be evaluated under common noise. Then a common part of two prefixes is filtered
once, and noise hardly affects the difference of their errors.

References
----------
Bellman, "Dynamic programming", 1957. Viterbi, "Error bounds for convolutional codes and an
asymptotically optimum decoding algorithm", IEEE Transactions on Information Theory 13, 1967, of
which this is a list version (Seshadri, Sundberg, "List Viterbi decoding algorithms with
applications", IEEE Transactions on Communications 42, 1994).
"""

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from pfdist.common.measurement_times import Times
from pfdist.filters.estimate import Evaluation
from pfdist.problem.feasible import Feasible
from pfdist.problem.methods import method
from pfdist.problem.search_section import Count, Flag
from pfdist.search.base import Candidate, best_of

# Limits at first, in units of the mean gap between measurements:
LARGEST_GAPS = 3.0  # the largest gap
CORRIDOR_GAPS = 2.25  # the largest distance of a measurement from its proportional position
WIDENING = 1.5  # factor by which limits grow that the best set reaches


@dataclass(frozen=True)
class SurvivorState:
    """Progress of the programme. Distances count allowed times."""

    largest_gap: int  # largest distance of two successive measurements that is tried
    # Largest distance of a measurement from its proportional position: the position that
    # corresponds to the share of the budget spent before it.
    corridor: float
    front: tuple[Times, ...] = ((),)  # survivors to be extended next; all have spent the same
    waiting: tuple[Evaluation, ...] = ()  # evaluated prefixes that have spent more than the front
    ended: tuple[Times, ...] = ()  # survivors that are whole sets
    whole: tuple[Evaluation, ...] = ()  # evaluated whole sets, the best first
    done: bool = False
    # The set around which measurements are tried; empty: around their proportional positions.
    middle: Times = ()
    round: int = 0  # number of sets around which measurements were tried before


@method("survivors", polish=True, curve="best so far", additive=True, listed=False)
@dataclass(frozen=True)
class Survivors:
    """Survivor dynamic programming (beam search): extends prefixes, keeps the best at each time.

    Parameters
    ----------
    feasible : Feasible
    survivors : int
        Number of prefixes that survive in each state.
    by_previous : bool
        Whether a state is the last two measurement times; otherwise it is only the last.
    """

    feasible: Feasible
    survivors: Count = 2
    by_previous: Flag = False

    @property
    def generations(self) -> int:
        """Approximate number of generations: one for each measurement, and the end."""
        return self.feasible.total + 1

    @property
    def evaluations(self) -> float:
        """Approximate work, in evaluations of whole sets.

        Each survivor is extended up to the largest gap. About the same work is needed to reach the
        times at which the survivors differ.
        """
        state, instants = self.init(), len(self.feasible.allowed)
        width = min(2 * state.corridor + 1, instants)
        extended = self.survivors * width * min(state.largest_gap, instants)
        return 2 * extended * self.feasible.total / instants

    def init(self) -> SurvivorState:
        """The state before the first generation, with the initial limits."""
        mean_gap = self.feasible.spent(self.feasible.allowed) / self.feasible.total
        largest_gap = max(2, math.ceil(LARGEST_GAPS * mean_gap))
        ended = ((),) if self.feasible.accepts(()) else ()
        return SurvivorState(largest_gap, max(2.0, CORRIDOR_GAPS * mean_gap), ended=ended)

    def ask(self, state: SurvivorState, rng: np.random.Generator) -> list[Candidate]:
        """Extensions of the survivors up to their last time; at the end whole sets up to T."""
        if not state.front:
            return [Candidate(times) for times in state.ended]
        near = [(*times, t) for times in state.front for t in self._next(state, times)]
        every = ((*times, t) for times in state.front for t in self.feasible.extensions(times))
        # If the limits leave nothing, they do not apply.
        instant = self.feasible.points.instant
        return [Candidate(times, instant(times[-1])) for times in near or every]

    def tell(self, state: SurvivorState, evaluations: Sequence[Evaluation]) -> SurvivorState:
        """Keep the best prefixes of each state; at the end, widen the limits that a set reaches."""
        if not state.front:
            return self._whole(state, evaluations)
        state = replace(state, front=(), waiting=(*state.waiting, *evaluations))
        while state.waiting and not state.front:
            state = self._advanced(state)
        return state

    def done(self, state: SurvivorState) -> bool:
        """Whether the search has ended."""
        return state.done

    def finalists(self, state: SurvivorState) -> tuple[Evaluation, ...]:
        """The best whole sets."""
        return state.whole

    def _next(self, state: SurvivorState, times: Times) -> Iterator[int]:
        """Yield the times within the limits that may follow a prefix."""
        index, spent = self.feasible.index, self.feasible.spent(times)
        after = index[times[-1]] + 1 if times else 0
        for time in self.feasible.extensions(times):
            if index[time] >= after + state.largest_gap:
                break
            first, last = self._corridor(state, spent, time)
            if first <= index[time] <= last:
                yield time

    def _advanced(self, state: SurvivorState) -> SurvivorState:
        """Keep the best of the prefixes that have spent least; the others wait."""
        spent = [self.feasible.spent(evaluation.measurement_times) for evaluation in state.waiting]
        least = min(spent)
        reached: list[Evaluation] = []
        waiting: list[Evaluation] = []
        for evaluation, spent_so_far in zip(state.waiting, spent, strict=True):
            (reached if spent_so_far == least else waiting).append(evaluation)
        survivors = surviving(reached, self.survivors, self.by_previous)
        ended = {times for times in survivors if self.feasible.accepts(times)}
        return replace(
            state,
            front=tuple(times for times in survivors if self.feasible.extensions(times)),
            waiting=tuple(waiting),
            ended=(*state.ended, *(times for times in survivors if times in ended)),
        )

    def _whole(self, state: SurvivorState, evaluations: Sequence[Evaluation]) -> SurvivorState:
        """End the search, or start again with wider limits."""
        whole, before = best_of((*state.whole, *evaluations)), state.whole[:1]
        best = whole[0].measurement_times
        if (before and before[0].measurement_times == best) or not self._is_limited(state, best):
            return replace(state, whole=whole, done=True)
        gap = min(self.feasible.possible, math.ceil(WIDENING * state.largest_gap))
        return SurvivorState(gap, WIDENING * state.corridor, whole=whole)

    def _is_limited(self, state: SurvivorState, times: Times) -> bool:
        """Whether a gap is the largest allowed, or a time lies at the edge of its corridor."""
        indices = [self.feasible.index[time] for time in times]
        gaps = [index - before for before, index in zip((-1, *indices), indices, strict=False)]
        if max(gaps or [0]) >= state.largest_gap and state.largest_gap < len(self.feasible.allowed):
            return True
        highest, dearest = len(self.feasible.allowed) - 1, max(self.feasible.units)
        for number, (time, index) in enumerate(zip(times, indices, strict=True)):
            spent = self.feasible.spent(times[:number])
            first, last = self._corridor(state, spent, time)
            left = self.feasible.total - spent - self.feasible.units[time]
            # At the edges of the horizon the other measurements limit a time, not the corridor.
            if number < index <= first or last <= index < highest - left // dearest:
                return True
        return False

    def _corridor(self, state: SurvivorState, spent: int, time: int) -> tuple[int, int]:
        """The first and last allowed index of a measurement, by the sum spent before it.

        If smaller sets are feasible, money may be left over, so no index is too late.
        """
        mean_gap = len(self.feasible.allowed) / self.feasible.total  # for a price of 1
        proportional = (spent + self.feasible.units[time] / 2) * mean_gap - 0.5
        late = self.feasible.possible - 1 if self.feasible.smaller else state.corridor
        return math.floor(proportional - state.corridor), math.ceil(proportional + late)


def surviving(prefixes: Iterable[Evaluation], survivors: int, by_previous: bool) -> list[Times]:
    """The times of the best prefixes of each state, in the order of the states.

    With `by_previous`, a state is the last two measurement times, else the last. All prefixes have
    spent the same sum, so it is not part of the state here.
    """
    reached: dict[Times, list[Evaluation]] = defaultdict(list)
    for prefix in prefixes:
        reached[prefix.measurement_times[-2 if by_previous else -1 :]].append(prefix)
    return [
        prefix.measurement_times
        for _, candidates in sorted(reached.items())
        for prefix in sorted(candidates, key=lambda prefix: prefix.expected_mse)[:survivors]
    ]
