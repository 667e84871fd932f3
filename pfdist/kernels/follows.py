"""The constraints of a job as numbers: what may follow a measurement.

Measurements step in the order in which they are made; see `pfdist.constraints`.
"""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times
from pfdist.common.points import PointNumbers
from pfdist.constraints.kinds import PlainStep

ROUNDING = 1e-9  # share of the budget by which sums of prices may be rounded


class StepLimits(NamedTuple):
    """The constraints on what may follow a measurement, as numbers; by default there are none."""

    prices: tuple[float, ...] = ()  # of each point; by default 1
    delays: Times = ()  # (sensors,): instants after which a value arrives, at its point
    required: Times = ()  # points that are always measured
    steps: tuple[PlainStep, ...] = ()

    @property
    def recorded(self) -> dict[str, Any]:
        """The fields that are not empty."""
        return {name: value for name, value in self._asdict().items() if value}

    def arrays(self, sensors: int, instants: range, addresses: Sequence[int] = ()) -> "Follows":
        """The constraints as arrays, with instants and points counted from the first instant.

        `addresses` are those of the compiled steps.
        """
        points = PointNumbers(sensors)
        first, possible = points.first(instants.start), points.first(instants.stop)
        delays = np.array(self.delays or (0,) * sensors, np.int64)
        required = np.isin(range(first, possible), self.required)
        made = (points.instant(point) - delays[points.way(point)] for point in self.required)

        def ends(sizes: Iterable[int]) -> NDArray[np.int64]:
            return np.cumsum([0, *sizes])

        def joined(each: Iterable[Times]) -> NDArray[np.int64]:
            return np.array([number for numbers in each for number in numbers] or [0], np.int64)

        tables, starts = [step.table for step in self.steps], [step.start for step in self.steps]
        return Follows(
            prices=np.array(self.prices or (1.0,) * possible)[first:],
            delays=delays,
            longest_delay=int(delays.max()),
            required=required.astype(np.uint8),
            last_required=int(max(made, default=-1)) - instants.start,
            steps=len(addresses),
            addresses=np.array(addresses or [0], np.int64),
            tables=joined(tables),
            table_at=ends(map(len, tables)),
            start=joined(starts),
            state_at=ends(map(len, starts)),
            fees=np.array([step.fee for step in self.steps] or [0.0]),
            firsts=np.array([step.first + first for step in self.steps] or [0], np.int64),
            said=np.zeros(3, np.int64),
            at=np.zeros(4, np.int64),
        )


UNLIMITED = StepLimits()


class Follows(NamedTuple):
    """The fields of `StepLimits` for compiled functions, with room for a step."""

    prices: NDArray[np.float64]  # 0 where nothing may be measured
    delays: NDArray[np.int64]
    longest_delay: int
    required: NDArray[np.uint8]  # (points,): whether each point is
    last_required: int  # the last instant at which a required point is measured; below 0: none
    steps: int
    addresses: NDArray[np.int64]  # (steps,)
    tables: NDArray[np.int64]  # of all steps
    table_at: NDArray[np.int64]  # (steps + 1,): where the table of each begins
    start: NDArray[np.int64]  # the states of all steps before any measurement
    state_at: NDArray[np.int64]  # (steps + 1,)
    fees: NDArray[np.float64]  # (steps,)
    firsts: NDArray[np.int64]  # (steps,): points that each counts before those of the arrays
    said: NDArray[np.int64]  # see `pfdist.constraints.step.Turn`
    at: NDArray[np.int64]  # (4,): the measurement whose turn it is
