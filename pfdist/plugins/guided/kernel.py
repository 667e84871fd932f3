"""Guided filters: noise since the last measurement is redrawn when the next one is known.

`formulas.py` has the formulas. A path of g steps leads from the last measurement to the present
one; step 0 draws x(0) if there is no measurement before. It has a record for each of its
g + 1 states, and one more, with rows of particles:

====== ============= =============================================================================
rows   of the record
====== ============= =============================================================================
n      r             the state before the step r - 1
k n    r             derivatives of the k rows of the linear measurement by the state behind it
sums   r             sums over the steps from r on
k m    r             derivatives by the m normal noises of the step r; rho in the last record
====== ============= =============================================================================

So a step back reads the first parts of a record, and writes the last parts of the one before it.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.kernels.batch import (
    INITIAL,
    INITIAL_NOISE,
    PROCESS_NOISE,
    QUANTITY,
    SENSORS,
    TRANSITION,
    At,
    Instant,
    Slot,
    copy_numbers,
    fill_rows,
    is_drawn_again,
    measuring,
    other,
    present,
    sensors_at,
)
from pfdist.kernels.blocks import call_block
from pfdist.kernels.cached import compiled, entry
from pfdist.kernels.lines import quantity_at
from pfdist.kernels.memory import ahead, call, placing, read
from pfdist.kernels.prefixes import Plan
from pfdist.kernels.variates import (
    FILTER_INITIAL,
    FILTER_PROCESS,
    FILTER_PROPOSAL,
    NORMAL,
    UNIFORM,
    Key,
    VariateRow,
)

MEAN, MEAN_INITIAL, SWEPT, SWEPT_INITIAL, SEEN, AIMED, DRAWN = np.arange(7)
"""Blocks of each sensor, after those of all sensors; see `pfdist.plugins.guided.formulas.Guide`."""

BLOCKS = np.int64(7)
CHUNK = np.int64(128)
"""Number of particles that follow the path together, so that their records fit into a cache."""


def longest_gap(plan: Plan) -> int:
    """The largest number of steps from a measurement to the next, or from none to the first."""
    longest = 0
    for row in plan.measured:
        at = np.flatnonzero(row.any(axis=1))
        longest = max(longest, int(np.diff(at, prepend=-1).max(initial=0)))
    return longest


def record_rows(states: int, components: int, rows: int) -> int:
    """The number of rows of a record."""
    return states * (1 + rows) + rows * (rows + 5) // 2 + rows * max(1, components)


class Guiding(NamedTuple):
    """The paths of a batch's particles."""

    # addresses of the steps that these here extend
    save: int
    resume: int
    rows: NDArray[np.int64]  # (sensors,): of the linear measurement; 0 for a sensor without a guide
    rounds: int  # of linearisations
    record_rows: int
    # (D, T+1, components): noise of the truth's step to each instant; read only with the truth
    truth_noise: NDArray[np.float64]
    origin: NDArray[np.float64]  # (n, stride): x at the last measurement
    saved_origin: NDArray[np.float64]  # the same, for each slot
    records: NDArray[np.float64]
    noises: NDArray[np.float32]  # noise of each step of a path, and its centres
    noise: NDArray[np.float32]  # (k + 1, spacious): of the block DRAWN
    drawn: NDArray[np.float64]  # rows of the block DRAWN
    ratio: NDArray[np.float64]  # (stride,): log p(w) / q(w)


_own = placing(Guiding)


class _Path(NamedTuple):
    """The way from the last measurement to the present one, for a chunk of particles."""

    at: At
    first: np.int64  # the instant of the last measurement; -1 if the path begins with x(0)
    steps: np.int64
    k: np.int64  # rows of the linear measurement
    sums: np.int64
    block: np.int64  # the number of the sensor's first block
    draw: int | np.int64  # of the batch
    place: np.int64  # of the first particle in rows of the batch
    particles: int | np.int64


@entry(Slot)
def resume_paths(place):
    """Resume a set, with the states from which its paths begin."""
    slot = read(place)
    own, count = _own(slot.at.work.own), _numbers(slot.at)
    call(own.resume, slot)
    copy_numbers(ahead(own.saved_origin, slot.slot * count), own.origin, count)


@entry(Slot)
def save_paths(place):
    """Save the batch, with the states from which paths begin."""
    slot = read(place)
    own, count = _own(slot.at.work.own), _numbers(slot.at)
    call(own.save, slot)
    copy_numbers(own.origin, ahead(own.saved_origin, slot.slot * count), count)


@entry(Instant)
def set_out(instant):
    """Keep the states from which noise may be drawn again."""
    at = read(instant).at
    copy_numbers(present(at), _own(at.work.own).origin, _numbers(at))


@compiled
def _numbers(at):
    return at.work.request.states * at.work.batch.stride


@entry(Instant)
def add_ratio(instant):
    """Add the logarithms of the model's density of the noise, over that of the proposal."""
    at = read(instant).at
    batch, ratio = at.work.batch, _own(at.work.own).ratio
    for i in range(at.draws * batch.width):
        batch.log_weight[i] += ratio[i]


