"""The penalty of a measurement: what it does to the variance of z, less what replicates would do.

Before a measurement, the truth is each particle with the same probability, given the cloud as a
set. So the measurement that a random particle would make has the law of the true one, and the
difference of the variances after both has the mean 0, for any number of particles.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from pfdist.kernels.ancestors import weigh
from pfdist.kernels.batch import (
    SENSORS,
    Instant,
    add_error,
    fill_mean_of_z,
    fill_variances,
    present,
    sensors_at,
    with_given,
)
from pfdist.kernels.blocks import Blocks, call_block
from pfdist.kernels.cached import compiled, entry
from pfdist.kernels.memory import ahead, call, read
from pfdist.kernels.rules import Replicates
from pfdist.kernels.simulation import MEASUREMENT
from pfdist.kernels.variates import SPARE, TRUTH_MEASUREMENT, Key, VariateRow, codes_of
from pfdist.kernels.vectors import LANES

REPLICATES: Final = 6
"""Replicates of a measurement, at most 15."""

_SEEN: Final = int(LANES)  # particles of each draw whose measurements are computed


def replicates_of(
    factor: float, blocks: Blocks, noise: Sequence[str], first_noises: Sequence[int],
    draws: int, states: int, measurements: int,
) -> Replicates:  # fmt: skip
    """The replicates of some draws, and by how much their penalty counts.

    `blocks` are those of a simulation, `noise` has the kinds of its measurement noise, and
    `first_noises` the first for each sensor.
    """
    row, (kinds,) = draws * _SEEN, codes_of((*noise, "uniform"))
    return Replicates(
        penalise.address,
        factor,
        *blocks,
        kinds.size,
        kinds,
        np.array(first_noises),
        row,
        np.zeros(states * row),
        np.zeros(measurements * row),
        np.zeros(kinds.size * (row + SPARE), np.float32),
    )


@entry(Instant)
def penalise(measurement):
    """Add the penalty of an instant's last measurement to the error.

    The truth makes the true measurement, and random particles make the replicates.
    """
    at, s, t, sensors, sensor = read(measurement)
    request, batch, factor = at.work.request, at.work.batch, at.work.rule.replicates.factor
    if sensors >> sensor != 1:
        return
    _choose_particles(at, t)
    _measure(at, t, sensor)
    for replicate in range(REPLICATES + 1):
        _weigh_by(at, t, sensor, replicate)
        share = factor if replicate == 0 else -factor / REPLICATES
        for d in range(at.draws):
            variance = 0.0
            for c in range(request.quantities):
                variance += batch.moments[(request.quantities + c) * batch.row + d]
            if variance < np.inf:  # whether it counts is a function of the cloud and y, too
                add_error(at, s, t, d, share * variance, request.instant_weights[t])
    for d in range(at.draws):
        batch.weighted[d], batch.total[d] = 0, float(request.particles)


@compiled
def _choose_particles(at, t):
    """Draw noise, and copy the states of the truth and of a particle for each replicate.

    These are at equal distances from a random one on: particles are sorted by their ancestors.
    """
    request, batch, own = at.work.request, at.work.batch, at.work.rule.replicates
    for c in range(own.components):
        row = VariateRow(
            batch.words, ahead(own.noise, c * (own.row + SPARE)), _SEEN, own.kinds[c],
            Key(at.stream, request.start + t, TRUTH_MEASUREMENT, c),
            request.first_draw + at.first, at.draws,
        )  # fmt: skip
        call(at.work.scratch.fill, row)
    cloud, uniform = present(at), ahead(own.noise, (own.components - 1) * (own.row + SPARE))
    for d in range(at.draws):
        for i in range(_SEEN):
            chosen = np.int64(0)
            if 0 < i <= REPLICATES:
                share = (i - 1 + np.float64(uniform[d * _SEEN])) / REPLICATES
                chosen = np.int64(share * request.particles)
            for c in range(request.states):
                value = cloud[c * batch.stride + d * batch.width + chosen]
                own.states[c * own.row + d * _SEEN + i] = value


@compiled
def _measure(at, t, sensor):
    """Fill rows with the true measurement of each draw, and its replicates."""
    request, own = at.work.request, at.work.rule.replicates
    noise = ahead(own.noise, own.first_noises[sensor] * (own.row + SPARE))
    call_block(
        own, (MEASUREMENT + sensor) * request.instants + t, (own.values, own.row),
        (own.states, own.row), (noise, own.row + SPARE), (noise, 0, 0), (1, at.draws * _SEEN),
    )  # fmt: skip
    first = request.first_components[sensor]
    is_last = sensor + 1 == request.sensors
    end = request.measurements if is_last else request.first_components[sensor + 1]
    y = sensors_at(at, t, first)
    for d in range(at.draws):
        for c in range(end - first):
            true = y[d * request.instants * request.measurements + c]
            own.values[c * own.row + d * _SEEN] = true


@compiled
def _weigh_by(at, t, sensor, replicate):
    """Fill rows of draws with the variance of z after a replicate of a measurement."""
    request, batch, own = at.work.request, at.work.batch, at.work.rule.replicates
    y, mean = ahead(own.values, replicate), batch.moments
    with_given(at, SENSORS + sensor, t, present(at), batch.log_weight, y, _SEEN, own.row)
    for d in range(at.draws):
        batch.weighted[d], batch.total[d] = 1, weigh(
            batch.log_weight, d * batch.width, batch.width, request.particles, batch.weight,
            batch.cumulative,
        )  # fmt: skip
    fill_mean_of_z(at, t, mean)
    fill_variances(at, t, mean, ahead(mean, request.quantities * batch.row))
