"""Groups of sensors, of which at most one measures at an instant."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Self

from pfdist.common.measurement_times import Times
from pfdist.constraints.step import BROKEN, Step, Turn, Walk


def together_step(turn: Turn) -> None:
    """The state is the last instant of the group, and who measured; the table numbers sensors."""
    instant, number = turn.state[0], turn.state[1]
    for k in range(turn.size):
        own = turn.table[turn.sensors[k]]
        if own > 0:
            if instant == turn.instants[k] and number != own and turn.said[BROKEN] < 0:
                turn.said[BROKEN] = k
            instant = turn.instants[k]
            number = own
    turn.state[0] = instant
    turn.state[1] = number


@dataclass(frozen=True, kw_only=True)
class Together(Step):
    """A group."""

    numbers: Times  # of each sensor: that of its own repeats in the group, from 1 on; 0 for others

    kind = "together"
    step = together_step
    beginning: ClassVar[tuple[int, ...]] = (-1, 0)

    @classmethod
    def made_of(cls, group: Sequence[Times], ways: int) -> Self:
        """The group of some sensors, by the ways of each."""
        numbers = {way: number for number, own in enumerate(group, 1) for way in own}
        return cls(numbers=tuple(numbers.get(way, 0) for way in range(ways)))

    @classmethod
    def is_whole(cls, table: Times, start: Times, ways: int, instants: int) -> bool:
        """Whether the table has all sensors."""
        return (len(table), len(start)) == (ways, 2)

    @property
    def table(self) -> tuple[int, ...]:
        """The numbers."""
        return self.numbers

    def sentence(self, walk: Walk, when: str, sensor: str) -> str:
        """The sensor that measures beside another one."""
        return f"sensors.{sensor}.together is broken"
