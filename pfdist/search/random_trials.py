"""Random trials, the search the paper compares its own with (section 3)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pfdist.evaluation.estimate import SearchEvaluation
from pfdist.search.base import Candidate
from pfdist.search.methods import method
from pfdist.search.section import Count, EvaluationSettings
from pfdist.times.feasible import Feasible

_BATCH = 250  # asked for at once: enough to fill the cores, few enough to keep memory flat


@dataclass(frozen=True)
class RandomState:
    """How far the search is.

    Parameters
    ----------
    evaluated : int
        How many sets.
    best : SearchEvaluation, optional
        Of them.
    """

    evaluated: int = 0
    best: SearchEvaluation | None = None


@method("random", evaluation=EvaluationSettings(), curve="trials")
@dataclass(frozen=True)
class RandomTrials:
    """Evaluate random sets of measurement times and keep the best.

    Parameters
    ----------
    feasible : Feasible
    evaluations : int
        How many sets are tried.
    """

    feasible: Feasible
    evaluations: Count = 1250

    @property
    def generations(self) -> int:
        """How often it will ask."""
        return -(-self.evaluations // _BATCH)

    def init(self) -> RandomState:
        """Give the state before the first asking."""
        return RandomState()

    def ask(self, state: RandomState, rng: np.random.Generator) -> list[Candidate]:
        """Give the next sets of measurement times."""
        sets = min(_BATCH, self.evaluations - state.evaluated)
        return [Candidate(times) for times in self.feasible.random(sets, rng)]

    def tell(self, state: RandomState, evaluations: Sequence[SearchEvaluation]) -> RandomState:
        """Count the evaluations and keep the best."""
        known = [] if state.best is None else [state.best]
        best = min([*known, *evaluations], key=lambda evaluation: evaluation.cost)
        return RandomState(state.evaluated + len(evaluations), best)

    def done(self, state: RandomState) -> bool:
        """Whether all trials were made."""
        return state.evaluated >= self.evaluations

    def finalists(self, state: RandomState) -> list[SearchEvaluation]:
        """Give the best of all trials."""
        return [] if state.best is None else [state.best]
