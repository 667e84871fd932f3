"""The step that each constraint has, and walks over measurements by it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times

BROKEN, PAYS, NEXT = range(3)
"""Numbers in `Turn.said`: which measurement is the first that breaks the constraint, or -1; how
often measurements pay the fee; and the first instant at which anything may be measured, or 0."""

Money = int | Decimal
"""A price, exactly as the user has written it."""


def money(number: float) -> Money:
    """A price as an exact fraction: 0.1 is one tenth, not the binary value of the float."""
    return number if isinstance(number, int) else Decimal(repr(number))


class Turn(NamedTuple):
    """Measurements whose turn it is, in the order in which they are made, as a step receives them.

    The moment of a point is that of its arrival if all values arrived as late as the latest: so
    moments are in the order in which measurements are made. Compiled steps get pointers, and Python
    has lists. A step goes on behind a measurement that breaks the constraint.
    """

    state: NDArray[np.int64]  # after the measurements before; the step changes it
    table: NDArray[np.int64]  # what the constraint says of points and instants
    size: int
    points: NDArray[np.int64]  # (size,)
    moments: NDArray[np.int64]
    instants: NDArray[np.int64]  # at which they are made
    sensors: NDArray[np.int64]
    said: NDArray[np.int64]  # (3,): the answer; before, -1, 0, 0


class Walk(NamedTuple):
    """The answer of a constraint about measurements."""

    state: Sequence[int]  # behind them
    broken: int | None  # the point of the first that breaks the constraint
    pays: int  # how often the fee is paid


@dataclass(frozen=True)
class Step:
    """A constraint. A form of it has `step`, and the numbers `table` and `start`."""

    key: str = ""  # of the job, for sentences
    first: int = 0  # points from which this one counts: those before have passed
    since_then: tuple[int, ...] | None = None  # the state behind measurements before

    kind: ClassVar[str]
    """The name in `pfdist.constraints.kinds.KINDS`."""
    fee: ClassVar[Any] = 0
    """The price of what a measurement begins."""
    step: ClassVar[Callable[[Turn], None]]

    @property
    def table(self) -> tuple[int, ...]:
        """The numbers that the step reads."""
        raise NotImplementedError

    @classmethod
    def is_whole(cls, table: Times, start: Times, ways: int, instants: int) -> bool:
        """Whether a table and a state from a file are as long as the step reads, and say so."""
        raise NotImplementedError

    @property
    def beginning(self) -> tuple[int, ...]:
        """The state before all measurements."""
        raise NotImplementedError

    @property
    def spare(self) -> float:
        """A number of measurements that cannot break the constraint, however they are made."""
        return 0

    def relaxed(self, *, is_in_order: bool) -> str:
        """The limit that the bound relaxes, as a sentence calls it; empty for none.

        `is_in_order`: whether values arrive in the order in which they are measured.
        """
        return self.kind

    @property
    def start(self) -> tuple[int, ...]:
        """The state before the measurements from `first` on."""
        return self.beginning if self.since_then is None else self.since_then

    def sentence(self, walk: Walk, when: str, sensor: str) -> str:
        """That measurements break the constraint, the first by a sensor at a time."""
        return f"{self.key} is broken"

    def walk(self, made: "Made") -> Walk:
        """Go through measurements."""
        state, said, first = [*self.start], [-1, 0, 0], self.first
        lists: Any = made.since(first) if first else made
        turn = Turn(state, self.table, len(made.points), *lists[:4], said)  # type: ignore[arg-type, call-arg]
        type(self).step(turn)
        broken = None if said[BROKEN] < 0 else made.points[said[BROKEN]]
        return Walk(state, broken, said[PAYS])

    def since(self, first: int, made: "Made") -> Self:
        """The same from a point on, after some measurements; points count from there."""
        return replace(self, first=self.first + first, since_then=tuple(self.walk(made).state))


class Made(NamedTuple):
    """Measurements in the order in which they are made."""

    points: Sequence[int]
    moments: Sequence[int]
    instants: Sequence[int]
    sensors: Sequence[int]
    ways: int

    def since(self, first: int) -> "Made":
        """The same, counted from an earlier beginning."""
        points, moments = ([each + first for each in own] for own in self[:2])
        return self._replace(
            points=points, moments=moments,
            instants=[each + first // self.ways for each in self.instants],
        )  # fmt: skip
