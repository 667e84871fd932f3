"""Exchange search: one time is exchanged for another as long as this lowers the error.

The neighbours of the best set are first evaluated on few draws. If a paired test finds the best
neighbour better than the best set, it becomes the best set at once. Otherwise neighbours that are
worse than the best neighbour are dropped, and the others are evaluated on twice as many draws. The
result is a local optimum within the precision of these draws.

References
----------
Fedorov, "Theory of optimal experiments", 1972 (exchange). Hong, Nelson, "Discrete optimization via
simulation using COMPASS", Operations Research 54, 2006 (neighbours under simulation noise).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from pfdist.common.measurement_times import Times
from pfdist.filters.estimate import Evaluation
from pfdist.problem.feasible import Feasible
from pfdist.problem.methods import method
from pfdist.search.base import Candidate, best_of

FEWEST = 32
"""Draws of the first evaluation; enough to know the standard error of a mean."""
_ALMOST_AS_GOOD = 20  # sets; the median
_LONGEST_RUN = 48
"""Largest number of times in a shifted run, so that a set of N times has at most 96 N shifts.

A shift changes only the gaps at the ends of a run. The ends of a longer run are so far apart that
their errors are independent. Shifts of shorter runs then do as well.
"""


def shifts(feasible: Feasible, times: Times) -> list[Times]:
    """The feasible sets with a run of at most 48 successive times moved by one allowed time."""
    allowed, places = feasible.allowed, [feasible.index[time] for time in times]
    shifted = dict[Times, None]()
    runs = (
        (first, stop)
        for first in range(len(times))
        for stop in range(first + 1, min(first + _LONGEST_RUN, len(times)) + 1)
    )
    for first, stop in runs:
        for step in (-feasible.points.ways, feasible.points.ways):
            moved = [place + step for place in places[first:stop]]
            if moved[0] >= 0 and moved[-1] < len(allowed):
                run = (allowed[place] for place in moved)
                shifted[(*times[:first], *run, *times[stop:])] = None
    return [new for new in shifted if len({*new}) == len(new) and feasible.accepts(new)]


# Differences in standard errors:
_WORSE = 2.0  # from here on a neighbour is worse than the best neighbour, and dropped
_BETTER = 3.0  # from here on a neighbour is better than the best set
_BETTER_AT_LAST = 1.5  # likewise, on all draws


@dataclass(frozen=True)
class ExchangeState:
    """Progress of the search."""

    best: Times
    neighbours: tuple[Times, ...] = ()  # of the best set, which may be better
    draws: int = FEWEST  # of the next evaluations
    left: tuple[Times, ...] = ()  # former best sets
    # the result, the best first; empty until the search ends
    evaluations: tuple[Evaluation, ...] = ()


@method("exchange", curve="best so far")
@dataclass(frozen=True)
class Exchange:
    """Exchange search: starts from regular times, exchanges one time for another while this helps.

    Parameters
    ----------
    feasible : Feasible
    draws : int
        Largest number of draws of an evaluation.
    start : tuple of int, optional
        First set. By default regular times.
    reach : int, optional
        Largest distance that a time is moved. By default there is no limit.
    moves : int
        Largest number of moves.
    fewest : int
        Number of draws of the first evaluation of a set.
    others : tuple of tuple of int
        Good sets from which exchanges may begin, too, if they are better than the first set.
    """

    feasible: Feasible
    draws: int
    start: Times | None = None
    reach: int | None = None
    moves: int = 200
    fewest: int = FEWEST
    others: tuple[Times, ...] = ()

    @property
    def generations(self) -> int:
        """Approximate number of generations: few with `reach`, otherwise three for each time."""
        return 12 if self.reach else 3 * len(self._start)

    @property
    def evaluations(self) -> float:
        """Approximate work, in evaluations of whole sets; half of it is shared by neighbours."""
        tried = 1 + _number_of_exchanges(self.feasible, self._start, self.reach)
        return self.generations / 3 * tried * self._fewest / self.draws

    @property
    def usual_evaluations(self) -> float:
        """Usual work, with the sets that are almost as good, and take all draws.

        There were 5 to 300 of them in 28 jobs, which no horizon or number of measurements foretold.
        """
        return self.evaluations / 2 + _ALMOST_AS_GOOD

    def init(self) -> ExchangeState:
        """The state before the first generation."""
        first = self._around(self._start)
        beside = (each for each in self.others if each != first.best)
        return replace(first, neighbours=(*dict.fromkeys((*first.neighbours, *beside)),))

    def ask(self, state: ExchangeState, rng: np.random.Generator) -> list[Candidate]:
        """The best set and the neighbours that may be better."""
        return [Candidate(times, draws=state.draws) for times in (state.best, *state.neighbours)]

    def tell(self, state: ExchangeState, evaluations: Sequence[Evaluation]) -> ExchangeState:
        """Move to the best neighbour if it is better; otherwise drop the worse neighbours."""
        best, *others = evaluations
        order = sorted(others, key=lambda evaluation: evaluation.expected_mse)
        last = state.draws == self.draws
        if order and len(state.left) < self.moves:
            leader = order[0].measurement_times
            # A test on few draws may err. It never leads back, or the search might cycle for ever.
            few = math.inf if leader in state.left else _BETTER
            if order[0].difference(best).is_negative(_BETTER_AT_LAST if last else few):
                return replace(self._around(leader), left=(*state.left, state.best))
        if last:
            return replace(state, evaluations=best_of(evaluations))
        least = min(evaluations, key=lambda evaluation: evaluation.expected_mse)
        near = [
            evaluation
            for evaluation in order
            if not evaluation.difference(least).is_positive(_WORSE)
        ]
        names = tuple(evaluation.measurement_times for evaluation in near)
        return replace(state, neighbours=names, draws=min(self.draws, 2 * state.draws))

    def done(self, state: ExchangeState) -> bool:
        """Whether the search has ended: no neighbour is better on all draws."""
        return bool(state.evaluations)

    def finalists(self, state: ExchangeState) -> tuple[Evaluation, ...]:
        """The best set and the neighbours that may be as good."""
        return state.evaluations

    @cached_property
    def _start(self) -> Times:
        return self.feasible.regular() if self.start is None else self.start

    @property
    def _fewest(self) -> int:
        return min(self.fewest, self.draws)

    def _around(self, times: Times) -> ExchangeState:
        neighbours = self.feasible.exchanges(times, self.reach) + shifts(self.feasible, times)
        return ExchangeState(times, tuple(dict.fromkeys(neighbours)), self._fewest)


@lru_cache(maxsize=64)
def _number_of_exchanges(feasible: Feasible, times: Times, reach: int | None) -> int:
    """The number of exchanges; with 1,000 of 10,000 times it takes seconds, and is often asked."""
    return len(feasible.exchanges(times, reach))
