"""Random trials: the search with which the paper compares its genetic algorithm (section 3)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pfdist.filters.estimate import Evaluation
from pfdist.problem.feasible import Feasible
from pfdist.problem.methods import method
from pfdist.problem.search_section import Count, EvaluationSettings
from pfdist.search.base import Candidate

_BATCH = 250  # sets in a generation: enough to keep the cores busy, and memory stays flat


@dataclass(frozen=True)
class RandomState:
    """Progress of the search."""

    evaluated: int = 0  # number of evaluated sets
    best: tuple[Evaluation, ...] = ()  # of these sets


@method("random", evaluation=EvaluationSettings(), curve="trials")
@dataclass(frozen=True)
class RandomTrials:
    """Random trials: evaluates random sets and keeps the best; the paper's comparison.

    Parameters
    ----------
    feasible : Feasible
    evaluations : int
        Number of sets that are evaluated.
    """

    feasible: Feasible
    evaluations: Count = 1250

    @property
    def generations(self) -> int:
        """Number of generations."""
        return -(-self.evaluations // _BATCH)

    def init(self) -> RandomState:
        """The state before the first generation."""
        return RandomState()

    def ask(self, state: RandomState, rng: np.random.Generator) -> list[Candidate]:
        """Random feasible sets."""
        sets = min(_BATCH, self.evaluations - state.evaluated)
        return [Candidate(times) for times in self.feasible.random(sets, rng)]

    def tell(self, state: RandomState, evaluations: Sequence[Evaluation]) -> RandomState:
        """Count the evaluations and keep the best set."""
        best = min([*state.best, *evaluations], key=lambda evaluation: evaluation.expected_mse)
        return RandomState(state.evaluated + len(evaluations), (best,))

    def done(self, state: RandomState) -> bool:
        """Whether all sets were evaluated."""
        return state.evaluated >= self.evaluations

    def finalists(self, state: RandomState) -> tuple[Evaluation, ...]:
        """The best of all sets."""
        return state.best
