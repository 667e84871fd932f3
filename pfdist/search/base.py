"""The contract of a search."""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np

from pfdist.evaluation import Evaluation, SearchEvaluation
from pfdist.measurement_times import Times


class Candidate(NamedTuple):
    """What a search wants to know the cost of.

    Parameters
    ----------
    measurement_times : tuple of int
        Sorted.
    end : int, optional
        Last instant whose errors count, if it is not T.
    draws : int, optional
        On so many of the first draws, if not on as many as an evaluation has.
    individual : int, optional
        Its index in the population, where copies of a set are to be evaluated on fresh draws each.
        Copies without an index share one evaluation, and under common noise all copies do.
    squared : bool
        Whether by the squared error of the job's own filter, however the search estimates.
    """

    measurement_times: Times
    end: int | None = None
    draws: int | None = None
    individual: int | None = None
    squared: bool = False


FINALISTS = 8
"""At most so many sets of a search are tried on fresh draws."""

E = TypeVar("E", bound=Evaluation)


def best_of(evaluations: Iterable[E]) -> tuple[E, ...]:
    """Give the best different sets, the best first, as many as are tried on fresh draws."""
    each = {evaluation.measurement_times: evaluation for evaluation in evaluations}
    return tuple(sorted(each.values(), key=lambda evaluation: evaluation.cost)[:FINALISTS])


class Optimiser(Protocol[E]):
    """A search as a pure function: it asks for evaluations and is told their outcome.

    An optimiser is frozen; whatever changes is in the state, which the caller keeps. The same
    states, evaluations and generators give the same search.
    """

    @property
    def generations(self) -> int:
        """About how often it will ask."""

    @property
    def evaluations(self) -> float:
        """About how many whole evaluations its work amounts to."""

    def init(self) -> Any:
        """Give the state before the first asking."""

    def ask(self, state: Any, rng: np.random.Generator) -> Sequence[Candidate]:
        """Give what is to be evaluated."""

    def tell(self, state: Any, evaluations: Sequence[E]) -> Any:
        """Give the state after what was last asked for is evaluated, in its order."""

    def done(self, state: Any) -> bool:
        """Whether the search has ended."""

    def finalists(self, state: Any) -> Sequence[E]:
        """Give what the search has found, the best first: fresh draws decide between them."""


SearchOptimiser = Optimiser[SearchEvaluation]
