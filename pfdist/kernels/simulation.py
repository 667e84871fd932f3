"""The simulation of draws of any model; it is compiled once a machine.

Draws take the places of a filter's particles, so a block computes several of them at a time.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.kernels.blocks import call
from pfdist.kernels.cached import compiled, entry
from pfdist.kernels.variates import (
    TRUTH_INITIAL,
    TRUTH_MEASUREMENT,
    TRUTH_PROCESS,
    fill_of_draws,
)

INITIAL, TRANSITION, QUANTITY, MEASUREMENT = np.arange(4)
"""Rows of `pfdist.kernels.blocks.Blocks`. The measurements of further sensors follow."""

INITIAL_NOISE, PROCESS_NOISE, MEASUREMENT_NOISE = np.arange(3)

TOGETHER = np.int64(256)
"""Draws that are simulated side by side."""


class Request(NamedTuple):
    """Which D draws are simulated, at T+1 instants."""

    stream: np.uint64  # key of the noise
    first_draw: int  # index of the first draw in its stream
    start: int  # first instant
    has_begun: bool  # whether the first states are given
    first_components: NDArray[np.int64]  # (sensors + 1,): of y, and their number
    first_noises: NDArray[np.int64]  # (sensors,): of v, for each sensor
    # (3, most components): kinds of the components of initial, process and measurement noise; -1
    # for none
    kinds: NDArray[np.int64]


@entry
def simulate_draws(blocks, request, x, y, z, states, values, noise, words):
    """Fill x (D, T+1, n), y (D, T+1, m) and z (D, T+1, q).

    `states` (2 * n * TOGETHER,), `values` and `noise`, with a row for each component, are scratch.
    """
    stride, half = TOGETHER, x.shape[2] * TOGETHER
    for begin in range(0, x.shape[0], stride):
        draws, here = min(stride, x.shape[0] - begin), 0
        _begin(blocks, request, x, states, noise, words, begin, draws)
        for k in range(x.shape[1]):
            first = here * half
            _fill(words, noise, request, MEASUREMENT_NOISE, begin, draws, k, TRUTH_MEASUREMENT)
            _spread(states, first, x, begin, draws, k, 0, x.shape[2])
            for sensor in range(request.first_noises.size):
                _evaluate(
                    blocks, MEASUREMENT + sensor, k, values, 0, states, first, noise,
                    request.first_noises[sensor] * stride,
                )  # fmt: skip
                component = request.first_components[sensor]
                count = request.first_components[sensor + 1] - component
                _spread(values, 0, y, begin, draws, k, component, count)
            _evaluate(blocks, QUANTITY, k, values, 0, states, first, noise, 0)
            _spread(values, 0, z, begin, draws, k, 0, z.shape[2])
            if k + 1 < x.shape[1]:
                _fill(words, noise, request, PROCESS_NOISE, begin, draws, k, TRUTH_PROCESS)
                _evaluate(blocks, TRANSITION, k, states, half - first, states, first, noise, 0)
                here = 1 - here


@compiled
def _begin(blocks, request, x, states, noise, words, begin, draws):
    if request.has_begun:
        for c in range(x.shape[2]):
            for d in range(TOGETHER):
                states[c * TOGETHER + d] = x[begin + min(d, draws - 1), 0, c]
    else:
        _fill(words, noise, request, INITIAL_NOISE, begin, draws, -request.start, TRUTH_INITIAL)
        _evaluate(blocks, INITIAL, 0, states, 0, states, 0, noise, 0)


@compiled
def _fill(words, noise, request, process, begin, draws, k, role):
    for c in range(request.kinds.shape[1]):
        if request.kinds[process, c] >= 0:
            fill_of_draws(
                words, noise, c * TOGETHER, request.kinds[process, c], request.stream,
                request.start + k, role, c, request.first_draw + begin, draws,
            )  # fmt: skip


@compiled
def _evaluate(blocks, block, k, values, to, states, first, noise, first_noise):
    """Call a block for all draws that are simulated side by side."""
    call(
        blocks.addresses[block, k], values, to, TOGETHER, states, first, TOGETHER,
        noise, first_noise, TOGETHER, states, 0, 0, 0, blocks.table, blocks.places[block, k],
        1, TOGETHER,
    )  # fmt: skip


@compiled
def _spread(values, first, result, begin, draws, k, component, count):
    """Copy rows of draws into an array (draws, instants, components)."""
    for c in range(count):
        for d in range(draws):
            result[begin + d, k, component + c] = values[first + c * TOGETHER + d]
