"""The smallest difference of measurement times: of all, or of one sensor."""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

from pfdist.common.measurement_times import Times
from pfdist.constraints.spacing import Spacing
from pfdist.constraints.step import BROKEN, NEXT, Step, Turn


def apart_step(turn: Turn) -> None:
    """The state is the first instant that is far enough; the table begins with the sensor or -1."""
    table, only, following = turn.table, turn.table[0], turn.state[0]
    for k in range(turn.size):
        if only < 0 or only == turn.sensors[k]:
            if turn.instants[k] < following and turn.said[BROKEN] < 0:
                turn.said[BROKEN] = k
            following = table[1 + turn.instants[k]]
    turn.state[0] = following
    if only < 0:
        turn.said[NEXT] = following


@dataclass(frozen=True, kw_only=True)
class Apart(Step):
    """A smallest difference of instants."""

    after: Times  # (T+1,): the first instant that is far enough after each
    sensor: int = -1  # -1: all
    ways: int = 1  # the number of sensors

    kind = "apart"
    step = apart_step
    beginning: ClassVar[tuple[int, ...]] = (0,)

    @classmethod
    def is_whole(cls, table: Times, start: Times, ways: int, instants: int) -> bool:
        """Whether the table has all instants."""
        return (len(table), len(start)) == (1 + instants, 1)

    @cached_property
    def spacing(self) -> Spacing:
        """The same as a rule for instants, which count from the first."""
        return Spacing(self.after).since(self.first // self.ways)

    def relaxed(self, *, is_in_order: bool) -> str:
        """The spacing of a sensor."""
        return "minimum_spacing of single sensors" * (self.sensor >= 0)

    @cached_property
    def table(self) -> tuple[int, ...]:
        """The sensor, and the first instants after each."""
        return (self.sensor, *self.after)
