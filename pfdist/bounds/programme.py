"""The dynamic programme over numbers of measurements and states of the relaxed filter."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.bounds.relaxation import START, Relaxation
from pfdist.times.measurement_times import Times

Array = NDArray[np.float64]


class Least(NamedTuple):
    """The least relaxed expected MSE of each number of measurements.

    Parameters
    ----------
    mse : array of float64, (..., most+1)
        For 0 to most measurements; inf where no set has so many.
    paths : list of tuples of int
        Measurement times that reach it, for the first of the leading axes; empty where none does.
    """

    mse: Array
    paths: list[Times]


def least(relaxation: Relaxation, errors: Array, most: int) -> Least:
    """Find the least relaxed expected MSE for each number of measurements.

    Parameters
    ----------
    relaxation : Relaxation
    errors : array of float64, (..., S, T+1)
        Expected error of each state at each instant up to its end; others are not read. Leading
        axes, such as resamples of the draws, have programmes of their own.
    most : int
        The largest number of measurements.
    """
    states, index, instants = relaxation.states, relaxation.index, relaxation.horizon + 1
    between = _Between(relaxation, errors)
    cost = np.full((len(states), *errors.shape[:-2], most + 1), np.inf)
    cost[index[START], ..., 0] = 0.0
    before = np.full((len(states), most + 1), -1)
    whole, last = np.full(cost.shape[1:], np.inf), np.full(most + 1, -1)
    for number, state in enumerate(states):  # a step leads to a later state
        if not np.isfinite(cost[number]).any():
            continue
        for time in relaxation.followers(state):
            after = index[relaxation.after(state, time)]
            reached = cost[number, ..., :-1] + between(number, time)[..., None]
            _improve(cost[after, ..., 1:], before[after, 1:], reached, number)
        if not relaxation.required_after(state):
            _improve(whole, last, cost[number] + between(number, instants)[..., None], number)
    paths = [_path(relaxation, before, int(end), count) for count, end in enumerate(last)]
    return Least(whole / instants, paths)


class _Between:
    """The sum of the errors from the last measurement of a state to the next."""

    def __init__(self, relaxation: Relaxation, errors: Array) -> None:
        self._relaxation = relaxation
        self._before = np.zeros((*errors.shape[:-1], relaxation.horizon + 2))
        for number, end in enumerate(relaxation.ends):  # behind the end there may be anything
            summed = np.cumsum(errors[..., number, : end + 1], axis=-1)
            self._before[..., number, 1 : end + 2] = summed

    def __call__(self, number: int, until: int) -> Array:
        """Sum up to the instant before `until`, (...)."""
        relaxation, before = self._relaxation, self._before
        state = relaxation.states[number]
        own = min(until, relaxation.reach(state))
        total: Array = before[..., number, own] - before[..., number, max(state.last, 0)]
        if until > own:
            fallback = relaxation.index[relaxation.fallback(state)]
            total = total + before[..., fallback, until] - before[..., fallback, own]
        return total


def _improve(cost: Array, origin: NDArray[np.int64], new: Array, number: int) -> None:
    """Take lower costs, and note where those of the first leading axes come from."""
    better = new < cost
    origin[better.reshape(-1, len(origin))[0]] = number
    np.copyto(cost, new, where=better)


def _path(
    relaxation: Relaxation, before: NDArray[np.int64], state: int, measurements: int
) -> Times:
    """Follow the programme back from a last state."""
    times: list[int] = []
    while state >= 0 and measurements > 0:
        times.append(relaxation.states[state].last)
        state, measurements = int(before[state, measurements]), measurements - 1
    return tuple(reversed(times))
