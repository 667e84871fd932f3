"""Exchange: as long as one time can be exchanged for a better one, it is.

Neighbours of the best set so far are tried on few draws first. If a paired test finds the leader
of them better, it takes the place of the best at once; else those found worse than the leader are
dropped, and the others are tried on twice as many draws. What is found is a local optimum as far as
these draws can tell; how good it is, others say.

References
----------
Fedorov, "Theory of optimal experiments", 1972 (exchange). Hong, Nelson, "Discrete optimization via
simulation using COMPASS", Operations Research 54, 2006 (neighbours under simulation noise).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pfdist.evaluation import SearchEvaluation
from pfdist.feasible import Feasible
from pfdist.measurement_times import Times
from pfdist.search.base import Candidate, best_of
from pfdist.search.paired import difference

_FEWEST = 32  # draws that neighbours are tried on first: a standard error is known by them
_WORSE = 1.5  # standard errors, by which a neighbour is found worse than the leader, and dropped
_BETTER = 3.0  # by which it is found better than the best so far
_BETTER_AT_LAST = 1.5  # likewise, on all draws


@dataclass(frozen=True)
class ExchangeState:
    """How far the search is.

    Parameters
    ----------
    best : tuple of int
    neighbours : tuple of tuples of int
        That may be better.
    draws : int
        On so many they are tried next.
    left : tuple of tuples of int
        That were the best before.
    evaluations : tuple of SearchEvaluation
        What was found, the best first.
    """

    best: Times
    neighbours: tuple[Times, ...] = ()
    draws: int = _FEWEST
    left: tuple[Times, ...] = ()
    evaluations: tuple[SearchEvaluation, ...] = ()


@dataclass(frozen=True)
class Exchange:
    """Exchange of one time for another, under paired tests.

    Parameters
    ----------
    feasible : Feasible
    draws : int
        On so many at most.
    start : tuple of int, optional
        By default regular times.
    reach : int, optional
        How far a time is moved at most; by default anywhere.
    moves : int
        At most so many.
    """

    feasible: Feasible
    draws: int
    start: Times | None = None
    reach: int | None = None
    moves: int = 200

    @property
    def generations(self) -> int:
        """About how often it will ask: a few moves, or one for each time that is not near."""
        return 12 if self.reach else 3 * len(self._start)

    @property
    def evaluations(self) -> float:
        """About how many whole evaluations its work amounts to; neighbours share half of it."""
        tried = 1 + len(self.feasible.exchanges(self._start, self.reach))
        return self.generations / 3 * tried * self._fewest / self.draws

    def init(self) -> ExchangeState:
        """Give the state before the first asking."""
        return self._around(self._start)

    def ask(self, state: ExchangeState, rng: np.random.Generator) -> list[Candidate]:
        """Give the best set so far and the neighbours that may be better."""
        return [Candidate(times, draws=state.draws) for times in (state.best, *state.neighbours)]

    def tell(self, state: ExchangeState, evaluations: Sequence[SearchEvaluation]) -> ExchangeState:
        """Move to the best neighbour if it is better; else drop those that are worse."""
        best, *others = evaluations
        order = sorted(others, key=lambda evaluation: evaluation.cost)
        last = state.draws == self.draws
        if order and len(state.left) < self.moves:
            leader = order[0].measurement_times
            # Few draws may err: they never lead back, or it might go round for ever.
            few = math.inf if leader in state.left else _BETTER
            if difference(order[0], best).is_better(_BETTER_AT_LAST if last else few):
                return replace(self._around(leader), left=(*state.left, state.best))
        if last:
            return replace(state, evaluations=best_of(evaluations))
        least = min(evaluations, key=lambda evaluation: evaluation.cost)
        near = [
            evaluation for evaluation in order if not difference(evaluation, least).is_worse(_WORSE)
        ]
        names = tuple(evaluation.measurement_times for evaluation in near)
        return replace(state, neighbours=names, draws=min(self.draws, 2 * state.draws))

    def done(self, state: ExchangeState) -> bool:
        """Whether no neighbour is better."""
        return bool(state.evaluations)

    def finalists(self, state: ExchangeState) -> tuple[SearchEvaluation, ...]:
        """Give the best set and those of its neighbours that may be as good."""
        return state.evaluations

    @cached_property
    def _start(self) -> Times:
        return self.feasible.regular() if self.start is None else self.start

    @property
    def _fewest(self) -> int:
        return min(_FEWEST, self.draws)

    def _around(self, times: Times) -> ExchangeState:
        return ExchangeState(times, tuple(self.feasible.exchanges(times, self.reach)), self._fewest)
