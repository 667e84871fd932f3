"""The moves of lines: Metropolis steps that keep their law, given all measurements so far.

A line is the noise of a particle from the start on; its path follows from it.

============= ==================================================================================
move          what is proposed
============= ==================================================================================
WALK          initial noise: a normal step with the covariance of the cloud
INDEPENDENT   initial noise: independent, from the normal law of the cloud
GAP           process noise since the last measurement: an autoregressive step
SUM           process noise of some successive steps: the same, but their sum stays
============= ==================================================================================

Where process noise enters additively, the first move also changes it so that the components that it
drives stay where they were. Uniform noise takes steps on a circle.

References
----------
Cotter, Roberts, Stuart, White, "MCMC methods for functions: modifying old algorithms to make them
faster", Statistical Science 28, 2013 (autoregressive steps).
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.kernels.batch import (
    INITIAL,
    INITIAL_NOISE,
    PROCESS_NOISE,
    SENSORS,
    TRANSITION,
    At,
    sensors_at,
    with_given,
)
from pfdist.kernels.blocks import call_block
from pfdist.kernels.cached import compiled
from pfdist.kernels.memory import ahead, call, placing
from pfdist.kernels.variates import CENTRED, EXPONENTIAL, NORMAL, UNIFORM, Key, VariateRow

WALK, INDEPENDENT, GAP, SUM = np.arange(4)
"""Kinds of moves."""


class Move(NamedTuple):
    """A move of lines."""

    kind: np.signedinteger
    # in deviations of the cloud; of process noise, the sine of an autoregressive step
    scale: float
    span: float = 0.0  # of SUM: number of steps, in mean gaps between measurements


OF_CONSTANTS: Final = (
    Move(WALK, 1.0), Move(INDEPENDENT, 1.1), Move(WALK, 0.4), Move(INDEPENDENT, 1.1),
)  # fmt: skip
"""The moves of a model without process noise."""

OF_PATHS: Final = (
    Move(INDEPENDENT, 1.1), Move(SUM, 0.9, 1.0), Move(GAP, 0.5), Move(WALK, 0.4),
    Move(SUM, 0.6, 2.0), Move(INDEPENDENT, 1.1), Move(SUM, 0.9, 0.75), Move(GAP, 0.15),
)  # fmt: skip
"""The moves of a model with process noise. The first keeps the path, if noise is additive."""

MOVED, ACCEPTED, PLACED = np.arange(8, 11)
"""Roles of the noise of moves; see `pfdist.kernels.variates`."""

WALKED = 2.38  # of the best scale of a walk: over the root of the number of components
STEP = 0.4  # likewise, of uniform noise beside an independent proposal
INSIDE = 2.0**-24


class Moving(NamedTuple):
    """The lines of a draw; a row has an entry for each particle.

    Step 0 leads to x(0), and step t from x(t - 1) to x(t). An event is a measurement that some
    particle explains.
    """

    # addresses of the steps that these here extend
    begin: int
    move: int
    save: int
    resume: int
    finish: int
    moves: int  # after each exponent
    kind: NDArray[np.int64]  # (moves,)
    scale: NDArray[np.float64]  # (moves,)
    span: NDArray[np.float64]  # (moves,)
    components: int  # of the initial noise
    process: int  # of the process noise
    # (process,): the components of x that are kept where they were; see `Gains`
    driven: NDArray[np.int64]
    inverse: NDArray[np.float64]  # (T, process, process): from their changes to those of noise
    keeps_path: bool
    # (4,): the present instant, the number of events, the instant of the last event before the
    # present one, or -1, and the number of instants with events before the present one
    now: NDArray[np.int64]
    event: NDArray[np.int64]  # (events, 2): instant and sensor
    noise: NDArray[np.float32]  # (steps, components, spacious)
    tried: NDArray[np.float32]  # the same of a move
    path: NDArray[np.float64]  # (steps, n, stride): x behind each step
    tried_path: NDArray[np.float64]
    known: NDArray[np.float64]  # (events, stride): log-likelihood of each event
    tried_known: NDArray[np.float64]
    likelihood: NDArray[np.float64]  # (stride,): log-likelihood of the present measurement
    tried_likelihood: NDArray[np.float64]
    ratio: NDArray[np.float64]  # (stride,): log density, new less old
    row: NDArray[np.float64]  # (stride,)
    single: NDArray[np.float32]  # (spacious,)
    normals: NDArray[np.float32]  # (components, spacious)
    solved: NDArray[np.float64]  # (components, stride)
    mean: NDArray[np.float64]  # (components,): of the cloud's initial noise
    root: NDArray[np.float64]  # (components, components): of its covariance; lower triangle
    # lines that the filter continues: of M particles until an instant, or -1
    until: int
    columns: int  # M
    carried_noise: NDArray[np.float32]  # (until + 1, components, M)
    carried_states: NDArray[np.float64]  # (n, M)
    carried_counts: NDArray[np.uint8]  # (until + 1, sensors)
    keeps: bool  # whether the results have the lines
    keep: int  # address of the step that this one extends
    # saved lines, for each slot
    events: int  # the most
    saved_noise: NDArray[np.float32]
    saved_states: NDArray[np.float64]  # the first ones
    saved_known: NDArray[np.float64]
    saved_event: NDArray[np.int64]
    saved_now: NDArray[np.int64]
    saved_means: NDArray[np.float64]  # of `Lines`


lines_at = placing(Moving)


class Powered(NamedTuple):
    """A measurement whose likelihood counts by a power."""

    at: At
    t: np.int64
    stream: np.uint64  # key of its moves after an exponent
    power: float
    sensor: np.int64


@compiled
def derived(key, number):
    """A key that is made from another one and a number."""
    mixed = np.uint64(key) + (np.uint64(number) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return mixed ^ (mixed >> np.uint64(31))


@compiled
def noise_behind(at, rows, step):
    """The noise of a step, from rows of all steps."""
    return ahead(rows, step * at.work.request.components * at.work.batch.spacious)


@compiled
def states_behind(at, rows, step):
    """The states behind a step, from rows of all steps."""
    return ahead(rows, step * at.work.request.states * at.work.batch.stride)


@compiled
def go(at, step, source, target, noise):
    """Fill in the states behind a step; the arguments are rows of all steps."""
    request, batch = at.work.request, at.work.batch
    block, before = (TRANSITION, step - 1) if step > 0 else (INITIAL, step)
    at.work.results.work[0] += request.particles
    call_block(
        at.work.blocks,
        block * request.instants + before,
        (states_behind(at, target, step), batch.stride),
        (states_behind(at, source, before), batch.stride),
        (noise_behind(at, noise, step), batch.spacious),
        (batch.means, 0, 0),
        (1, batch.width),
    )


@compiled
def fill_likelihood(at, t, sensor, cloud, target):
    """Log-likelihoods of a sensor's measurement."""
    request = at.work.request
    y = sensors_at(at, t, request.first_components[sensor])
    of_draw = request.instants * request.measurements
    with_given(at, SENSORS + sensor, t, cloud, target, y, of_draw, 1)