@entry(Instant)
def redraw(instant):
    """Redraw the noise since the last measurement, and move the particles accordingly."""
    instant = read(instant)
    at, request, batch = instant.at, instant.at.work.request, instant.at.work.batch
    first, k = _last_measured(instant), _own(at.work.own).rows[instant.sensor]
    block = SENSORS + request.sensors + BLOCKS * instant.sensor
    steps, sums = instant.t - first, k * (k + 5) // 2
    _fill_noises(instant, first, k)
    for d in range(at.draws):
        for begin in range(np.int64(0), batch.width, CHUNK):
            left, place = batch.width - begin, d * batch.width + begin
            particles = left if left < CHUNK else CHUNK
            _go(instant, _Path(at, first, steps, k, sums, block, d, place, particles))
    batch.half[0] = 1 - batch.half[0]


@compiled
def _last_measured(instant):
    """The instant of the last measurement, or that of the prior; -1 if there is neither."""
    request, first = instant.at.work.request, instant.t - 1
    while first >= 0 and measuring(instant.at, instant.s, first) == 0:
        first -= 1
    return first if first >= 0 or not request.has_prior else np.int64(0)


@compiled
def _go(instant, path):
    request, batch = path.at.work.request, path.at.work.batch
    source, target = ahead(present(path.at), path.place), ahead(other(path.at), path.place)
    if path.first >= 0:
        for c in range(request.states):
            x = ahead(_own(path.at.work.own).origin, c * batch.stride + path.place)
            copy_numbers(x, ahead(_record(path, np.int64(1)), c * CHUNK), path.particles)
    for number in range(_own(path.at.work.own).rounds):
        is_last = number + 1 == _own(path.at.work.own).rounds
        for step in range(path.steps):
            _step(path, MEAN, step)
        _look(instant, path)
        for step in range(path.steps - 1, -1, -1):
            _step_back(path, step)
        _draw(path, is_last)
        for step in range(path.steps):
            _steer(path, step, is_last)
    for step in range(path.steps):
        _step(path, np.int64(-1), step)
    _keep_quantities(path)
    last = _record(path, path.steps + 1)
    is_truth = request.holds_truth and path.place % batch.width == 0
    for c in range(request.states):
        row = c * batch.stride
        copy_numbers(ahead(last, c * CHUNK), ahead(target, row), path.particles)
        if is_truth:
            target[row] = source[row]
    own = _own(path.at.work.own)
    copy_numbers(ahead(own.drawn, path.k * CHUNK), ahead(own.ratio, path.place), path.particles)


@compiled
def _record(path, number):
    own = _own(path.at.work.own)
    return ahead(own.records, number * own.record_rows * CHUNK)


@compiled
def _noise(path, step):
    """The rows of noise of a step: as it was drawn, and then the centre of its normal noise."""
    request, batch = path.at.work.request, path.at.work.batch
    noises = _own(path.at.work.own).noises
    return ahead(noises, 2 * step * request.components * batch.spacious + path.place)


@compiled
def _call(path, block, t, source, target, noise):
    """Call a block for the particles; t is that of a step, -1 for the one to x(0)."""
    blocks, request, batch = (
        path.at.work.blocks,
        path.at.work.request,
        path.at.work.batch,
    )
    which = block * request.instants + (t if t > 0 else np.int64(0))
    call_block(
        blocks,
        which,
        (target, CHUNK),
        (source, CHUNK),
        (noise, batch.spacious),
        (batch.means, 0, 0),
        (1, path.particles),
    )


@compiled
def _fill_noises(instant, first, k):
    """Fill in the noise of each step, with a centre of 0, and the noise of the block DRAWN."""
    at = instant.at
    request, batch, own = at.work.request, at.work.batch, _own(at.work.own)
    for step in range(instant.t - first):
        t = first + step
        noise = ahead(own.noises, 2 * step * request.components * batch.spacious)
        if t < 0:
            fill_rows(at, INITIAL_NOISE, np.int64(0), FILTER_INITIAL, noise)
        else:
            fill_rows(at, PROCESS_NOISE, request.start + t, FILTER_PROCESS, noise)
        if request.holds_truth:
            _put_truth(at, t + 1, noise)
        count = _components(at, t) * batch.spacious
        centre = ahead(noise, count)
        for i in range(count):
            centre[i] = np.float32(0.0)
    for c in range(k + 1):
        row = VariateRow(
            batch.words, ahead(own.noise, c * batch.spacious), batch.width,
            NORMAL if c < k else UNIFORM,
            Key(at.stream, request.start + instant.t, FILTER_PROPOSAL, c),
            request.first_draw + at.first, at.draws,
        )  # fmt: skip
        call(at.work.scratch.fill, row)
    if request.holds_truth:  # the truth's noise is not drawn again
        for d in range(at.draws):
            own.noise[k * batch.spacious + d * batch.width] = 1.0


@compiled
def _components(at, t):
    request, count = at.work.request, np.int64(0)
    process = INITIAL_NOISE if t < 0 else PROCESS_NOISE
    for c in range(request.components):
        count += request.kinds[process * request.components + c] >= 0
    return count


