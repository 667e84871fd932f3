"""A race between a few sets on fresh draws; most draws go to sets with similar errors.

All sets share the draws. After each round, sets that a paired test finds worse than the leader drop
out (Birattari, Stützle, Paquete, Varrentrapp, "A racing algorithm for configuring metaheuristics",
GECCO 2002). The worse half of the sets drops out in any case, and the others continue on twice as
many draws: sequential halving (Karnin, Koren, Somekh, "Almost optimal exploration in multi-armed
bandits", ICML 2013).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pfdist.common.measurement_times import Times
from pfdist.filters.estimate import Evaluation
from pfdist.search.base import Candidate

_WORSE = 3.0  # standard errors from which a set is worse than the leader


@dataclass(frozen=True)
class RaceState:
    """Progress of the race."""

    running: tuple[Times, ...]  # sets of the next round
    draws: int  # of the next round
    evaluations: tuple[Evaluation, ...] = ()  # of the last round, the best first
    # last evaluations of the sets that dropped out before the last round
    out: tuple[Evaluation, ...] = ()


@dataclass(frozen=True)
class Race:
    """An optimiser that finds the best of a few different sets."""

    sets: tuple[Times, ...]
    draws: int  # of the first round
    kept: int = 1  # so many sets stay at least
    until: int = 0  # in rounds with fewer draws
    # Draws from which a test decides: fewer may miss rare large errors, and then their standard
    # errors are too small.
    tested_from: int = 0

    @property
    def generations(self) -> int:
        """Number of rounds, unless a test decides earlier."""
        return max(1, (len(self.sets) - 1).bit_length())

    @property
    def evaluations(self) -> float:
        """Approximate work, in evaluations on the draws of the first round.

        Each round has half as many sets and twice as many draws as the one before. A test leaves
        about `kept` of many sets after the first round.
        """
        is_short = self.until > self.tested_from
        later = min(len(self.sets) / 2, 2 * self.kept) if is_short else len(self.sets) / 2
        return len(self.sets) + (self.generations - 1) * later

    def init(self) -> RaceState:
        """The state before the first round."""
        return RaceState(self.sets, self.draws)

    def ask(self, state: RaceState, rng: np.random.Generator) -> list[Candidate]:
        """The sets of the next round, with its number of draws."""
        return [Candidate(times, draws=state.draws) for times in state.running]

    def tell(self, state: RaceState, evaluations: Sequence[Evaluation]) -> RaceState:
        """Keep the leader and the sets that may be as good."""
        order = sorted(evaluations, key=lambda evaluation: evaluation.expected_mse)
        near = [
            evaluation
            for evaluation in order
            if state.draws < self.tested_from
            or not evaluation.difference(order[0]).is_positive(_WORSE)
        ]
        staying = near[: (len(order) + 1) // 2]
        if 2 * state.draws <= self.until and len(staying) < self.kept:
            staying = order[: self.kept]
        running = [evaluation.measurement_times for evaluation in staying]
        dropped = tuple(
            evaluation
            for evaluation in state.evaluations
            if evaluation.measurement_times not in state.running
        )
        return RaceState(tuple(running), 2 * state.draws, tuple(order), (*dropped, *state.out))

    def done(self, state: RaceState) -> bool:
        """Whether only one set is left."""
        return bool(state.evaluations) and len(state.running) == 1

    def finalists(self, state: RaceState) -> tuple[Evaluation, ...]:
        """The last evaluation of every set: the winner first, then sets of later rounds first."""
        return *state.evaluations, *state.out
