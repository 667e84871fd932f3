"""The cross-entropy method: a probability of each time, learnt from the best of random sets.

Sets are drawn as independent choices of the times, of which those are kept that are allowed: with
N measurements this is the conditional Bernoulli distribution. The probabilities move towards the
shares that the times have in the elite, until they say which set it is.

References
----------
Rubinstein, Kroese, "The cross-entropy method", 2004, section 2.5 (elite, smoothing). Chen,
Dempster, Liu, "Weighted finite population sampling to maximize entropy", Biometrika 81, 1994 (the
conditional Bernoulli distribution).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pfdist.evaluation import SearchEvaluation
from pfdist.feasible import Feasible
from pfdist.measurement_times import Times
from pfdist.search.base import Candidate, best_of

_CERTAIN = 0.02  # a probability so near to 0 or 1 says what it is
_TRIES = 20  # independent choices for each set that is wanted, in rounds
_ROUNDS = 10


@dataclass(frozen=True)
class CrossEntropyState:
    """What was learnt.

    Parameters
    ----------
    probabilities : tuple of float, (T+1,)
        Empty before the first sets are evaluated.
    generation : int
    best : tuple of SearchEvaluation
        Of all sets tried.
    """

    probabilities: tuple[float, ...] = ()
    generation: int = 0
    best: tuple[SearchEvaluation, ...] = ()


@dataclass(frozen=True)
class CrossEntropy:
    """Cross-entropy method on sets of measurement times.

    Parameters
    ----------
    feasible : Feasible
    population : int
        Sets a generation.
    generations : int
        At most.
    elite : float
        Share of the sets that is learnt from.
    smoothing : float
        How far the probabilities move towards the elite's.
    """

    feasible: Feasible
    population: int
    generations: int
    elite: float
    smoothing: float

    @property
    def evaluations(self) -> int:
        """How many sets it will ask for at most."""
        return self.population * self.generations

    def init(self) -> CrossEntropyState:
        """Give the state before the first asking."""
        return CrossEntropyState()

    def ask(self, state: CrossEntropyState, rng: np.random.Generator) -> list[Candidate]:
        """Give sets drawn with the probabilities; at first, random ones."""
        if not state.probabilities:
            return [Candidate(times) for times in self.feasible.random(self.population, rng)]
        probabilities = np.array(state.probabilities)
        sets = conditional_bernoulli(self.feasible, probabilities, self.population, rng)
        return [Candidate(times) for times in sets]

    def tell(
        self, state: CrossEntropyState, evaluations: Sequence[SearchEvaluation]
    ) -> CrossEntropyState:
        """Learn from the elite."""
        order = sorted(evaluations, key=lambda evaluation: evaluation.cost)
        elite = order[: max(1, math.ceil(self.elite * len(order)))]
        before = state.probabilities or self._shares(order)
        after = (1 - self.smoothing) * np.array(before) + self.smoothing * self._shares(elite)
        best = best_of([*state.best, *evaluations])
        return CrossEntropyState(tuple(after.tolist()), state.generation + 1, best)

    def done(self, state: CrossEntropyState) -> bool:
        """Whether all probabilities are near to 0 or 1, or all generations were evaluated."""
        open_ = [p for p in state.probabilities if _CERTAIN < p < 1 - _CERTAIN]
        return state.generation >= self.generations or (state.generation > 0 and not open_)

    def finalists(self, state: CrossEntropyState) -> tuple[SearchEvaluation, ...]:
        """Give the best of all sets tried."""
        return state.best

    def _shares(self, evaluations: Sequence[SearchEvaluation]) -> NDArray[np.float64]:
        """In which share of the sets each time is."""
        held = [time for one in evaluations for time in one.measurement_times]
        return np.bincount(held, minlength=self.feasible.horizon + 1) / len(evaluations)


def conditional_bernoulli(
    feasible: Feasible, probabilities: NDArray[np.float64], sets: int, rng: np.random.Generator
) -> list[Times]:
    """Choose each time on its own, with its probability, and keep what is allowed.

    Where so little is allowed that too few sets come of it, the others are made one time after
    another, each with its probability among those that may be added.

    Parameters
    ----------
    feasible : Feasible
    probabilities : array of float64, (T+1,)
    sets : int
    rng : numpy.random.Generator
    """
    found: list[Times] = []
    for _ in range(_ROUNDS):
        chosen = rng.random((_TRIES * sets, probabilities.size)) < probabilities
        tried = (tuple(np.flatnonzero(row).tolist()) for row in chosen)
        found += [times for times in tried if feasible.accepts(times)]
        if len(found) >= sets:
            return found[:sets]
    return found + [_one_by_one(feasible, probabilities, rng) for _ in range(sets - len(found))]


def _one_by_one(
    feasible: Feasible, probabilities: NDArray[np.float64], rng: np.random.Generator
) -> Times:
    times: Times = ()
    while larger := feasible.additions(times):
        new = [next(iter({*longer} - {*times})) for longer in larger]
        weights = probabilities[new] + np.finfo(float).tiny
        times = larger[rng.choice(len(larger), p=weights / weights.sum())]
    return times
