"""A dynamic programme over prefixes: of all that measured last at one time, the best survive.

The error up to t depends on the measurements up to t alone. So sets are built from the left: a
state is the last measured time (or the last two) after so many measurements; of the prefixes that
lead to it a few of the least cost up to there survive, and each is extended by a measurement at
every time that is not too far away. It would be exact if one number said all about a prefix; but
its cloud matters for what follows, so several survive.

All prefixes are to be evaluated under the same noise: what they share is then filtered once, and
their costs differ by little else than what they are worth.

References
----------
Bellman, "Dynamic programming", 1957. Viterbi, "Error bounds for convolutional codes and an
asymptotically optimum decoding algorithm", IEEE Transactions on Information Theory 13, 1967, of
which this is a list version (Seshadri, Sundberg, "List Viterbi decoding algorithms with
applications", IEEE Transactions on Communications 42, 1994).
"""

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

Times = tuple[int, ...]

_WIDER = 1.5


class Prefix(NamedTuple):
    """Measurement times, and the last instant up to which errors count."""

    measurement_times: Times
    end: int


@dataclass(frozen=True)
class SurvivorState:
    """How far the programme is.

    Parameters
    ----------
    longest_gap : int
        Largest difference of two measurement times that is tried.
    corridor : float
        How far from its proportional place a measurement may lie.
    measured : int
        Measurements in each survivor.
    front : tuple of tuples of int
        The survivors.
    best : (float, tuple of int) or None
        Cost and times of the best whole set.
    done : bool
    """

    longest_gap: int
    corridor: float
    measured: int = 0
    front: tuple[Times, ...] = ((),)
    best: tuple[float, Times] | None = None
    done: bool = False


@dataclass(frozen=True)
class Survivors:
    """Survivor dynamic programme.

    Parameters
    ----------
    horizon : int
        T.
    measurement_budget : int
        N.
    survivors : int
        How many survive in each state.
    by_previous : bool
        Whether a state is the last two measured times, or the last alone.
    """

    horizon: int
    measurement_budget: int
    survivors: int = 2
    by_previous: bool = False

    def init(self) -> SurvivorState:
        """Give the state before the first asking: gaps of up to two and a third of the mean one."""
        mean_gap = (self.horizon + 1) / self.measurement_budget
        return SurvivorState(max(2, math.ceil(7 / 3 * mean_gap)), max(2.0, 2 * mean_gap))

    def ask(self, state: SurvivorState) -> list[Prefix]:
        """Give the extensions of all survivors up to their last time; of whole sets, up to T."""
        if state.measured == self.measurement_budget:
            return [Prefix(times, self.horizon) for times in state.front]
        first, last = self._place(state, state.measured + 1)
        return [
            Prefix((*times, t), t)
            for times in state.front
            for t in range(_after(times), min(_after(times) + state.longest_gap, last + 1))
            if t >= first
        ]

    def tell(
        self, state: SurvivorState, asked: Sequence[Prefix], costs: Sequence[float]
    ) -> SurvivorState:
        """Let the best of each state survive; at the end, widen limits that were in the way."""
        if state.measured == self.measurement_budget:
            return self._finished(state, min(zip(costs, state.front, strict=True)))
        reached: dict[Times, list[tuple[float, Times]]] = defaultdict(list)
        for (times, _), cost in zip(asked, costs, strict=True):
            reached[times[-2 if self.by_previous else -1 :]].append((cost, times))
        front = [
            times
            for _, candidates in sorted(reached.items())
            for _, times in sorted(candidates)[: self.survivors]
        ]
        return replace(state, measured=state.measured + 1, front=tuple(front))

    def _finished(self, state: SurvivorState, found: tuple[float, Times]) -> SurvivorState:
        best = found if state.best is None else min(state.best, found)
        if found != best or not self._leans(state, found[1]):
            return replace(state, best=best, done=True)
        gap = min(self.horizon + 1, math.ceil(_WIDER * state.longest_gap))
        return SurvivorState(gap, _WIDER * state.corridor, best=best)

    def _leans(self, state: SurvivorState, times: Times) -> bool:
        """Whether a gap is the longest, or a time at the edge of its place, that was allowed."""
        gaps = [b - a for a, b in zip((-1, *times), (*times,), strict=False)]
        if max(gaps) == state.longest_gap and state.longest_gap <= self.horizon:
            return True
        for number, time in enumerate(times, start=1):
            first, last = self._place(state, number)
            lowest, highest = number - 1, self.horizon - self.measurement_budget + number
            if (time == first and first > lowest) or (time == last and last < highest):
                return True
        return False

    def _place(self, state: SurvivorState, number: int) -> tuple[int, int]:
        """First and last time of the measurement of this number, counted from 1."""
        proportional = (number - 0.5) * (self.horizon + 1) / self.measurement_budget - 0.5
        lowest, highest = number - 1, self.horizon - self.measurement_budget + number
        return (
            max(lowest, math.floor(proportional - state.corridor)),
            min(highest, math.ceil(proportional + state.corridor)),
        )


def _after(times: Times) -> int:
    """The first time that may follow."""
    return times[-1] + 1 if times else 0
