"""The corridor method: survivor dynamic programming in a narrow corridor around a set of times.

The search starts from a good set of times. The dynamic programme moves each of its times by a few
instants. If it finds a better set, the next corridor is around that set, and so on. A corridor is
narrow, so each round is quick. Times can drift far over several rounds.

References
----------
Sniedovich, Voss, "The corridor method: a dynamic programming inspired metaheuristic", Control and
Cybernetics 35, 2006.
"""

from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate

import numpy as np

from pfdist.common.measurement_times import Times
from pfdist.filters.estimate import Evaluation
from pfdist.problem.methods import method
from pfdist.problem.search_section import Count, Positive
from pfdist.search.base import Candidate, best_of
from pfdist.search.survivors import Survivors, SurvivorState


@method("corridor", curve="best so far", additive=True)
@dataclass(frozen=True)
class Corridor(Survivors):
    """Corridor method: dynamic programming moves each time a little, repeatedly while this helps.

    Parameters
    ----------
    feasible : Feasible
    survivors : int
        Number of prefixes that survive in each state.
    by_previous : bool
        Whether a state is the last two measurement times; otherwise it is only the last.
    start : tuple of int, optional
        First set. By default, or if it is empty, regular times.
    reach : float
        Largest move of a time in a round, in units of the mean gap between measurements.
    rounds : int
        Largest number of rounds.
    """

    survivors: Count = 1
    start: Times | None = None
    reach: Positive = 1.5
    rounds: Count = 20

    @property
    def generations(self) -> int:
        """Approximate number of generations, if half of the rounds help."""
        return (self.feasible.total + 1) * max(1, self.rounds // 2)

    @property
    def evaluations(self) -> float:
        """Approximate work, in evaluations of whole sets."""
        width, instants = 2 * self._moved + 1, len(self.feasible.allowed)
        extended = self.survivors * width * (width + instants / self.feasible.total)
        return extended * self.generations / instants

    def init(self) -> SurvivorState:
        """The state before the first generation, with a corridor around the first set."""
        return self._around(self.start or self.feasible.regular())

    def ask(self, state: SurvivorState, rng: np.random.Generator) -> list[Candidate]:
        """Extensions in the corridor; at the end whole sets and the middle of the corridor."""
        candidates = super().ask(state, rng)
        middle = Candidate(state.middle)
        return candidates if state.front or middle in candidates else [*candidates, middle]

    def _around(
        self, middle: Times, number: int = 0, whole: tuple[Evaluation, ...] = ()
    ) -> SurvivorState:
        """The state at the beginning of a round, with a corridor around a set."""
        return SurvivorState(
            len(self.feasible.allowed),
            float(self._moved),
            whole=whole,
            middle=middle,
            round=number,
        )

    def _next(self, state: SurvivorState, times: Times) -> Iterator[int]:
        """Yield the times in the corridor that may follow a prefix; all around the empty set."""
        feasible = self.feasible
        if not state.middle:
            yield from feasible.extensions(times)
            return
        spent_in_middle = accumulate((feasible.units[time] for time in state.middle), initial=0)
        number = bisect_left(list(spent_in_middle), feasible.spent(times))
        middle = feasible.index[state.middle[min(number, len(state.middle) - 1)]]
        for time in feasible.extensions(times):
            if abs(feasible.index[time] - middle) <= self._moved:
                yield time

    def _whole(self, state: SurvivorState, evaluations: Sequence[Evaluation]) -> SurvivorState:
        """End the search, or lay the corridor around the best set."""
        whole, number = best_of((*state.whole, *evaluations)), state.round + 1
        best = whole[0].measurement_times
        if best == state.middle or number == self.rounds:
            return replace(state, whole=whole, done=True)
        return self._around(best, number, whole)

    @cached_property
    def _moved(self) -> int:
        """Largest move of a time, in allowed times."""
        feasible = self.feasible
        mean_gap = feasible.spent(feasible.allowed) / feasible.total
        return max(1, round(self.reach * mean_gap))
