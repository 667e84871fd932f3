"""The cross-entropy method: it learns a probability for each time from the best random sets.

A random set chooses each time independently with its probability; infeasible sets are rejected.
With N measurements this is the conditional Bernoulli distribution. The best sets of a generation
are the elite. The probabilities move towards the shares of the elite that contain each time, until
all are near 0 or 1.

References
----------
Rubinstein, Kroese, "The cross-entropy method", 2004, section 2.5 (elite, smoothing). Chen,
Dempster, Liu, "Weighted finite population sampling to maximize entropy", Biometrika 81, 1994 (the
conditional Bernoulli distribution).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times
from pfdist.filters.estimate import Evaluation
from pfdist.problem.feasible import Feasible
from pfdist.problem.methods import method
from pfdist.problem.search_section import Count, Fraction
from pfdist.search.base import Candidate, best_of

_CERTAIN = 0.02  # largest distance from 0 or 1 at which a probability counts as decided
_TRIES = 20  # random sets in a round, for each set that is wanted
_ROUNDS = 10


@dataclass(frozen=True)
class CrossEntropyState:
    """Probabilities learnt so far, and the best sets."""

    probabilities: tuple[float, ...] = ()  # (T+1,); empty before the first generation
    generation: int = 0
    best: tuple[Evaluation, ...] = ()  # of all sets so far


@method("cross_entropy")
@dataclass(frozen=True)
class CrossEntropy:
    """Cross-entropy method: learns how probable each time is in a good set.

    Parameters
    ----------
    feasible : Feasible
    population : int
        Number of sets in a generation.
    generations : int
        Largest number of generations.
    elite : float
        Share of the sets from which the probabilities are learnt.
    smoothing : float
        Weight of the elite when the probabilities are updated.
    """

    feasible: Feasible
    population: Count = 100
    generations: Count = 50
    elite: Fraction = 0.1
    smoothing: Fraction = 0.4

    @property
    def evaluations(self) -> int:
        """Largest number of evaluations."""
        return self.population * self.generations

    def init(self) -> CrossEntropyState:
        """The state before the first generation."""
        return CrossEntropyState()

    def ask(self, state: CrossEntropyState, rng: np.random.Generator) -> list[Candidate]:
        """Sets drawn with the probabilities; at first, uniformly random sets."""
        if not state.probabilities:
            return [Candidate(times) for times in self.feasible.random(self.population, rng)]
        probabilities = np.array(state.probabilities)
        sets = conditional_bernoulli(self.feasible, probabilities, self.population, rng)
        return [Candidate(times) for times in sets]

    def tell(
        self, state: CrossEntropyState, evaluations: Sequence[Evaluation]
    ) -> CrossEntropyState:
        """Move the probabilities towards the shares in the elite."""
        order = sorted(evaluations, key=lambda evaluation: evaluation.cost)
        elite = order[: max(1, math.ceil(self.elite * len(order)))]
        before = state.probabilities or self._shares(order)
        after = (1 - self.smoothing) * np.array(before) + self.smoothing * self._shares(elite)
        best = best_of([*state.best, *evaluations])
        return CrossEntropyState(tuple(after.tolist()), state.generation + 1, best)

    def done(self, state: CrossEntropyState) -> bool:
        """Whether all probabilities are near 0 or 1, or all generations were evaluated."""
        undecided = [p for p in state.probabilities if _CERTAIN < p < 1 - _CERTAIN]
        return state.generation >= self.generations or (state.generation > 0 and not undecided)

    def finalists(self, state: CrossEntropyState) -> tuple[Evaluation, ...]:
        """The best of all sets that were evaluated."""
        return state.best

    def _shares(self, evaluations: Sequence[Evaluation]) -> NDArray[np.float64]:
        """Share of the sets that contain each time, (T+1,)."""
        sets = (evaluation.measurement_times for evaluation in evaluations)
        counts = np.bincount([*chain.from_iterable(sets)], minlength=self.feasible.possible)
        return counts / len(evaluations)


def conditional_bernoulli(
    feasible: Feasible, probabilities: NDArray[np.float64], sets: int, rng: np.random.Generator
) -> list[Times]:
    """Random feasible sets in which each time is chosen independently, with its probability.

    The probabilities have the shape (T+1,). If too many sets are rejected, the missing sets are
    built by adding one time after another. Each added time is drawn with the probabilities of the
    times that may be added. If smaller sets are feasible, a set is left as it is with the
    probability that none of these times is chosen.
    """
    drawn: list[Times] = []
    for _ in range(_ROUNDS):
        chosen = rng.random((_TRIES * sets, probabilities.size)) < probabilities
        tried = (tuple(np.flatnonzero(row).tolist()) for row in chosen)
        drawn += [times for times in tried if feasible.accepts(times)]
        if len(drawn) >= sets:
            return drawn[:sets]
    return drawn + [_built_up(feasible, probabilities, rng) for _ in range(sets - len(drawn))]


def _built_up(
    feasible: Feasible, probabilities: NDArray[np.float64], rng: np.random.Generator
) -> Times:
    times: Times = ()
    while larger := feasible.additions(times):
        new = [next(iter({*longer} - {*times})) for longer in larger]
        if feasible.accepts(times) and rng.random() < np.prod(1.0 - probabilities[new]):
            break
        weights = probabilities[new] + np.finfo(float).tiny
        times = larger[rng.choice(len(larger), p=weights / weights.sum())]
    return times
