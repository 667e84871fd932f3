"""Simulated annealing: a worse set is accepted with a probability that falls with the temperature.

Several chains run side by side, so that several workers have work. A neighbour of a set has one
time exchanged for any other time. Each step evaluates the present set again beside a neighbour.
Under common noise this evaluation is known and costs nothing. Under fresh noise it is needed,
because otherwise one lucky estimate would hold the chain for ever.

References
----------
Kirkpatrick, Gelatt, Vecchi, "Optimization by simulated annealing", Science 220, 1983 (geometric
cooling). Metropolis et al., "Equation of state calculations by fast computing machines", Journal of
Chemical Physics 21, 1953. White, "Concepts of scale in simulated annealing", ICCD 1984 (the first
temperature comes from the spread of the costs).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pfdist.common.measurement_times import Times
from pfdist.filters.estimate import Evaluation
from pfdist.problem.feasible import Feasible
from pfdist.problem.methods import method
from pfdist.problem.search_section import Count, Fraction
from pfdist.search.base import Candidate, best_of

_TRIES = 20  # random neighbours that are tried before all neighbours are listed
_SETS = 4  # random sets for each chain at first; their spread gives the first temperature


@dataclass(frozen=True)
class AnnealingState:
    """State of all chains."""

    temperature: float = math.inf
    step: int = 0
    # For each chain: the present set, and the neighbour that may replace it.
    chains: tuple[tuple[Evaluation, Evaluation], ...] = ()
    best: tuple[Evaluation, ...] = ()  # of all sets so far


@method("annealing")
@dataclass(frozen=True)
class Annealing:
    """Simulated annealing: accepts worse sets, less and less often as the temperature falls.

    Parameters
    ----------
    feasible : Feasible
    chains : int
        Number of chains that run side by side.
    steps : int
        Number of steps of each chain.
    coldest : float
        The last temperature divided by the first.
    """

    feasible: Feasible
    chains: Count = 4
    steps: Count = 500
    coldest: Fraction = 0.03

    @property
    def generations(self) -> int:
        """Number of generations."""
        return 1 + self.steps

    @property
    def evaluations(self) -> int:
        """Number of evaluations, without those of present sets, which are known."""
        return self.chains * (_SETS + self.steps)

    def init(self) -> AnnealingState:
        """The state before the first generation."""
        return AnnealingState()

    def ask(self, state: AnnealingState, rng: np.random.Generator) -> list[Candidate]:
        """The present set of each chain and a neighbour of it; at first, random sets."""
        if not state.chains:
            sets = self.feasible.random(_SETS * self.chains, rng)
            return [Candidate(times) for times in sets]
        candidates: list[Candidate] = []
        for present, neighbour in state.chains:
            moves = accepted(neighbour.cost - present.cost, state.temperature, rng)
            times = (neighbour if moves else present).measurement_times
            candidates += [Candidate(times), Candidate(self._neighbour(times, rng))]
        return candidates

    def tell(self, state: AnnealingState, evaluations: Sequence[Evaluation]) -> AnnealingState:
        """Lower the temperature; at first, start the chains from the best random sets."""
        best = best_of([*state.best, *evaluations])
        if not state.chains:
            order = sorted(evaluations, key=lambda evaluation: evaluation.cost)
            chains = tuple((evaluation, evaluation) for evaluation in order[: self.chains])
            return AnnealingState(first_temperature(evaluations), 0, chains, best)
        chains = tuple(zip(evaluations[::2], evaluations[1::2], strict=True))
        cooler = state.temperature * self.coldest ** (1 / max(1, self.steps - 1))
        return AnnealingState(cooler, state.step + 1, chains, best)

    def done(self, state: AnnealingState) -> bool:
        """Whether the chains have made all steps."""
        return state.step >= self.steps

    def finalists(self, state: AnnealingState) -> tuple[Evaluation, ...]:
        """The best of all sets that were evaluated."""
        return state.best

    def _neighbour(self, times: Times, rng: np.random.Generator) -> Times:
        """A set with one time exchanged; the set itself if it has no neighbour."""
        others = sorted({*self.feasible.allowed} - {*times})
        likely = self.feasible.counted and times and others
        for _ in range(_TRIES if likely else 0):  # faster than to list all neighbours
            swapped = {*times} - {int(rng.choice(times))} | {int(rng.choice(others))}
            if self.feasible.accepts(tuple(sorted(swapped))):
                return tuple(sorted(swapped))
        neighbours = self.feasible.exchanges(times)
        return neighbours[rng.integers(len(neighbours))] if neighbours else times


def first_temperature(evaluations: Sequence[Evaluation]) -> float:
    """About how much an exchange changes the cost: the spread of random sets over root N.

    If the cost were a sum of N independent shares, one for each time, this would be the standard
    deviation of a share.
    """
    alive = [evaluation for evaluation in evaluations if math.isfinite(evaluation.cost)]
    if not alive:
        return 0.0
    times = np.mean([max(1, len(evaluation.measurement_times)) for evaluation in alive])
    return float(np.std([evaluation.cost for evaluation in alive]) / np.sqrt(times))


def accepted(rise: float, temperature: float, rng: np.random.Generator) -> bool:
    """Whether Metropolis' rule accepts a rise of the cost.

    The probability is exp(-rise / temperature). A rise of at most 0 is always accepted. At
    temperature 0, no positive rise is.
    """
    luck = rng.random()
    return not rise > 0 or (temperature > 0 and luck < math.exp(-rise / temperature))
