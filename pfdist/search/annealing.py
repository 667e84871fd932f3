"""Simulated annealing: worse sets are accepted with a probability that falls as it grows cold.

Several chains run side by side, so that there is something to do for several workers. A neighbour
of a set has one time exchanged for any other. A chain's present set is asked for beside its
neighbour each time: under common noise it is known and costs nothing, under fresh noise it is to
be estimated anew, or a lucky estimate would hold the chain for ever.

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

from pfdist.evaluation import SearchEvaluation
from pfdist.feasible import Feasible
from pfdist.measurement_times import Times
from pfdist.search.base import Candidate, best_of

_TRIES = 20  # random neighbours, of which one should be allowed
_SETS = 4  # random ones, for each chain: their spread is the first temperature


@dataclass(frozen=True)
class AnnealingState:
    """Where the chains are.

    Parameters
    ----------
    temperature : float
    step : int
    chains : tuple of (SearchEvaluation, SearchEvaluation)
        Each chain's set, and the neighbour that may take its place.
    best : tuple of SearchEvaluation
        Of all sets tried.
    """

    temperature: float = math.inf
    step: int = 0
    chains: tuple[tuple[SearchEvaluation, SearchEvaluation], ...] = ()
    best: tuple[SearchEvaluation, ...] = ()


@dataclass(frozen=True)
class Annealing:
    """Simulated annealing with geometric cooling.

    Parameters
    ----------
    feasible : Feasible
    chains : int
    steps : int
        Of each chain.
    coldest : float
        The last temperature, in units of the first.
    """

    feasible: Feasible
    chains: int
    steps: int
    coldest: float

    @property
    def generations(self) -> int:
        """How often it will ask."""
        return 1 + self.steps

    @property
    def evaluations(self) -> int:
        """How many sets it will ask for, but for the chains' own, which are known."""
        return self.chains * (_SETS + self.steps)

    def init(self) -> AnnealingState:
        """Give the state before the first asking."""
        return AnnealingState()

    def ask(self, state: AnnealingState, rng: np.random.Generator) -> list[Candidate]:
        """Give each chain's set and a neighbour of it; at first, random sets."""
        if not state.chains:
            sets = self.feasible.random(_SETS * self.chains, rng)
            return [Candidate(times) for times in sets]
        asked: list[Candidate] = []
        for present, neighbour in state.chains:
            moves = accepted(neighbour.cost - present.cost, state.temperature, rng)
            times = (neighbour if moves else present).measurement_times
            asked += [Candidate(times), Candidate(self._neighbour(times, rng))]
        return asked

    def tell(
        self, state: AnnealingState, evaluations: Sequence[SearchEvaluation]
    ) -> AnnealingState:
        """Cool down; at first, start from the best of the random sets."""
        best = best_of([*state.best, *evaluations])
        if not state.chains:
            order = sorted(evaluations, key=lambda evaluation: evaluation.cost)
            chains = tuple((evaluation, evaluation) for evaluation in order[: self.chains])
            return AnnealingState(first_temperature(evaluations), 0, chains, best)
        chains = tuple(zip(evaluations[::2], evaluations[1::2], strict=True))
        cooler = state.temperature * self.coldest ** (1 / max(1, self.steps - 1))
        return AnnealingState(cooler, state.step + 1, chains, best)

    def done(self, state: AnnealingState) -> bool:
        """Whether the chains have made their steps."""
        return state.step >= self.steps

    def finalists(self, state: AnnealingState) -> tuple[SearchEvaluation, ...]:
        """Give the best of all sets tried."""
        return state.best

    def _neighbour(self, times: Times, rng: np.random.Generator) -> Times:
        """One time is another; where none can be, the set itself."""
        others = sorted({*self.feasible.allowed} - {*times})
        likely = self.feasible.counted and times and others
        for _ in range(_TRIES if likely else 0):  # listing all neighbours takes longer
            swapped = {*times} - {int(rng.choice(times))} | {int(rng.choice(others))}
            if self.feasible.accepts(tuple(sorted(swapped))):
                return tuple(sorted(swapped))
        neighbours = self.feasible.exchanges(times)
        return neighbours[rng.integers(len(neighbours))] if neighbours else times


def first_temperature(evaluations: Sequence[SearchEvaluation]) -> float:
    """About how much an exchange changes the cost: the spread of random sets, over root N.

    If each of the N times of a set had its own share in the cost, this would be a share's.
    """
    alive = [evaluation for evaluation in evaluations if math.isfinite(evaluation.cost)]
    if not alive:
        return 0.0
    times = np.mean([max(1, len(evaluation.measurement_times)) for evaluation in alive])
    return float(np.std([evaluation.cost for evaluation in alive]) / np.sqrt(times))


def accepted(rise: float, temperature: float, rng: np.random.Generator) -> bool:
    """Metropolis' rule: accept a rise of the cost with probability exp(-rise / temperature).

    Parameters
    ----------
    rise : float
        What is not larger than 0 is accepted always.
    temperature : float
        0 accepts nothing else.
    rng : numpy.random.Generator
    """
    luck = rng.random()
    return not rise > 0 or (temperature > 0 and luck < math.exp(-rise / temperature))
