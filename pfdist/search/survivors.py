"""A dynamic programme over prefixes: of all that measured last at one time, the best survive.

The error up to t depends on the measurements up to t alone. So sets are built from the left: a
state is the last measured time (or the last two) and what was spent: a number of measurements, or
money where they cost some. Of the prefixes that lead to it a few of the least cost up to there
survive, and each is extended by a measurement at every time that is not too far away, and of which
a feasible set can come. It would be exact if one number said all about a prefix; but its cloud
matters for what follows, so several survive.

All prefixes are to be evaluated under the same noise: what they share is then filtered once, and
their costs differ by little else than what they are worth.

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

from pfdist.evaluation import SearchEvaluation
from pfdist.feasible import Feasible
from pfdist.measurement_times import Times
from pfdist.search.base import Candidate, best_of

GAPS = 3.0  # mean ones: the largest that is tried at first
PLACES = 2.25  # mean gaps, by which a measurement may lie off its proportional place at first
WIDER = 1.5  # what becomes of both where they are in the way


@dataclass(frozen=True)
class SurvivorState:
    """How far the programme is. Distances are counted in times that may be measured at.

    Parameters
    ----------
    longest_gap : int
        Largest difference of two measurement times that is tried.
    corridor : float
        How far a measurement may lie from its place in proportion to what was spent.
    front : tuple of tuples of int
        The survivors that are to be extended: all have spent the same.
    waiting : tuple of SearchEvaluation
        What was reached and has spent more: its turn comes.
    ended : tuple of tuples of int
        Survivors that are whole sets.
    whole : tuple of SearchEvaluation
        Whole sets, the best first.
    done : bool
    """

    longest_gap: int
    corridor: float
    front: tuple[Times, ...] = ((),)
    waiting: tuple[SearchEvaluation, ...] = ()
    ended: tuple[Times, ...] = ()
    whole: tuple[SearchEvaluation, ...] = ()
    done: bool = False


@dataclass(frozen=True)
class Survivors:
    """Survivor dynamic programme.

    Parameters
    ----------
    feasible : Feasible
    survivors : int
        How many survive in each state.
    by_previous : bool
        Whether a state is the last two measured times, or the last alone.
    """

    feasible: Feasible
    survivors: int = 2
    by_previous: bool = False

    @property
    def generations(self) -> int:
        """About how often it will ask: each measurement, and the end."""
        return self.feasible.total + 1

    @property
    def evaluations(self) -> float:
        """About how many whole evaluations its work amounts to.

        At each level every survivor is extended up to the longest gap, and as much again is done to
        come to where they differ.
        """
        state, instants = self.init(), len(self.feasible.allowed)
        width = min(2 * state.corridor + 1, instants)
        extended = self.survivors * width * min(state.longest_gap, instants)
        return 2 * extended * self.feasible.total / instants

    def init(self) -> SurvivorState:
        """Give the state before the first asking: gaps of up to three mean ones."""
        mean_gap = self.feasible.spent(self.feasible.allowed) / self.feasible.total
        return SurvivorState(max(2, math.ceil(GAPS * mean_gap)), max(2.0, PLACES * mean_gap))

    def ask(self, state: SurvivorState, rng: np.random.Generator) -> list[Candidate]:
        """Give the extensions of all survivors up to their last time; of whole sets, up to T."""
        if not state.front:
            return [Candidate(times) for times in state.ended]
        near = [(*times, t) for times in state.front for t in self._next(state, times)]
        every = ((*times, t) for times in state.front for t in self.feasible.extensions(times))
        return [Candidate(times, times[-1]) for times in near or every]  # limits may leave nothing

    def tell(self, state: SurvivorState, evaluations: Sequence[SearchEvaluation]) -> SurvivorState:
        """Let the best of each state survive; at the end, widen limits that were in the way."""
        if not state.front:
            return self._whole(state, evaluations)
        state = replace(state, front=(), waiting=(*state.waiting, *evaluations))
        while state.waiting and not state.front:
            state = self._advanced(state)
        return state

    def done(self, state: SurvivorState) -> bool:
        """Whether its limits are in the way no more."""
        return state.done

    def finalists(self, state: SurvivorState) -> tuple[SearchEvaluation, ...]:
        """Give the best whole sets."""
        return state.whole

    def _next(self, state: SurvivorState, times: Times) -> Iterator[int]:
        """The times that may come next and lie within the limits."""
        after, spent = (
            self.feasible.place[times[-1]] + 1 if times else 0,
            self.feasible.spent(times),
        )
        for time in self.feasible.extensions(times):
            if self.feasible.place[time] >= after + state.longest_gap:
                break
            first, last = self._corridor(state, spent, time)
            if first <= self.feasible.place[time] <= last:
                yield time

    def _advanced(self, state: SurvivorState) -> SurvivorState:
        """Let those survive of what has cost least; the others go on waiting."""
        spent = [self.feasible.spent(evaluation.measurement_times) for evaluation in state.waiting]
        least = min(spent)
        reached: list[SearchEvaluation] = []
        waiting: list[SearchEvaluation] = []
        for evaluation, spent_so_far in zip(state.waiting, spent, strict=True):
            (reached if spent_so_far == least else waiting).append(evaluation)
        survivors = surviving(reached, self.survivors, self.by_previous)
        ended = {times for times in survivors if self.feasible.accepts(times)}
        return replace(
            state,
            front=tuple(times for times in survivors if times not in ended),
            waiting=tuple(waiting),
            ended=(*state.ended, *(times for times in survivors if times in ended)),
        )

    def _whole(
        self, state: SurvivorState, evaluations: Sequence[SearchEvaluation]
    ) -> SurvivorState:
        whole, before = best_of((*state.whole, *evaluations)), state.whole[:1]
        best = whole[0].measurement_times
        if (before and before[0].measurement_times == best) or not self._leans(state, best):
            return replace(state, whole=whole, done=True)
        gap = min(self.feasible.horizon + 1, math.ceil(WIDER * state.longest_gap))
        return SurvivorState(gap, WIDER * state.corridor, whole=whole)

    def _leans(self, state: SurvivorState, times: Times) -> bool:
        """Whether a gap is the longest, or a time at the edge of its place, that was allowed."""
        places = [self.feasible.place[time] for time in times]
        gaps = [b - a for a, b in zip((-1, *places), places, strict=False)]
        if max(gaps) >= state.longest_gap and state.longest_gap < len(self.feasible.allowed):
            return True
        highest, dearest = len(self.feasible.allowed) - 1, max(self.feasible.price)
        for number, (time, place) in enumerate(zip(times, places, strict=True)):
            spent = self.feasible.spent(times[:number])
            first, last = self._corridor(state, spent, time)
            left = self.feasible.total - spent - self.feasible.price[time]
            # The others before it, and those that are still to be paid for, need room.
            if number < place <= first or last <= place < highest - left // dearest:
                return True
        return False

    def _corridor(self, state: SurvivorState, spent: int, time: int) -> tuple[int, int]:
        """First and last place of a measurement, by what was spent before it and what it costs."""
        mean_gap = len(self.feasible.allowed) / self.feasible.total  # of what costs 1
        proportional = (spent + self.feasible.price[time] / 2) * mean_gap - 0.5
        return math.floor(proportional - state.corridor), math.ceil(proportional + state.corridor)


def surviving(
    prefixes: Iterable[SearchEvaluation], survivors: int, by_previous: bool
) -> list[Times]:
    """Give the best of each state, so many, in the order of the states.

    Parameters
    ----------
    prefixes : iterable of SearchEvaluation
        All that were reached.
    survivors : int
        How many survive in each state.
    by_previous : bool
        Whether a state is the last two measured times, or the last alone.
    """
    reached: dict[Times, list[SearchEvaluation]] = defaultdict(list)
    for prefix in prefixes:
        reached[prefix.measurement_times[-2 if by_previous else -1 :]].append(prefix)
    return [
        prefix.measurement_times
        for _, candidates in sorted(reached.items())
        for prefix in sorted(candidates, key=lambda prefix: prefix.cost)[:survivors]
    ]
