"""A race: fresh draws decide between a few sets, and are spent where the decision is open.

All run on common draws. After each round those fall out that a paired test finds worse than the
leader, and of the others the worse half; the rest run on, on twice as many draws.

References
----------
Karnin, Koren, Somekh, "Almost optimal exploration in multi-armed bandits", ICML 2013 (sequential
halving). Birattari, Stützle, Paquete, Varrentrapp, "A racing algorithm for configuring
metaheuristics", GECCO 2002 (paired tests under common conditions).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pfdist.evaluation import ShortlistEvaluation
from pfdist.measurement_times import Times
from pfdist.search.base import Candidate
from pfdist.search.paired import difference

_WORSE = 3.0  # standard errors, by which a set is found worse than the leader


@dataclass(frozen=True)
class RaceState:
    """Who is still running.

    Parameters
    ----------
    running : tuple of tuples of int
    draws : int
        Of the next round.
    evaluations : tuple of ShortlistEvaluation
        Of those that ran the last one, the best first.
    out : tuple of ShortlistEvaluation
        Of those that fell out before it.
    """

    running: tuple[Times, ...]
    draws: int
    evaluations: tuple[ShortlistEvaluation, ...] = ()
    out: tuple[ShortlistEvaluation, ...] = ()


@dataclass(frozen=True)
class Race:
    """Decide which of a few sets is the best.

    Parameters
    ----------
    sets : tuple of tuples of int
        Different ones.
    draws : int
        Of the first round.
    """

    sets: tuple[Times, ...]
    draws: int

    @property
    def generations(self) -> int:
        """How many rounds, if no test decides sooner."""
        return max(1, (len(self.sets) - 1).bit_length())

    @property
    def evaluations(self) -> float:
        """Half as many run twice as far each time."""
        return (1 + self.generations) / 2 * len(self.sets)

    def init(self) -> RaceState:
        """Give the state before the first round."""
        return RaceState(self.sets, self.draws)

    def ask(self, state: RaceState, rng: np.random.Generator) -> list[Candidate]:
        """Give those that are running, and how far they are to run."""
        return [Candidate(times, draws=state.draws) for times in state.running]

    def tell(self, state: RaceState, evaluations: Sequence[ShortlistEvaluation]) -> RaceState:
        """Let the leader and those near it run on."""
        order = sorted(evaluations, key=lambda evaluation: evaluation.cost)
        near = [
            evaluation
            for evaluation in order
            if not difference(evaluation, order[0]).is_worse(_WORSE)
        ]
        running = [evaluation.measurement_times for evaluation in near[: (len(order) + 1) // 2]]
        fell = tuple(
            evaluation
            for evaluation in state.evaluations
            if evaluation.measurement_times not in state.running
        )
        return RaceState(tuple(running), 2 * state.draws, tuple(order), (*fell, *state.out))

    def done(self, state: RaceState) -> bool:
        """Whether it is decided."""
        return bool(state.evaluations) and len(state.running) == 1

    def finalists(self, state: RaceState) -> tuple[ShortlistEvaluation, ...]:
        """Give all, each on the most draws that it ran on: the winner first, then by rounds."""
        return *state.evaluations, *state.out
