"""The simulation of draws of any model; it is compiled once per machine.

Draws are processed like a filter's particles, so a block computes several of them at a time.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.kernels.blocks import Blocks, call_block
from pfdist.kernels.cached import compiled, entry
from pfdist.kernels.memory import ahead, call
from pfdist.kernels.variates import (
    TRUTH_INITIAL,
    TRUTH_MEASUREMENT,
    TRUTH_PROCESS,
    Key,
    VariateRow,
)

INITIAL, TRANSITION, QUANTITY, MEASUREMENT = np.arange(4)
"""Rows of `pfdist.kernels.blocks.Blocks`. The measurements of further sensors follow."""

INITIAL_NOISE, PROCESS_NOISE, MEASUREMENT_NOISE = np.arange(3)

TOGETHER = np.int64(256)
"""Number of draws that are simulated together."""


class SimulationRequest(NamedTuple):
    """A request to simulate D draws at T+1 instants."""

    draws: int
    instants: int
    states: int  # n
    measurements: int  # m
    quantities: int  # q
    sensors: int
    stream: np.uint64  # key of the noise
    first_draw: int  # index of the first draw in its stream
    start: int  # first instant
    has_begun: bool  # whether the first states are given
    first_components: NDArray[np.int64]  # (sensors + 1,): of y, and their number
    first_noises: NDArray[np.int64]  # (sensors,): of v, for each sensor
    components: int  # of the longest process
    # (3, components): kinds of initial, process and measurement noise; -1 for none
    kinds: NDArray[np.int64]


class SimulationCall(NamedTuple):
    """The data that all functions of a simulation share; a row of draws has `TOGETHER` entries."""

    blocks: Blocks
    request: SimulationRequest
    x: NDArray[np.float64]  # (D, T+1, n)
    y: NDArray[np.float64]  # (D, T+1, m)
    z: NDArray[np.float64]  # (D, T+1, q)
    states: NDArray[np.float64]  # 2 n rows: a step reads a half and writes the other
    values: NDArray[np.float64]  # rows of a block's results
    noise: NDArray[np.float32]  # a row for each component, and one more
    words: NDArray[np.uint32]  # (64,)
    fill: int  # address of `pfdist.kernels.variates.fill_of_draws`


class _Now(NamedTuple):
    """The draws that are simulated side by side, and the instant."""

    begin: int | np.int64  # row of the first draw
    draws: int | np.int64
    k: int | np.int64  # number of the instant


@entry(SimulationCall)
def simulate_draws(work):
    """Fill x, y and z."""
    request = work.request
    for begin in range(np.int64(0), request.draws, TOGETHER):
        left, here = request.draws - begin, np.int64(0)
        draws = TOGETHER if left > TOGETHER else left
        _begin(work, _Now(begin, draws, np.int64(0)))
        for k in range(request.instants):
            now = _Now(begin, draws, k)
            states = ahead(work.states, here * request.states * TOGETHER)
            _spread(work, now, states, work.x, np.int64(0), request.states, request.states)
            _measure(work, now, states)
            _evaluate(work, QUANTITY, k, states, work.values, work.noise)
            count = request.quantities
            _spread(work, now, work.values, work.z, np.int64(0), count, count)
            if k + 1 < request.instants:
                here = 1 - here
                _fill(work, now, PROCESS_NOISE, request.start + k, TRUTH_PROCESS)
                following = ahead(work.states, here * request.states * TOGETHER)
                _evaluate(work, TRANSITION, k, states, following, work.noise)


@compiled
def _begin(work, now):
    """Fill the first half with the given states, or with x(0)."""
    request = work.request
    if request.has_begun:
        for d in range(TOGETHER):
            row = now.begin + (d if d < now.draws else now.draws - 1)
            for c in range(request.states):
                place = row * request.instants * request.states + c
                work.states[c * TOGETHER + d] = work.x[place]
    else:
        _fill(work, now, INITIAL_NOISE, np.int64(0), TRUTH_INITIAL)
        _evaluate(work, INITIAL, np.int64(0), work.states, work.states, work.noise)


@compiled
def _measure(work, now, states):
    request = work.request
    _fill(work, now, MEASUREMENT_NOISE, request.start + now.k, TRUTH_MEASUREMENT)
    for sensor in range(request.sensors):
        noise = ahead(work.noise, request.first_noises[sensor] * TOGETHER)
        _evaluate(work, MEASUREMENT + sensor, now.k, states, work.values, noise)
        first = request.first_components[sensor]
        count = request.first_components[sensor + 1] - first
        _spread(work, now, work.values, work.y, first, count, request.measurements)


@compiled
def _fill(work, now, process, t, role):
    """A row of noise for each component of a process."""
    request = work.request
    for c in range(request.components):
        kind = request.kinds[process * request.components + c]
        if kind >= 0:
            row = VariateRow(
                work.words, ahead(work.noise, c * TOGETHER), 1, kind,
                Key(request.stream, t, role, c), request.first_draw + now.begin, now.draws,
            )  # fmt: skip
            call(work.fill, row)


@compiled
def _evaluate(work, block, k, states, values, noise):
    """Call a block for all draws that are simulated side by side."""
    blocks, which = work.blocks, block * work.request.instants + k
    call_block(
        blocks, which, (values, TOGETHER), (states, TOGETHER), (noise, TOGETHER),
        (states, 0, 0), (1, TOGETHER),
    )  # fmt: skip


@compiled
def _spread(work, now, values, result, first, count, components):
    """Copy rows of draws to some components of an array (draws, instants, components)."""
    for c in range(count):
        for d in range(now.draws):
            place = ((now.begin + d) * work.request.instants + now.k) * components + first + c
            result[place] = values[c * TOGETHER + d]