@compiled
def move_lines(measurement, k):
    """Propose noise, compute paths from where it changes, and accept or not."""
    at, t, stream, _, _ = measurement
    own, batch = lines_at(at.work.own), at.work.batch
    kind, first, last = own.kind[k], np.int64(0), np.int64(0)  # the steps that change
    for i in range(batch.width):
        own.ratio[i] = 0.0
    if kind in (WALK, INDEPENDENT):
        if own.components == 0:
            return
        _propose_initial(at, stream, kind, own.scale[k])
        if k == 0 and own.keeps_path and t > 0:
            last = t
            _keep_path(at, t)
    else:
        first, last = _stretch(at, t, stream, k)
        if first > last:
            return
        _propose_process(at, stream, first, last, own.scale[k], kind == SUM)
    if kind > INDEPENDENT or last == 0:
        for step in range(first, t + 1):
            source = own.tried_path if step > first else own.path
            go(at, step, source, own.tried_path, own.tried if step <= last else own.noise)
    _judge(measurement, first, last)


@compiled
def _fill(at, key, kind, row):
    """Fill a row with a variate for each particle."""
    first, batch = at.work.request.first_draw + at.first, at.work.batch
    given = VariateRow(batch.words, row, batch.width, kind, key, first, np.int64(1))
    call(at.work.scratch.fill, given)


