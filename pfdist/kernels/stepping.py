"""Compiled steps: a measurement is added to a record of those before."""

from collections.abc import Sequence
from functools import cache
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.constraints.kinds import KINDS, PlainStep
from pfdist.constraints.step import BROKEN, NEXT, PAYS, Turn
from pfdist.kernels.cached import Entry, compiled, entry
from pfdist.kernels.follows import ROUNDING, Follows
from pfdist.kernels.memory import ahead, call, read


@cache
def _entry_of(kind: str) -> Entry:
    return Entry(KINDS[kind].step, Turn)


def addresses_of(steps: Sequence[PlainStep]) -> list[int]:
    """The addresses of compiled steps."""
    return [_entry_of(step.kind).address for step in steps]


@compiled
def add_measurement(follows, limit, sensors, point, spent, state):
    """Add a measurement, the latest so far, to a record; whether it breaks no constraint.

    The record has what is spent, the first instant that may be measured, and the states.
    """
    sensor = point % sensors
    moment = point + (follows.longest_delay - follows.delays[sensor]) * sensors
    instant = point // sensors - follows.delays[sensor]
    price, fits, after = follows.prices[point], True, np.int64(0)
    at, said = follows.at, follows.said
    for number in range(follows.steps):
        first = follows.firsts[number]
        at[0], at[1] = point + first, moment + first
        at[2], at[3] = instant + first // sensors, sensor
        said[BROKEN], said[PAYS], said[NEXT] = -1, 0, 0
        own = ahead(state, follows.state_at[number])
        table = ahead(follows.tables, follows.table_at[number])
        call(
            follows.addresses[number],
            Turn(own, table, 1, at, ahead(at, 1), ahead(at, 2), ahead(at, 3), said),
        )
        fits &= said[BROKEN] < 0
        price += said[PAYS] * follows.fees[number]
        after = max(after, said[NEXT] - first // sensors)
    if limit > 0.0:
        fits &= price <= limit - spent[0] + ROUNDING * limit
    spent[0] += price
    spent[1] = after
    return fits


class Addition(NamedTuple):
    """Measurements that are added to the records of draws; see `pfdist.kernels.left.Left`."""

    follows: Annotated[int, Follows]  # address
    limit: float
    sensors: int
    draws: int
    points: NDArray[np.int64]  # (D,)
    spent: NDArray[np.float64]  # (D, 2)
    states: NDArray[np.int64]  # (D, size)
    size: int
    made: NDArray[np.uint8]  # (D,): whether it was made
    wanted: NDArray[np.uint8]  # (D,): whether it was, or is wanted
    broken: NDArray[np.uint8]  # (D,): filled: whether it is wanted and breaks a constraint
    trial_spent: NDArray[np.float64]  # (2,)
    trial_state: NDArray[np.int64]  # (size,)


@entry(Addition)
def add_to_all(place):
    """Add measurements where they were made, or are wanted and break no constraint."""
    work = read(place)
    for d in range(work.draws):
        if not work.wanted[d]:
            continue
        spent, state = ahead(work.spent, 2 * d), ahead(work.states, d * work.size)
        copy_record(spent, state, work.trial_spent, work.trial_state, work.size)
        fits = add_measurement(
            work.follows, work.limit, work.sensors, work.points[d], work.trial_spent,
            work.trial_state,
        )  # fmt: skip
        if fits or work.made[d]:
            copy_record(work.trial_spent, work.trial_state, spent, state, work.size)
        work.broken[d] = not fits


@compiled
def copy_record(spent, state, to_spent, to_state, size):
    """Copy a record of what is spent, and of states."""
    for number in range(np.int64(2)):
        to_spent[number] = spent[number]
    for number in range(size):
        to_state[number] = state[number]
