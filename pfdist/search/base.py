"""The contract of a search."""

from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pfdist.monte_carlo import Evaluation


class Optimiser(Protocol):
    """A search as a pure function: it asks for evaluations and is told their outcome.

    An optimiser is frozen; whatever changes is in the state, which the caller keeps. The same
    states, evaluations and generators give the same search.
    """

    @property
    def generations(self) -> int:
        """How often it will ask."""

    @property
    def evaluations(self) -> int:
        """How many sets of times it will ask for, copies counted."""

    def init(self) -> Any:
        """Give the state before the first asking."""

    def ask(self, state: Any, rng: np.random.Generator) -> NDArray[np.int64]:
        """Give the sets of measurement times to evaluate, (P, N), each row sorted."""

    def tell(self, state: Any, evaluations: Sequence[Evaluation]) -> Any:
        """Give the state after the P sets last asked for were evaluated, in their order."""

    def done(self, state: Any) -> bool:
        """Whether the search has ended."""

    def best(self, state: Any) -> Evaluation:
        """Give the evaluation of the set that the search returns."""