@compiled
def _fill_noise(at, stream, step, count, rows):
    """Fill in the noise of a move's proposal for a step: normal, or in -1/2..1/2."""
    request, batch = at.work.request, at.work.batch
    process = PROCESS_NOISE if step > 0 else INITIAL_NOISE
    for c in range(count):
        is_normal = request.kinds[process * request.components + c] == NORMAL
        kind = NORMAL if is_normal else CENTRED
        _fill(at, Key(stream, step, MOVED, c), kind, ahead(rows, c * batch.spacious))


@compiled
def _on_circle(value, kind):
    """Uniform or centred noise behind a step on the circle."""
    if kind == UNIFORM:
        return min(max(value - np.floor(value), INSIDE), 1.0 - INSIDE)
    return value - np.rint(value)


@compiled
def _propose_initial(at, stream, kind, scale):
    """Fill in initial noise, and the logarithm of its density, less that of the old."""
    request, batch, own = at.work.request, at.work.batch, lines_at(at.work.own)
    count = own.components
    _fill_noise(at, stream, np.int64(0), count, own.normals)
    walked = scale if kind == WALK else STEP
    for a in range(count):
        old, new = ahead(own.noise, a * batch.spacious), ahead(own.tried, a * batch.spacious)
        is_normal, root = request.kinds[a] == NORMAL, ahead(own.root, a * count)
        is_independent = kind == INDEPENDENT and is_normal
        factor = scale if is_independent else walked * WALKED / np.sqrt(float(count))
        for i in range(batch.width):
            change, before = 0.0, np.float64(old[i])
            for b in range(a + 1):
                change += root[b] * np.float64(own.normals[b * batch.spacious + i])
            value = (own.mean[a] if is_independent else before) + factor * change
            new[i] = np.float32(value if is_normal else _on_circle(value, request.kinds[a]))
            if is_normal:
                after = np.float64(new[i])
                own.ratio[i] += 0.5 * (before * before - after * after)
    if kind == INDEPENDENT:
        _add_distances(at, own.noise, -0.5 / (scale * scale))
        _add_distances(at, own.tried, 0.5 / (scale * scale))


@compiled
def _add_distances(at, noise, factor):
    """Add the squared distances of normal noise from the mean of the cloud."""
    request, batch, own = at.work.request, at.work.batch, lines_at(at.work.own)
    count = own.components
    for a in range(count):
        if request.kinds[a] != NORMAL:
            continue
        values, solved = ahead(noise, a * batch.spacious), ahead(own.solved, a * batch.stride)
        for i in range(batch.width):
            rest = np.float64(values[i]) - own.mean[a]
            for b in range(a):
                if request.kinds[b] == NORMAL:
                    rest -= own.root[a * count + b] * own.solved[b * batch.stride + i]
            solved[i] = rest / own.root[a * count + a]
            own.ratio[i] += factor * solved[i] * solved[i]


@compiled
def _keep_path(at, t):
    """Change the process noise so that the components that it drives stay where they were."""
    batch, own = at.work.batch, lines_at(at.work.own)
    count = own.process
    go(at, np.int64(0), own.tried_path, own.tried_path, own.tried)
    for step in range(1, t + 1):
        go(at, step, own.tried_path, own.tried_path, own.noise)
        there, here = states_behind(at, own.path, step), states_behind(at, own.tried_path, step)
        old, new = noise_behind(at, own.noise, step), noise_behind(at, own.tried, step)
        inverse = ahead(own.inverse, (step - 1) * count * count)
        for c in range(count):
            for i in range(batch.width):
                change, before = 0.0, np.float64(old[c * batch.spacious + i])
                for j in range(count):
                    place = own.driven[j] * batch.stride + i
                    change += inverse[c * count + j] * (there[place] - here[place])
                new[c * batch.spacious + i] = np.float32(before + change)
                after = np.float64(new[c * batch.spacious + i])
                own.ratio[i] += 0.5 * (before * before - after * after)
        go(at, step, own.tried_path, own.tried_path, own.tried)


