"""The contract of a search: candidates go out, evaluations come back."""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np

from pfdist.common.measurement_times import Times
from pfdist.filters.estimate import Evaluation


class Candidate(NamedTuple):
    """A set, or a prefix of sets, whose expected MSE a search needs.

    Parameters
    ----------
    measurement_times : tuple of int
        Sorted.
    end : int, optional
        Last instant whose errors count. By default T.
    draws : int, optional
        Number of draws, the first of the stream. By default, the number in the search's settings.
    individual : int, optional
        Index in the population, with which each copy of a set has fresh draws. Copies without an
        index share one evaluation; under common noise all copies do.
    since : int, optional
        If given, the result is the expected error of each instant from this one on, instead of the
        mean of each draw.
    """

    measurement_times: Times
    end: int | None = None
    draws: int | None = None
    individual: int | None = None
    since: int | None = None


FINALISTS = 8
"""Largest number of sets of a search that race on fresh draws."""


def best_of(evaluations: Iterable[Evaluation]) -> tuple[Evaluation, ...]:
    """The best evaluations of different sets, best first, at most `FINALISTS`."""
    different = {evaluation.measurement_times: evaluation for evaluation in evaluations}
    return tuple(
        sorted(different.values(), key=lambda evaluation: evaluation.expected_mse)[:FINALISTS]
    )


class Optimiser(Protocol):
    """A search as pure functions: it asks for evaluations, and receives their results.

    An optimiser is frozen. Everything that changes is in the state, which the caller keeps. The
    same states, evaluations and generators give the same search.
    """

    @property
    def generations(self) -> int:
        """Approximate number of generations, that is, of calls of `ask`."""

    @property
    def evaluations(self) -> float:
        """Approximate work, in evaluations of whole sets."""

    def init(self) -> Any:
        """The state before the first generation."""

    def ask(self, state: Any, rng: np.random.Generator) -> Sequence[Candidate]:
        """The candidates of the next generation."""

    def tell(self, state: Any, evaluations: Sequence[Evaluation]) -> Any:
        """The next state, from the evaluations of the last candidates in their order."""

    def done(self, state: Any) -> bool:
        """Whether the search has ended."""

    def finalists(self, state: Any) -> Sequence[Evaluation]:
        """The best sets so far, best first; fresh draws decide between them."""
