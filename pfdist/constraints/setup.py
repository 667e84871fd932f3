"""Visits, installations and largest numbers: a measurement begins what later ones share."""

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

from pfdist.common.measurement_times import Times
from pfdist.constraints.step import BROKEN, PAYS, Money, Step, Turn, Walk

NO_LIMIT = 2**62


def setup_step(turn: Turn) -> None:
    """The state is the end of what has begun, and how often it began; the table begins with `most`.

    The next measurement that needs it, and is not before its end, begins another one.
    """
    table, points, moments = turn.table, turn.points, turn.moments
    end, before, most = turn.state[0], turn.state[1], turn.table[0]
    number = before
    for k in range(turn.size):
        own = table[1 + points[k]]
        if own > 0 and moments[k] >= end:
            if number >= most and turn.said[BROKEN] < 0:
                turn.said[BROKEN] = k
            end = own
            number += 1
    turn.said[PAYS] = number - before
    turn.state[0] = end
    turn.state[1] = number


@dataclass(frozen=True, kw_only=True)
class Setup(Step):
    """A visit, or another thing that a measurement begins and later ones share.

    >>> Setup(ends=(3, 4, 5, 6, 7, 8)).firsts((0, 2, 4))
    (0, 4)
    """

    # (points,): the first moment after what begins at each point; these never decrease. 0 at points
    # that do not need it
    ends: tuple[int, ...]
    price: Money = 0
    most: int | None = None
    things: str = "measurements"  # what is counted
    in_order: bool = True  # whether the order of measurements matters

    kind = "setup"
    step = setup_step
    beginning: ClassVar[tuple[int, ...]] = (0, 0)

    @cached_property
    def table(self) -> tuple[int, ...]:
        """The largest number, and the ends."""
        return (NO_LIMIT if self.most is None else self.most, *self.ends)

    @classmethod
    def is_whole(cls, table: Times, start: Times, ways: int, instants: int) -> bool:
        """Whether the table has all points."""
        return (len(table), len(start)) == (1 + ways * instants, 2)

    @property
    def fee(self) -> Money:
        """The price of each time that it begins."""
        return self.price

    def relaxed(self, *, is_in_order: bool) -> str:
        """The largest number; where the order matters and is another one, the whole."""
        if self.in_order and not is_in_order:
            return f"{self.things} with several delays"
        what = self.things if self.in_order else "single sensors"
        return f"most of {what}" * (self.most is not None)

    @property
    def open_until(self) -> int:
        """Points before this one share what has begun."""
        return max(0, self.start[0] - self.first)

    @property
    def left(self) -> int | None:
        """How often it may still begin."""
        return None if self.most is None else max(0, self.most - self.start[1])

    @property
    def spare(self) -> float:
        """As often as it may still begin."""
        return math.inf if self.left is None else self.left

    @cached_property
    def ends_here(self) -> tuple[int, ...]:
        """The ends, as points count."""
        return tuple(end and end - self.first for end in self.ends[self.first :])

    def sentence(self, walk: Walk, when: str, sensor: str) -> str:
        """How often it begins, and how often it may."""
        return f"{self.key} is {self.most}, got {walk.state[1]} {self.things}"

    def firsts(self, times: Iterable[int], moment: Callable[[int], int] = int) -> Times:
        """The points that begin it, of some that come in the order of their moments."""
        firsts, end = list[int](), self.open_until
        for time in times:
            if self.ends_here[time] and moment(time) >= end:
                firsts.append(time)
                end = self.ends_here[time]
        return tuple(firsts)
