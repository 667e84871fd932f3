"""The contract of a search: candidates go out, evaluations come back."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import ManySets, Times
from pfdist.filters.estimate import Evaluation


@dataclass(frozen=True, eq=False)
class Counted:
    """Sets of times, with the first and last instant at which the errors of each set count."""

    sets: Sequence[Times]  # S sets
    first: NDArray[np.int64]  # (S,)
    ends: NDArray[np.int64]  # (S,)

    @property
    def starts(self) -> NDArray[np.int64]:
        """The index of each set's first error in an array of all E errors that count, (S,)."""
        return np.cumsum(self._sizes) - self._sizes

    @property
    def set_of(self) -> NDArray[np.int64]:
        """The number of the set of each error, (E,)."""
        return np.repeat(np.arange(len(self.sets)), self._sizes)

    def of_instants(self, errors: NDArray[np.float64]) -> NDArray[np.float64]:
        """The errors that count, (E,), of those of each set at all instants, (S, T+1)."""
        t = np.arange(errors.shape[1])
        counted: NDArray[np.float64] = errors[
            (self.first[:, None] <= t) & (t <= self.ends[:, None])
        ]
        return counted

    def once(self) -> tuple["Counted", NDArray[np.int64]]:
        """Each different set once, and the index, (E,), of each error among theirs."""
        words = map(bytes, self.sets.bits) if isinstance(self.sets, ManySets) else self.sets
        place_of, places = dict[Any, int](), list[int]()
        for key in zip(words, self.first.tolist(), self.ends.tolist(), strict=True):
            places.append(place_of.setdefault(key, len(place_of)))
        own = np.unique(places, return_index=True)[1]
        sets = self.sets[own] if isinstance(self.sets, ManySets) else [self.sets[k] for k in own]
        different = Counted(sets, self.first[own], self.ends[own])
        moved = different.starts[places] - self.starts
        return different, np.repeat(moved, self._sizes) + np.arange(self._sizes.sum())

    def __add__(self, other: "Counted") -> "Counted":
        """These sets, followed by others."""
        first, ends = np.append(self.first, other.first), np.append(self.ends, other.ends)
        return Counted(self.sets + other.sets, first, ends)  # type: ignore[operator]

    @property
    def _sizes(self) -> NDArray[np.int64]:
        return self.ends - self.first + 1


class Candidate(NamedTuple):
    """A set, or a prefix of sets, whose expected MSE a search needs, or many filters.

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
    counted : Counted, optional
        If given, the result has the expected errors of these sets at the instants that count, and
        the candidate has no times of its own. It comes first.
    """

    measurement_times: Times
    end: int | None = None
    draws: int | None = None
    individual: int | None = None
    counted: Counted | None = None


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
