"""Greedy searches: forward, the time that helps most is added; backward, the least is missed.

Forward begins with no measurement, backward with all times; each step tries every time. Where a
time is worth the less the more others there are (the cost is supermodular), what forward finds has
at least 1 - 1/e of the largest possible saving. The filter's cost is not of that kind in general.
Where times have prices, a step is weighed by its price.

References
----------
Nemhauser, Wolsey, Fisher, "An analysis of approximations for maximizing submodular set functions
I", Mathematical Programming 14, 1978 (forward). Marill, Green, "On the effectiveness of receptors
in recognition systems", IEEE Transactions on Information Theory 9, 1963 (backward).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pfdist.evaluation import SearchEvaluation
from pfdist.feasible import Feasible
from pfdist.measurement_times import Times
from pfdist.search.base import Candidate, best_of


@dataclass(frozen=True)
class GreedyState:
    """What was chosen so far.

    Parameters
    ----------
    chosen : tuple of int
    evaluations : tuple of SearchEvaluation
        The best of the last step's sets that may be chosen.
    """

    chosen: Times
    evaluations: tuple[SearchEvaluation, ...] = ()


@dataclass(frozen=True)
class _Greedy:
    feasible: Feasible

    def ask(self, state: GreedyState, rng: np.random.Generator) -> list[Candidate]:
        """Give all sets that one step makes of what was chosen, and that, if times have prices."""
        before = [] if self.feasible.counted else [state.chosen]
        steps = self._steps(state.chosen) or [state.chosen]  # all times may be measured at
        return [Candidate(times) for times in (*steps, *before)]

    def tell(self, state: GreedyState, evaluations: Sequence[SearchEvaluation]) -> GreedyState:
        """Choose the step that saves most or loses least, for its price."""
        steps, before = list(evaluations), 0.0
        if not self.feasible.counted:
            before = steps.pop().cost

        def worth(evaluation: SearchEvaluation) -> float:
            price = self.feasible.spent({*state.chosen} ^ {*evaluation.measurement_times})
            return (evaluation.cost - before) / max(1, price)

        best = min(steps, key=worth)
        allowed = [
            evaluation
            for evaluation in steps
            if self.feasible.accepts(evaluation.measurement_times)
        ]
        return GreedyState(best.measurement_times, best_of(allowed))

    def finalists(self, state: GreedyState) -> tuple[SearchEvaluation, ...]:
        """Give the best of the last step."""
        return state.evaluations

    def _steps(self, times: Times) -> list[Times]:
        raise NotImplementedError


@dataclass(frozen=True)
class GreedyForward(_Greedy):
    """Add the time that helps most, from none on, until no more may be added.

    Parameters
    ----------
    feasible : Feasible
    """

    @property
    def generations(self) -> int:
        """About how often it will ask."""
        return self.feasible.measurements

    @property
    def evaluations(self) -> int:
        """About how many sets of times it will ask for."""
        return sum(len(self.feasible.allowed) - chosen for chosen in range(self.generations))

    def init(self) -> GreedyState:
        """Give the state before the first asking: no measurement."""
        return GreedyState(())

    def done(self, state: GreedyState) -> bool:
        """Whether no time may be added."""
        return not self._steps(state.chosen)

    def _steps(self, times: Times) -> list[Times]:
        return self.feasible.additions(times)


@dataclass(frozen=True)
class GreedyBackward(_Greedy):
    """Remove the time that is missed least, from all times on, until what is left is allowed.

    Parameters
    ----------
    feasible : Feasible
    """

    @property
    def generations(self) -> int:
        """About how often it will ask."""
        return max(1, self.feasible.horizon + 1 - self.feasible.measurements)

    @property
    def evaluations(self) -> int:
        """About how many sets of times it will ask for."""
        return sum(self.feasible.horizon + 1 - removed for removed in range(self.generations))

    def init(self) -> GreedyState:
        """Give the state before the first asking: all times."""
        return GreedyState(tuple(range(self.feasible.horizon + 1)))

    def done(self, state: GreedyState) -> bool:
        """Whether what is left is allowed, and was evaluated."""
        return bool(state.evaluations) and self.feasible.accepts(state.chosen)

    def _steps(self, times: Times) -> list[Times]:
        return self.feasible.removals(times)
