"""The relaxation behind the lower bound: a filter that may measure more than the set contains.

To the exact filter of the true model, further measurements do no harm. So its error at t with a
set M is at least its error with M and all allowed instants up to the k-th last measurement before
t. The relaxed error between two measurements depends on the last k measurement times alone; k is
the window. After a gap that is longer than the longest gap, the filter has measured every allowed
instant up to the last measurement. So the relaxation holds for every feasible set.

References
----------
Vitus, Zhang, Abate, Hu, Tomlin, "On efficient sensor scheduling for linear dynamical systems",
Automatica 48, 2012 (monotone covariances). Brown, Smith, Sun, "Information relaxations and duality
in stochastic dynamic programs", Operations Research 58, 2010.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.errors import JobError, MeasurementTimesError
from pfdist.times.constraints import Constraints
from pfdist.times.measurement_times import Times

NOTHING = -1
MOST_CELLS = 3_000_000
"""Largest number of states of a relaxation times instants: the memory grows with it."""


class State(NamedTuple):
    """The measurements that the relaxed filter has made.

    Parameters
    ----------
    filled_up_to : int
        The filter has measured at every allowed instant up to this one, or at none if it is -1.
    later : tuple of int
        Its measurement times after that.
    """

    filled_up_to: int
    later: Times

    @property
    def last(self) -> int:
        """The last measurement time; -1 if there is none."""
        return self.later[-1] if self.later else self.filled_up_to


class Steps(NamedTuple):
    """The steps from a state to others, each by one measurement.

    Parameters
    ----------
    times : array of int64, (n,)
        The time of each measurement.
    after : array of int64, (n,)
        Index of the state to which it leads.
    """

    times: NDArray[np.int64]
    after: NDArray[np.int64]


START = State(NOTHING, ())


@dataclass(frozen=True)
class Relaxation:
    """The states of the relaxed filter, and the steps from one to the next.

    Parameters
    ----------
    constraints : Constraints
        Forbidden and required times and the spacing bind every path. Their number of measurements
        is not used: a path may have any number.
    window : int
        k, the number of last measurements behind which every allowed instant is measured.
    longest_gap : int
        After a longer gap between two measurements, every allowed instant up to the second is
        measured.

    Raises
    ------
    MeasurementTimesError
        The window or the longest gap is less than 1.
    """

    constraints: Constraints
    window: int = 2
    longest_gap: int = 12

    def __post_init__(self) -> None:
        for name in ("window", "longest_gap"):
            if getattr(self, name) < 1:
                raise MeasurementTimesError(f"{name} must be at least 1, got {getattr(self, name)}")

    @property
    def horizon(self) -> int:
        """T."""
        return self.constraints.horizon

    @cached_property
    def _reached(self) -> set[State]:
        """All states that a path can reach."""
        found, new = {START}, [START]
        while new:
            state = new.pop()
            reached = {self.after(state, time) for time in self.followers(state)} - found
            new += reached
            found |= reached
        return found

    @cached_property
    def states(self) -> tuple[State, ...]:
        """All states that a path can reach, with their fallbacks, by their last time."""
        found = self._reached | {self.fallback(state) for state in self._reached}
        return tuple(sorted(found, key=lambda state: (state.last, state)))

    @cached_property
    def index(self) -> dict[State, int]:
        """Index of each state in `states`."""
        return {state: index for index, state in enumerate(self.states)}

    @cached_property
    def steps(self) -> list["Steps"]:
        """The steps from each state in `states`; none from a state that no path reaches."""
        found = []
        for state in self.states:
            times = self.followers(state) if state in self._reached else []
            after = [self.index[self.after(state, time)] for time in times]
            found.append(Steps(np.array(times, np.int64), np.array(after, np.int64)))
        return found

    @property
    def sets(self) -> list[Times]:
        """The measurement times of the relaxed filter in each state."""
        allowed = self.constraints.allowed
        return [
            (*(time for time in allowed if time <= state.filled_up_to), *state.later)
            for state in self.states
        ]

    @property
    def ends(self) -> list[int]:
        """The last instant at which the error of each state counts."""
        return [min(self.reach(state), self.horizon + 1) - 1 for state in self.states]

    def states_of(self, times: Times) -> list[State]:
        """Give the state whose error counts at each instant, (T+1), for a set of times."""
        state, found = START, list[State]()
        for following in (*times, self.horizon + 1):
            for t in range(max(0, state.last), following):
                found.append(state if t < self.reach(state) else self.fallback(state))
            if following <= self.horizon:
                state = self.after(state, following)
        return found

    def followers(self, state: State) -> list[int]:
        """Give the times that may be measured next: none behind a required time."""
        constraints, last = self.constraints, state.last
        first = 0 if last == NOTHING else last + constraints.minimum_spacing
        until = min(self.required_after(state), default=self.horizon)
        return [time for time in constraints.allowed if first <= time <= until]

    def required_after(self, state: State) -> list[int]:
        """Give the required times that are not measured yet."""
        return [time for time in self.constraints.required if time > state.last]

    def after(self, state: State, time: int) -> State:
        """Give the state after a further measurement."""
        if state.last != NOTHING and time - state.last > self.longest_gap:
            return State(time, ())
        later = (*state.later, time)
        # With fewer than `window` measurements so far, nothing is added to them.
        if len(later) < self.window:
            return State(state.filled_up_to, later)
        return State(later[0], later[1:])

    def reach(self, state: State) -> int:
        """Give the first instant at which the state's error no longer counts, if nothing follows.

        From then on the fallback's error counts.
        """
        if state == self.fallback(state):
            return self.horizon + 1
        return state.last + self.longest_gap

    def fallback(self, state: State) -> State:
        """Give the state in which every allowed instant up to the last measurement is measured."""
        return state if state == START else State(state.last, ())


def relaxation_for(constraints: Constraints, window: int, fewest: int) -> Relaxation:
    """Give the relaxation for sets of at least so many times.

    Its longest gap is three mean gaps, or fewer if they are too many for the memory, but at least
    two.

    Raises
    ------
    JobError
        It has more states than fit into memory.
    """
    instants = constraints.horizon + 1
    two, three = (min(math.ceil(gaps * instants / (fewest + 1)), instants) for gaps in (2, 3))

    def states(longest_gap: int) -> int:
        return int(instants * longest_gap ** (window - 1))

    longest_gap = three
    while longest_gap > two and states(longest_gap) * instants > MOST_CELLS:
        longest_gap -= 1
    if states(longest_gap) * instants > MOST_CELLS:
        raise JobError(
            f"window = {window} needs about {states(longest_gap):,} states of {instants} "
            f"instants, allowed: {MOST_CELLS:,} instants in all; try pfdist bound --window 1",
            argument="window",
        )
    return Relaxation(constraints, window, longest_gap)
