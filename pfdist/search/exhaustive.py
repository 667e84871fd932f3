"""Exhaustive search: evaluates every feasible set, for small problems and tests."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice

import numpy as np

from pfdist.errors import JobError
from pfdist.filters.estimate import Evaluation
from pfdist.problem.feasible import Feasible
from pfdist.problem.methods import method
from pfdist.problem.search_section import Count
from pfdist.search.base import Candidate, best_of

_BATCH = 500  # sets in a generation: neighbours share prefixes, and memory stays flat


@dataclass(frozen=True)
class ExhaustiveState:
    """Progress of the search."""

    tried: int = 0  # number of evaluated sets
    best: tuple[Evaluation, ...] = ()  # of these sets, the best first


@method("exhaustive", curve="trials")
@dataclass(frozen=True)
class Exhaustive:
    """Exhaustive search: evaluates every feasible set, in lexicographic order.

    Parameters
    ----------
    feasible : Feasible
    limit : int
        Largest number of feasible sets that the problem may have.

    Raises
    ------
    JobError
        The problem has more feasible sets.
    """

    feasible: Feasible
    limit: Count = 100_000

    def __post_init__(self) -> None:
        if self.feasible.size > self.limit:
            raise JobError(
                f"the problem must have at most limit = {self.limit:,} sets of measurement times, "
                f"got {self.feasible.size:,}; other methods try fewer"
            )

    @property
    def generations(self) -> int:
        """Number of generations."""
        return -(-self.feasible.size // _BATCH)

    @property
    def evaluations(self) -> int:
        """Number of feasible sets."""
        return self.feasible.size

    def init(self) -> ExhaustiveState:
        """The state before the first generation."""
        return ExhaustiveState()

    def ask(self, state: ExhaustiveState, rng: np.random.Generator) -> list[Candidate]:
        """The next sets in lexicographic order."""
        following = islice(self.feasible.every(), state.tried, state.tried + _BATCH)
        return [Candidate(times) for times in following]

    def tell(self, state: ExhaustiveState, evaluations: Sequence[Evaluation]) -> ExhaustiveState:
        """Keep the best sets."""
        best = best_of([*state.best, *evaluations])
        return ExhaustiveState(state.tried + len(evaluations), best)

    def done(self, state: ExhaustiveState) -> bool:
        """Whether all sets were evaluated."""
        return state.tried >= self.feasible.size

    def finalists(self, state: ExhaustiveState) -> tuple[Evaluation, ...]:
        """The best of all sets."""
        return state.best
