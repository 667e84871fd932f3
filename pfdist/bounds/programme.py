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
    states, instants = relaxation.states, relaxation.horizon + 1
    between = _Between(relaxation, errors)
    cost = np.full((len(states), *errors.shape[:-2], most + 1), np.inf)
    cost[relaxation.index[START], ..., 0] = 0.0
    origin = np.full((len(states), most + 1), -1)
    whole, last = np.full((1, *cost.shape[1:]), np.inf), np.full((1, most + 1), -1)
    end = np.array([instants])
    for number, (state, steps) in enumerate(zip(states, relaxation.steps, strict=True)):
        if not np.isfinite(cost[number]).any():
            continue
        if steps.times.size:  # a step leads to a later state
            reached = between(number, steps.times) + cost[number, ..., :-1]
            least_cost, better = _lesser(cost[steps.after, ..., 1:], reached)
            cost[steps.after, ..., 1:] = least_cost
            origin[steps.after, 1:] = np.where(better, number, origin[steps.after, 1:])
        if not relaxation.required_after(state):
            whole, better = _lesser(whole, between(number, end) + cost[number])
            last = np.where(better, number, last)
    paths = [_path(relaxation, origin, int(end), count) for count, end in enumerate(last[0])]
    return Least(whole[0] / instants, paths)


class _Between:
    """The sum of the errors from the last measurement of a state to the next."""

    def __init__(self, relaxation: Relaxation, errors: Array) -> None:
        self._relaxation = relaxation
        self._before = np.zeros((*errors.shape[:-1], relaxation.horizon + 2))
        for number, end in enumerate(relaxation.ends):  # behind the end there may be anything
            summed = np.cumsum(errors[..., number, : end + 1], axis=-1)
            self._before[..., number, 1 : end + 2] = summed

    def __call__(self, number: int, until: NDArray[np.int64]) -> Array:
        """Sums up to the instant before each of `until`, (len(until), ..., 1)."""
        relaxation, before = self._relaxation, self._before
        state = relaxation.states[number]
        fallback = relaxation.index[relaxation.fallback(state)]
        own = np.minimum(until, relaxation.reach(state))
        total = before[..., number, own] - before[..., number, [max(state.last, 0)]]
        total += before[..., fallback, until] - before[..., fallback, own]
        return np.moveaxis(total, -1, 0)[..., None]


def _lesser(cost: Array, new: Array) -> tuple[Array, NDArray[np.bool_]]:
    """The lesser costs, (n, ..., N), and where the new are less for the first leading axes, (n, N).

    Parameters
    ----------
    cost, new : array of float64, (n, ..., N)
    """
    better = new < cost
    return np.where(better, new, cost), better.reshape(len(cost), -1, cost.shape[-1])[:, 0]


def _path(
    relaxation: Relaxation, origin: NDArray[np.int64], state: int, measurements: int
) -> Times:
    """Follow the programme back from a last state."""
    times: list[int] = []
    while state >= 0 and measurements > 0:
        times.append(relaxation.states[state].last)
        state, measurements = int(origin[state, measurements]), measurements - 1
    return tuple(reversed(times))
