"""The largest number of measurements, or of visits, in any stretch of time."""

from dataclasses import dataclass
from functools import cached_property

from pfdist.common.measurement_times import Times
from pfdist.constraints.step import BROKEN, Step, Turn, Walk


def most_within_step(turn: Turn) -> None:
    """The state is the end of what has begun, and the instants from which the oldest do not count.

    The table has the largest number, the number of instants, the first instant for which one at
    each instant does not count, and the ends, as those of a `Setup`.
    """
    state, table, most = turn.state, turn.table, turn.table[0]
    ends = 2 + table[1]
    for k in range(turn.size):
        own, instant = table[ends + turn.points[k]], turn.instants[k]
        if own > 0 and turn.moments[k] >= state[0]:
            if instant < state[1] and turn.said[BROKEN] < 0:
                turn.said[BROKEN] = k
            for number in range(1, most):
                state[number] = state[number + 1]
            state[most] = table[2 + instant]
            state[0] = own


@dataclass(frozen=True, kw_only=True)
class MostWithin(Step):
    """At most so many in any stretch."""

    most: int
    until: Times  # (T+1,): the first instant for which one at each instant does not count
    ends: tuple[int, ...]  # (points,): see `pfdist.constraints.setup.Setup`

    kind = "most_within"
    step = most_within_step

    @property
    def beginning(self) -> tuple[int, ...]:
        """Nothing has begun."""
        return (0,) * (1 + self.most)

    def sentence(self, walk: Walk, when: str, sensor: str) -> str:
        """The first that is too much."""
        return f"{self.key}, got one more at {when}"

    @classmethod
    def is_whole(cls, table: Times, start: Times, ways: int, instants: int) -> bool:
        """Whether the table has all instants and points, and the state as many as may count."""
        sizes = 2 + instants + ways * instants, 1 + table[0]
        return table[0] > 0 and table[1] == instants and (len(table), len(start)) == sizes

    @cached_property
    def table(self) -> tuple[int, ...]:
        """The largest number, and what lasts how long."""
        return (self.most, len(self.until), *self.until, *self.ends)
