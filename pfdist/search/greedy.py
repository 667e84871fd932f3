"""Greedy searches: forward adds the best measurement, backward removes the worst, at each step.

Forward starts without measurements, backward with all times. Each step tries every time. If the
cost is supermodular (each measurement is worth less, the more others there are), forward reaches at
least 1 - 1/e of the largest possible saving. The cost of a particle filter is not supermodular in
general. If measurements have prices, the change of the cost is divided by the price.

References
----------
Nemhauser, Wolsey, Fisher, "An analysis of approximations for maximizing submodular set functions
I", Mathematical Programming 14, 1978 (forward). Marill, Green, "On the effectiveness of receptors
in recognition systems", IEEE Transactions on Information Theory 9, 1963 (backward).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pfdist.common.measurement_times import Times
from pfdist.filters.estimate import Evaluation
from pfdist.problem.feasible import Feasible
from pfdist.problem.methods import method
from pfdist.search.base import Candidate, best_of


@dataclass(frozen=True)
class GreedyState:
    """The set chosen so far."""

    chosen: Times
    # The best feasible sets of the last step; of all steps if smaller sets are feasible.
    evaluations: tuple[Evaluation, ...] = ()


@dataclass(frozen=True)
class _Greedy:
    feasible: Feasible

    def ask(self, state: GreedyState, rng: np.random.Generator) -> list[Candidate]:
        """All sets one step away from the chosen set; with prices also the chosen set."""
        before = [] if self.feasible.counted else [state.chosen]
        steps = self._steps(state.chosen) or [state.chosen]  # a set of all times has no next step
        return [Candidate(times) for times in (*steps, *before)]

    def tell(self, state: GreedyState, evaluations: Sequence[Evaluation]) -> GreedyState:
        """Choose the step that lowers the cost most, or raises it least, for its price."""
        steps, before = list(evaluations), 0.0
        if not self.feasible.counted:
            before = steps.pop().cost

        def worth(evaluation: Evaluation) -> float:
            price = self.feasible.spent({*state.chosen} ^ {*evaluation.measurement_times})
            return (evaluation.cost - before) / max(1, price)

        best = min(steps, key=worth)
        allowed = [
            evaluation
            for evaluation in evaluations
            if self.feasible.accepts(evaluation.measurement_times)
        ]
        former = state.evaluations if self.feasible.smaller else ()  # a step may do harm
        return GreedyState(best.measurement_times, best_of([*former, *allowed]))

    def done(self, state: GreedyState) -> bool:
        """Whether a feasible set was evaluated, and there is no next step."""
        return bool(state.evaluations) and not self._steps(state.chosen)

    def finalists(self, state: GreedyState) -> tuple[Evaluation, ...]:
        """The best feasible sets of the last step; of all steps if smaller sets count."""
        return state.evaluations

    def _steps(self, times: Times) -> list[Times]:
        raise NotImplementedError


@method("greedy_forward", curve="best of a step")
@dataclass(frozen=True)
class GreedyForward(_Greedy):
    """Greedy forward search: adds the measurement that helps most, one at each step.

    Parameters
    ----------
    feasible : Feasible
    """

    @property
    def generations(self) -> int:
        """Approximate number of generations."""
        return self.feasible.measurements

    @property
    def evaluations(self) -> int:
        """Approximate number of evaluations."""
        return sum(len(self.feasible.allowed) - chosen for chosen in range(self.generations))

    def init(self) -> GreedyState:
        """The state before the first generation: no measurement."""
        return GreedyState(())

    def _steps(self, times: Times) -> list[Times]:
        return self.feasible.additions(times)


@method("greedy_backward", curve="best of a step")
@dataclass(frozen=True)
class GreedyBackward(_Greedy):
    """Greedy backward search: starts from all times, removes the measurement that matters least.

    Parameters
    ----------
    feasible : Feasible
    """

    @property
    def generations(self) -> int:
        """Approximate number of generations."""
        return max(1, self.feasible.possible - self.feasible.measurements)

    @property
    def evaluations(self) -> int:
        """Approximate number of evaluations."""
        return sum(self.feasible.possible - removed for removed in range(self.generations))

    def init(self) -> GreedyState:
        """The state before the first generation: all times."""
        return GreedyState(tuple(range(self.feasible.possible)))

    def _steps(self, times: Times) -> list[Times]:
        return self.feasible.removals(times)
