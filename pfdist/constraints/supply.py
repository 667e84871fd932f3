"""A store that measurements draw from, such as a battery that the sun charges."""

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from functools import cached_property
from math import lcm

from pfdist.common.measurement_times import Times
from pfdist.constraints.step import BROKEN, Money, Step, Turn, Walk

_DIGITS = 16  # of a full store in units


def supply_step(turn: Turn) -> None:
    """The state is the level, and the instant whose income comes next.

    The table has the capacity, the number of instants, and the income and prices. The income of an
    instant arrives before its measurement, and what does not fit is lost.
    """
    table, capacity, prices = turn.table, turn.table[0], 2 + turn.table[1]
    level, coming = turn.state[0], turn.state[1]
    for k in range(turn.size):
        for t in range(coming, turn.instants[k] + 1):
            level = min(capacity, level + table[2 + t])
        coming = max(coming, turn.instants[k] + 1)
        level -= table[prices + turn.points[k]]
        if level < 0 and turn.said[BROKEN] < 0:
            turn.said[BROKEN] = k
    turn.state[0] = level
    turn.state[1] = coming


@dataclass(frozen=True, kw_only=True)
class Supply(Step):
    """A store of which measurements take."""

    capacity: Money
    full: Money  # what is in it at first
    income: Sequence[Money]  # (T+1,)
    prices: Sequence[Money]  # (points,)

    kind = "store"
    step = supply_step

    def sentence(self, walk: Walk, when: str, sensor: str) -> str:
        """The first that draws too much."""
        return f"{self.key} holds too little at {when}"

    @property
    def beginning(self) -> tuple[int, ...]:
        """The level at first."""
        return (self._in_units(self.full), 0)

    @classmethod
    def is_whole(cls, table: Times, start: Times, ways: int, instants: int) -> bool:
        """Whether the table has all instants and points, and no income has come too often."""
        sizes = 2 + instants + ways * instants, 2
        return (len(table), len(start)) == sizes and table[1] == instants and start[1] >= 0

    @cached_property
    def table(self) -> tuple[int, ...]:
        """All amounts, in units."""
        each = (*map(self._in_units, (*self.income, *self.prices)),)
        return (self._in_units(self.capacity), len(self.income), *each)

    def _in_units(self, amount: Money) -> int:
        # Above the capacity an amount is lost, or never in the store, whatever it is.
        return round(min(Fraction(amount), 2 * Fraction(self.capacity)) * self._parts)

    @cached_property
    def _parts(self) -> int:
        """The number of units of an amount of 1: as many as make all amounts whole.

        Amounts are rounded if the store held too many units for compiled steps.
        """
        amounts = {self.capacity, self.full, *self.income, *self.prices}
        whole = lcm(*(Fraction(amount).denominator for amount in amounts))
        return int(min(whole, 10 ** (_DIGITS - 1 - Decimal(self.capacity).adjusted())))