@compiled
def _put_truth(at, t, noise):
    """Give the particle 0 of each draw the noise of the truth's step to t."""
    request, batch, own = at.work.request, at.work.batch, _own(at.work.own)
    for d in range(at.draws):
        first = ((at.first + d) * request.instants + t) * request.components
        for c in range(request.components):
            noise[c * batch.spacious + d * batch.width] = own.truth_noise[first + c]


@compiled
def _step(path, block, step):
    """Go a step of the path: by a block of the sensor, or by the model's own."""
    t = path.first + step
    if block >= 0:
        which = path.block + (MEAN_INITIAL if t < 0 else MEAN)
    else:
        which = INITIAL if t < 0 else TRANSITION
    _call(path, which, t, _record(path, step + 1), _record(path, step + 2), _noise(path, step))


@compiled
def _keep_quantities(path):
    """Keep z at the instants within the path, if lines are kept."""
    blocks, request, batch = (
        path.at.work.blocks,
        path.at.work.request,
        path.at.work.batch,
    )
    for step in range(path.steps - 1 if request.lag > 0 else 0):
        t = path.first + step + 1
        z = ahead(quantity_at(path.at, request.instants + t), path.place)
        call_block(
            blocks,
            QUANTITY * request.instants + t,
            (z, batch.stride),
            (_record(path, step + 2), CHUNK),
            (batch.noise, batch.spacious),
            (batch.means, 0, 0),
            (1, path.particles),
        )


@compiled
def _look(instant, path):
    """Fill in the linear measurement at the end of the path."""
    at, _, t, _, sensor = instant
    blocks, request, batch = at.work.blocks, at.work.request, at.work.batch
    which = (path.block + SEEN) * request.instants + t
    component = request.first_components[sensor]
    y = sensors_at(at, path.draw * request.instants + t, component)
    call_block(
        blocks,
        which,
        (ahead(_record(path, path.steps), request.states * CHUNK), CHUNK),
        (_record(path, path.steps + 1), CHUNK),
        (batch.noise, batch.spacious),
        (y, 0, 1),
        (1, path.particles),
    )


@compiled
def _step_back(path, step):
    t, states = path.first + step, path.at.work.request.states
    block = path.block + (SWEPT_INITIAL if t < 0 else SWEPT)
    back = ahead(_record(path, step), states * CHUNK)
    _call(path, block, t, _record(path, step + 1), back, _noise(path, step))


@compiled
def _draw(path, is_last):
    """Find the coefficients of the mean; last, draw those of a change, and log p(w) / q(w)."""
    request, own = path.at.work.request, _own(path.at.work.own)
    behind = request.states * (1 + path.k)
    rho = ahead(_record(path, path.steps), (behind + path.sums) * CHUNK)
    given = ahead(_record(path, np.int64(0)), (behind - path.k) * CHUNK)  # rho, and then the sums
    copy_numbers(rho, given, path.k * CHUNK)
    block = path.block + (DRAWN if is_last else AIMED)
    _call(path, block, np.int64(0), given, own.drawn, ahead(own.noise, path.place))


@compiled
def _steer(path, step, is_last):
    """Change the normal noise of a step; before the last round, fill in the centre."""
    request, batch, t = path.at.work.request, path.at.work.batch, path.first + step
    process = INITIAL_NOISE if t < 0 else PROCESS_NOISE
    normals, row = np.int64(0), np.int64(0)
    for c in range(request.components):
        normals += request.kinds[process * request.components + c] == NORMAL
    first = request.states * (1 + path.k) + path.sums
    slopes, noise = ahead(_record(path, step), first * CHUNK), _noise(path, step)
    if not is_last:
        noise = ahead(noise, _components(path.at, t) * batch.spacious)
    for c in range(request.components):
        if request.kinds[process * request.components + c] == NORMAL:
            values = ahead(noise, c * batch.spacious)
            if not is_last:
                for i in range(path.particles):
                    values[i] = np.float32(0.0)
            for j in range(path.k):
                slope = ahead(slopes, (j * normals + row) * CHUNK)
                coefficient = ahead(_own(path.at.work.own).drawn, j * CHUNK)
                for i in range(path.particles):  # a slope that is not finite has the coefficient 0
                    change = coefficient[i] * slope[i]
                    values[i] += np.float32(change if coefficient[i] != 0.0 else 0.0)
            row += 1


@entry(Instant)
def leave_out(instant):
    """Restore particles, and their paths, that were redrawn for a measurement that is left out."""
    instant = read(instant)
    if not is_drawn_again(instant):
        return
    at = instant.at
    request, batch, source, cloud = at.work.request, at.work.batch, other(at), present(at)
    for d in range(at.draws):
        if not batch.weighs[d]:
            for c in range(request.states):
                place = c * batch.stride + d * batch.width
                copy_numbers(ahead(source, place), ahead(cloud, place), batch.width)
            for t in range(_last_measured(instant) + 1, instant.t if request.lag > 0 else 0):
                for r in range(request.means):
                    place = r * batch.stride + d * batch.width
                    z = ahead(quantity_at(at, t), place)
                    redrawn = ahead(quantity_at(at, request.instants + t), place)
                    copy_numbers(z, redrawn, batch.width)