@compiled
def _stretch(at, t, stream, k):
    """The first and the last step that a move of process noise changes; none if first > last."""
    own = lines_at(at.work.own)
    none = np.int64(1), np.int64(0)
    if t == 0 or own.process == 0:
        return none
    if own.kind[k] != SUM:
        return max(own.now[2], 0) + 1, t
    if t < 2:
        return none
    mean_gap = t / (own.now[3] + 1)
    length = min(max(np.int64(np.rint(own.span[k] * mean_gap)), np.int64(2)), t)
    _fill(at, Key(stream, np.int64(0), PLACED, 0), UNIFORM, own.single)
    first = 1 + np.int64(np.float64(own.single[0]) * (t - length + 1))
    return first, first + length - 1


@compiled
def _propose_process(at, stream, first, last, sine, keeps_sum):
    """Fill in the noise of some steps behind an autoregressive step."""
    request, batch, own = at.work.request, at.work.batch, lines_at(at.work.own)
    cosine, steps = np.sqrt(1.0 - sine * sine), last - first + 1
    for step in range(first, last + 1):
        _fill_noise(at, stream, step, own.process, noise_behind(at, own.tried, step))
    for c in range(own.process):
        kind = request.kinds[PROCESS_NOISE * request.components + c]
        for i in range(batch.width):
            place, old_mean, new_mean = c * batch.spacious + i, 0.0, 0.0
            if keeps_sum and kind == NORMAL:
                for step in range(first, last + 1):
                    old_mean += np.float64(noise_behind(at, own.noise, step)[place])
                    new_mean += np.float64(noise_behind(at, own.tried, step)[place])
            old_mean, new_mean = old_mean / steps, new_mean / steps
            for step in range(first, last + 1):
                old = np.float64(noise_behind(at, own.noise, step)[place])
                new = noise_behind(at, own.tried, step)
                drawn = sine * (np.float64(new[place]) - new_mean)
                if kind == NORMAL:
                    new[place] = np.float32(old_mean + cosine * (old - old_mean) + drawn)
                else:
                    new[place] = np.float32(_on_circle(old + drawn, kind))


@compiled
def _judge(measurement, first, last):
    """Accept the proposals by all likelihoods so far, and take what is accepted."""
    at, t, stream, power, sensor = measurement
    request, batch, own = at.work.request, at.work.batch, lines_at(at.work.own)
    earliest = own.now[1]
    while earliest > 0 and own.event[2 * earliest - 2] >= first:
        earliest -= 1
    for event in range(earliest, own.now[1]):
        when, tried = own.event[2 * event], ahead(own.tried_known, event * batch.stride)
        cloud = states_behind(at, own.tried_path, when)
        fill_likelihood(at, when, own.event[2 * event + 1], cloud, tried)
        known = ahead(own.known, event * batch.stride)
        for i in range(batch.width):
            own.ratio[i] += tried[i] - known[i]
    fill_likelihood(at, t, sensor, states_behind(at, own.tried_path, t), own.tried_likelihood)
    _fill(at, Key(stream, np.int64(0), ACCEPTED, 0), EXPONENTIAL, own.single)
    for i in range(batch.width):
        new = own.tried_likelihood[i]
        own.ratio[i] += power * (new - own.likelihood[i])
        is_better = -np.float64(own.single[i]) < own.ratio[i] < np.inf
        own.row[i] = 1.0 if is_better and np.isfinite(new) else 0.0
    for step in range(first, last + 1):
        count = (own.components if step == 0 else own.process) * batch.spacious
        old, new = noise_behind(at, own.noise, step), noise_behind(at, own.tried, step)
        for c in range(np.int64(0), count, batch.spacious):
            _accept(own, ahead(old, c), ahead(new, c), batch.width)
    for step in range(first, t + 1):
        old, new = states_behind(at, own.path, step), states_behind(at, own.tried_path, step)
        for c in range(request.states):
            _accept(own, ahead(old, c * batch.stride), ahead(new, c * batch.stride), batch.width)
    for event in range(earliest, own.now[1]):
        place = event * batch.stride
        _accept(own, ahead(own.known, place), ahead(own.tried_known, place), batch.width)
    _accept(own, own.likelihood, own.tried_likelihood, batch.width)


@compiled
def _accept(own, old, new, width):
    for i in range(width):
        old[i] = new[i] if own.row[i] > 0.0 else old[i]
