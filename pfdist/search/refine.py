"""From coarse to fine: the best of evenly spaced sets where no relaxation ranks them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pfdist.common.measurement_times import Times
from pfdist.filters.estimate import Evaluation
from pfdist.problem.even_sets import EvenLine, EvenSets
from pfdist.search.base import Candidate

_LEVELS = 3
_SHARE = 20  # new sets near another, about


@dataclass(frozen=True)
class RefineState:
    """Progress of the search."""

    lines: dict[Times, EvenLine]  # of the sets to be evaluated next
    known: tuple[tuple[Evaluation, EvenLine], ...] = ()  # the best first
    level: int = 0


@dataclass(frozen=True)
class Refine:
    """An optimiser that evaluates sets of spread lines, then those near the best, and so on."""

    even: EvenSets
    spread: int  # number of the first sets, about

    @property
    def generations(self) -> int:
        """Largest number of generations."""
        return 1 + _LEVELS

    @property
    def evaluations(self) -> float:
        """Approximate number of evaluated sets."""
        return self.spread * (1.0 + _LEVELS / 2)

    def init(self) -> RefineState:
        """The state before the first generation."""
        return RefineState(self.even.sets_of(self.even.lines(self.spread)))

    def ask(self, state: RefineState, rng: np.random.Generator) -> list[Candidate]:
        """The sets of the next level."""
        return [Candidate(times) for times in state.lines]

    def tell(self, state: RefineState, evaluations: Sequence[Evaluation]) -> RefineState:
        """The sets of lines near the best."""
        new = zip(evaluations, state.lines.values(), strict=True)
        known = sorted([*state.known, *new], key=lambda pair: pair[0].expected_mse)
        best = [line for _, line in known[: max(1, self.spread // 2 // _SHARE)]]
        lines = self.even.sets_of([near for line in best for near in self.even.near(line)])
        for evaluation, _ in known:
            lines.pop(evaluation.measurement_times, None)
        return RefineState(lines, tuple(known), state.level + 1)

    def done(self, state: RefineState) -> bool:
        """Whether no line is left, or the last level was evaluated."""
        return not state.lines or state.level > _LEVELS

    def finalists(self, state: RefineState) -> tuple[Evaluation, ...]:
        """All evaluated sets, the best first."""
        return tuple(evaluation for evaluation, _ in state.known)
