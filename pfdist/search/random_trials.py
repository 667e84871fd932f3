"""Random trials, the search the paper compares its own with (section 3)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pfdist.measurement_times import random
from pfdist.monte_carlo import Evaluation

_BATCH = 250  # asked for at once: enough to fill the cores, few enough to keep memory flat


@dataclass(frozen=True)
class RandomState:
    """What random trials know so far: how many were evaluated, and the best of them."""

    evaluated: int = 0
    best: Evaluation | None = None


@dataclass(frozen=True)
class RandomTrials:
    """Evaluate random sets of measurement times and keep the best.

    Parameters
    ----------
    horizon : int
    measurement_budget : int
    evaluations : int
        How many sets are tried.
    """

    horizon: int
    measurement_budget: int
    evaluations: int

    @property
    def generations(self) -> int:
        """How often it will ask."""
        return -(-self.evaluations // _BATCH)

    def init(self) -> RandomState:
        """Give the state before the first asking."""
        return RandomState()

    def ask(self, state: RandomState, rng: np.random.Generator) -> NDArray[np.int64]:
        """Give the next sets of measurement times."""
        sets = min(_BATCH, self.evaluations - state.evaluated)
        return random(self.horizon, self.measurement_budget, sets, rng)

    def tell(self, state: RandomState, evaluations: Sequence[Evaluation]) -> RandomState:
        """Count the evaluations and keep the best."""
        known = [] if state.best is None else [state.best]
        best = min([*known, *evaluations], key=lambda evaluation: evaluation.cost)
        return RandomState(state.evaluated + len(evaluations), best)

    def done(self, state: RandomState) -> bool:
        """Whether all trials were made."""
        return state.evaluated >= self.evaluations

    def best(self, state: RandomState) -> Evaluation:
        """Give the best of all trials."""
        if state.best is None:
            raise ValueError("nothing was evaluated yet")
        return state.best
