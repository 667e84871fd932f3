"""Exhaustive search: every set is tried. For small problems, and to test other searches."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from pfdist.errors import JobError
from pfdist.evaluation.estimate import SearchEvaluation
from pfdist.search.base import Candidate, best_of
from pfdist.search.methods import method
from pfdist.search.section import Count
from pfdist.times.feasible import Feasible

_BATCH = 500  # asked for at once: in their order neighbours share much, and memory stays flat


@dataclass(frozen=True)
class ExhaustiveState:
    """How far the search is.

    Parameters
    ----------
    tried : int
        How many sets.
    best : tuple of SearchEvaluation
        Of them, the best first.
    """

    tried: int = 0
    best: tuple[SearchEvaluation, ...] = ()


@method("exhaustive", curve="trials")
@dataclass(frozen=True)
class Exhaustive:
    """Try every set, in the order of words in a dictionary.

    Parameters
    ----------
    feasible : Feasible
    limit : int
        How many sets there may be.

    Raises
    ------
    JobError
        There are more.
    """

    feasible: Feasible
    limit: Count = 100_000

    def __post_init__(self) -> None:
        if self.feasible.size > self.limit:
            raise JobError(
                f"the problem must have at most limit = {self.limit:,} sets of measurement times, "
                f"got {self.feasible.size:,}; any other method tries fewer"
            )

    @property
    def generations(self) -> int:
        """How often it will ask."""
        return -(-self.feasible.size // _BATCH)

    @property
    def evaluations(self) -> int:
        """How many sets there are."""
        return self.feasible.size

    def init(self) -> ExhaustiveState:
        """Give the state before the first asking."""
        return ExhaustiveState()

    def ask(self, state: ExhaustiveState, rng: np.random.Generator) -> list[Candidate]:
        """Give the next sets."""
        following = islice(self.feasible.every(), state.tried, state.tried + _BATCH)
        return [Candidate(times) for times in following]

    def tell(
        self, state: ExhaustiveState, evaluations: Sequence[SearchEvaluation]
    ) -> ExhaustiveState:
        """Keep the best."""
        best = best_of([*state.best, *evaluations])
        return ExhaustiveState(state.tried + len(evaluations), best)

    def done(self, state: ExhaustiveState) -> bool:
        """Whether all were tried."""
        return state.tried >= self.feasible.size

    def finalists(self, state: ExhaustiveState) -> tuple[SearchEvaluation, ...]:
        """Give the best of all."""
        return state.best
