"""The filter that moves its particles, compiled: one draw at a time.

A line is the noise of a particle from the start on; its path follows from it. At a measurement the
likelihood enters by exponents that grow to 1, each as large as keeps half of the particles
effective. After each, all lines are resampled, and moved by Metropolis steps that keep the law of
the lines given all measurements so far. So no component of x is only copied.

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
Gilks, Berzuini, "Following a moving target: Monte Carlo inference for dynamic Bayesian models",
Journal of the Royal Statistical Society B 63, 2001. Chopin, "A sequential particle filter method
for static models", Biometrika 89, 2002. Del Moral, Doucet, Jasra, "Sequential Monte Carlo
samplers", Journal of the Royal Statistical Society B 68, 2006. Cotter, Roberts, Stuart, White,
"MCMC methods for functions: modifying old algorithms to make them faster", Statistical Science 28,
2013 (autoregressive steps).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.kernels import lines
from pfdist.kernels.ancestors import Drawn, Search, sum_of_squares, take_ancestors, weigh
from pfdist.kernels.batch import (
    INITIAL,
    INITIAL_NOISE,
    PROCESS_NOISE,
    SENSORS,
    TRANSITION,
    At,
    Instant,
    Slot,
    add_error,
    copy_numbers,
    present,
    record_sizes,
    sensors_at,
    with_given,
)
from pfdist.kernels.blocks import call_block
from pfdist.kernels.cached import compiled, entry
from pfdist.kernels.deciding import is_measured
from pfdist.kernels.filter import begin_sums
from pfdist.kernels.log_evidence import fill_logarithms
from pfdist.kernels.memory import ahead, call, placing, read
from pfdist.kernels.variates import CENTRED, EXPONENTIAL, NORMAL, UNIFORM, Key, VariateRow
from pfdist.moving.moves import INDEPENDENT, SUM, WALK, derived

MOVED, ACCEPTED, PLACED = np.arange(8, 11)
"""Roles of the noise of moves; see `pfdist.kernels.variates`."""

EFFECTIVE = 0.5
"""Share of the particles that an exponent keeps effective."""
HALVINGS, BISECTIONS, MOST = np.int64(100), np.int64(10), np.int64(300)
"""Steps of the search for an exponent, and exponents of a measurement, at most."""
LEAST = 1e-14  # variance that a cloud has at least, in units of noise
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


_own = placing(Moving)


class _Measurement(NamedTuple):
    """A measurement whose likelihood counts by a power."""

    at: At
    t: np.int64
    stream: np.uint64  # key of its moves after an exponent
    power: float
    sensor: np.int64


# --- the filter's steps ---------------------------------------------------------------------------


@entry(Instant)
def begin(instant):
    """Begin a set, with the initial noise of lines, or with lines that it continues."""
    instant = read(instant)
    own = _own(instant.at.work.own)
    if own.until >= 0:
        _continue_lines(instant.at)
        return
    call(own.begin, instant)
    own.now[0], own.now[1], own.now[2], own.now[3] = 0, 0, -1, 0
    _note_step(instant.at, np.int64(0), own.components)


@compiled
def _continue_lines(at):
    """Take the lines of another filter, of which each particle has one."""
    request, batch, own = at.work.request, at.work.batch, _own(at.work.own)
    begin_sums(at)
    place = (at.number * request.draws + at.first) * request.particles
    chosen = ahead(request.chosen, place)
    steps = own.until + 1
    for i in range(batch.width):
        column = chosen[i if i < request.particles else 0]
        for c in range(request.states):
            own.path[c * batch.stride + i] = own.carried_states[c * own.columns + column]
        for step in range(steps):
            noise = _noise(at, own.noise, step)
            for c in range(request.components):
                row = (step * request.components + c) * own.columns
                noise[c * batch.spacious + i] = own.carried_noise[row + column]
    own.now[0], own.now[1], own.now[2], own.now[3] = own.until, 0, -1, 0
    for t in range(steps):
        if t > 0:
            _go(at, t, own.path, own.path, own.noise)
        for sensor in range(request.sensors):
            if own.carried_counts[t * request.sensors + sensor] != 0:
                _note_instant(own, t)
                known = ahead(own.known, own.now[1] * batch.stride)
                _fill_likelihood(at, t, sensor, _path(at, own.path, t), known)
                _note_event(own, t, sensor)
    count = request.states * batch.stride
    copy_numbers(_path(at, own.path, own.until), present(at), count)


@compiled
def _note_event(own, t, sensor):
    place = own.now[1]
    own.event[2 * place], own.event[2 * place + 1] = t, sensor
    own.now[1] += 1


@entry(Instant)
def move(instant):
    """Propagate, and keep noise and states; lines that are continued are already there."""
    instant = read(instant)
    own = _own(instant.at.work.own)
    if own.now[0] >= instant.t:
        return
    call(own.move, instant)
    instant.at.work.results.work[0] += instant.at.work.request.particles
    _note_step(instant.at, instant.t, own.process)


@compiled
def _note_step(at, t, count):
    own, request, batch = _own(at.work.own), at.work.request, at.work.batch
    copy_numbers(batch.noise, _noise(at, own.noise, t), count * batch.spacious)
    copy_numbers(present(at), _path(at, own.path, t), request.states * batch.stride)
    own.now[0] = t


@entry(Slot)
def save(place):
    """Save the lines, because a later set resumes from them."""
    slot = read(place)
    call(_own(slot.at.work.own).save, slot)
    _copy_lines(slot, True)


@entry(Slot)
def resume(place):
    """Take saved lines, or those that the filter continues, and compute their paths again."""
    slot = read(place)
    own = _own(slot.at.work.own)
    if slot.slot < 0:
        _continue_lines(slot.at)
        return
    call(own.resume, slot)
    _copy_lines(slot, False)
    for t in range(1, own.now[0] + 1):
        _go(slot.at, t, own.path, own.path, own.noise)


@compiled
def _copy_lines(slot, saves):
    """Copy lines to a slot, or from it."""
    at, number = slot
    own, batch, kept, request = _own(at.work.own), at.work.batch, at.work.lines, at.work.request
    step = request.components * batch.spacious
    means = kept.rows * batch.row if request.lag > 0 else np.int64(0)
    _copy(own.now, ahead(own.saved_now, 4 * number), np.int64(4), saves)
    steps, events = own.now[0] + 1, own.now[1]
    first = number * request.instants
    _copy(own.noise, ahead(own.saved_noise, first * step), steps * step, saves)
    states = request.states * batch.stride
    _copy(own.path, ahead(own.saved_states, number * states), states, saves)
    _copy(kept.means, ahead(own.saved_means, first * means), steps * means, saves)
    first = number * own.events
    known = ahead(own.saved_known, first * batch.stride)
    _copy(own.known, known, events * batch.stride, saves)
    _copy(own.event, ahead(own.saved_event, 2 * first), 2 * events, saves)


@compiled
def _copy(values, saved, count, saves):
    if saves:
        copy_numbers(values, saved, count)
    else:
        copy_numbers(saved, values, count)


@entry(Instant)
def estimate_lines(instant):
    """Keep the mean of z; behind a measurement, also at the earlier instants that it tells of."""
    at, _, t, sensors, _ = read(instant)
    own = _own(at.work.own)
    lines.keep_means(at, t, present(at))
    if sensors == 0:
        return
    first, results = at.work.request.first_smoothed[t], at.work.results
    for earlier in range(first, t):
        lines.keep_means(at, earlier, _path(at, own.path, earlier))
    if at.work.wanted.moments:
        record_sizes(at, t)
        for earlier in range(first, t + 1):
            place = at.first * at.work.request.instants + earlier
            results.lines[place] = at.work.request.particles


@entry(Instant)
def finish_lines(instant):
    """Add the errors of the smoothed estimates, and write the results of a set."""
    instant = read(instant)
    at, kept = instant.at, instant.at.work.lines
    end = at.work.plan.ends[instant.s]
    copy_numbers(kept.means, kept.smoothed, end * kept.rows * at.work.batch.row)
    lines.add_errors(at, instant.s)
    call(_own(at.work.own).finish, instant)


@entry(Instant)
def measure(instant):
    """Let the likelihood of a measurement enter by exponents, with moves behind each.

    If no particle explains it, the draw is degenerate, and the measurement is left out.
    """
    at, s, t, _, sensor = read(instant)
    request, batch, own = at.work.request, at.work.batch, _own(at.work.own)
    if not is_measured(at, t, 0):
        return
    _fill_likelihood(at, t, sensor, _path(at, own.path, t), own.likelihood)
    possible = np.int64(0)
    for i in range(request.particles):
        possible += np.isfinite(own.likelihood[i])
    batch.weighs[0] = possible > 0
    information = request.weights.evidence
    if possible == 0:
        if batch.error[0] < np.inf:
            batch.degenerate[0] = 1
        if information != 0.0:
            add_error(at, s, t, 0, information * -np.inf, request.instant_weights[t])
        return
    _note_instant(own, t)
    evidence = _temper(at, t, sensor, possible < request.particles)
    count = batch.stride
    copy_numbers(own.likelihood, ahead(own.known, own.now[1] * count), count)
    _note_event(own, t, sensor)
    copy_numbers(_path(at, own.path, t), present(at), request.states * count)
    for i in range(batch.width):
        batch.weight[i] = np.float32(1.0 if i < request.particles else 0.0)
    batch.weighted[0], batch.total[0] = 0, float(request.particles)
    if information != 0.0:
        add_error(at, s, t, 0, information * evidence, request.instant_weights[t])
    if own.keeps:
        at.work.results.log_likelihoods[at.first * request.instants + t] += evidence


@entry(Instant)
def keep_lines(instant):
    """Write the particles and their lines."""
    instant = read(instant)
    at = instant.at
    request, batch, own, results = (
        at.work.request, at.work.batch, _own(at.work.own), at.work.results,
    )  # fmt: skip
    call(own.keep, instant)
    if not own.keeps:
        return
    steps, particles = own.now[0] + 1, request.particles
    for step in range(steps):
        noise = _noise(at, own.noise, step)
        for c in range(request.components):
            row = ((at.first * request.instants + step) * request.components + c) * particles
            for i in range(particles):
                results.noise[row + i] = noise[c * batch.spacious + i]
    for c in range(request.states):
        row = (at.first * request.states + c) * particles
        for i in range(particles):
            results.first_states[row + i] = own.path[c * batch.stride + i]
    for event in range(own.now[1]):
        row = at.first * request.instants + own.event[2 * event]
        results.counts[row * request.sensors + own.event[2 * event + 1]] = 1


@compiled
def _note_instant(own, t):
    """Note the last instant with an event before this one, and the number of such instants."""
    last = own.event[2 * own.now[1] - 2] if own.now[1] > 0 else np.int64(-1)
    if own.now[2] < last < t:
        own.now[2] = last
        own.now[3] += 1


# --- exponents ------------------------------------------------------------------------------------


@compiled
def _temper(at, t, sensor, drops):
    """Let a likelihood enter; returns its log evidence.

    `drops` says whether some particles do not explain the measurement: these go first.
    """
    request, own = at.work.request, _own(at.work.own)
    point = (request.start + t) * request.sensors + sensor
    stream, power, evidence, number = derived(at.stream, point), 0.0, 0.0, np.int64(0)
    while drops or power < 1.0:
        exponent = 0.0
        if not drops:
            exponent = _exponent(at, 1.0 - power) if number < MOST else 1.0 - power
        total = _weigh(at, exponent)
        if request.weights.evidence != 0.0 or own.keeps:
            highest = -np.inf
            for i in range(request.particles):
                if highest < own.likelihood[i] < np.inf:
                    highest = own.likelihood[i]
            at.work.batch.total[0] = total
            fill_logarithms(at)
            information = at.work.batch.distance[0] - request.log_particles
            evidence += exponent * highest + information
        power = 1.0 if not drops and exponent == 1.0 - power else power + exponent
        drops = False
        key = derived(stream, number)
        _fill_moments(at, total)
        _resample(at, derived(key, 0))
        for k in range(own.moves):
            _move(_Measurement(at, t, derived(key, k + 1), power, sensor), k)
        number += 1
    return evidence


@compiled
def _weigh(at, exponent):
    """Weights by a power of the likelihood, of particles that explain the measurement."""
    request, batch, own = at.work.request, at.work.batch, _own(at.work.own)
    for i in range(batch.width):
        value = own.likelihood[i]
        batch.log_weight[i] = exponent * value if np.isfinite(value) else -np.inf
    return weigh(
        batch.log_weight, np.int64(0), batch.width, request.particles, batch.weight,
        batch.cumulative,
    )  # fmt: skip


@compiled
def _is_effective(at, exponent):
    total, batch = _weigh(at, exponent), at.work.batch
    squares = sum_of_squares(batch.weight, np.int64(0), batch.width)
    return total * total >= EFFECTIVE * at.work.request.particles * squares


@compiled
def _exponent(at, most):
    """The largest exponent, to three digits, that keeps half of the particles effective."""
    if _is_effective(at, most):
        return most
    low = 0.5 * most
    for _ in range(HALVINGS):
        if _is_effective(at, low):
            break
        low *= 0.5
    high = 2.0 * low
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        if _is_effective(at, middle):
            low = middle
        else:
            high = middle
    return low


@compiled
def _fill_moments(at, total):
    """Mean of the weighted initial noise, and the root of the covariance of what is normal."""
    request, batch, own = at.work.request, at.work.batch, _own(at.work.own)
    count = own.components
    for a in range(count):
        values, mean = ahead(own.noise, a * batch.spacious), 0.0
        for i in range(request.particles):
            mean += np.float64(batch.weight[i]) * np.float64(values[i])
        own.mean[a] = mean / total
    for a in range(count):
        first = ahead(own.noise, a * batch.spacious)
        for b in range(a + 1):
            second, product = ahead(own.noise, b * batch.spacious), 0.0
            if a == b or (request.kinds[a] == NORMAL and request.kinds[b] == NORMAL):
                for i in range(request.particles):
                    deviation = np.float64(first[i]) - own.mean[a]
                    other = np.float64(second[i]) - own.mean[b]
                    product += np.float64(batch.weight[i]) * deviation * other
            rest = product / total
            for c in range(b):
                rest -= own.root[a * count + c] * own.root[b * count + c]
            if a == b:
                own.root[a * count + a] = np.sqrt(max(rest, 0.0) + LEAST)
            else:
                own.root[a * count + b] = rest / own.root[b * count + b]


@compiled
def _resample(at, stream):
    """Resample all lines."""
    request, batch, own = at.work.request, at.work.batch, _own(at.work.own)
    batch.resamples[0] = 1
    first = request.first_draw + at.first
    drawn = Drawn(stream, np.int64(0), first, np.int64(1), batch.width, request.particles)
    search = Search(batch.cumulative, batch.resamples, np.int64(0), drawn, at.work.scratch)
    call(at.work.steps.scheme, search)
    for step in range(own.now[0] + 1):
        for c in range(own.components if step == 0 else own.process):
            values = ahead(_noise(at, own.noise, step), c * batch.spacious)
            copy_numbers(values, own.single, batch.width)
            take_ancestors(at.work.scratch, own.single, values, np.int64(0), batch.width)
    _take(at, own.path, (own.now[0] + 1) * request.states)
    _take(at, own.known, own.now[1])
    _take(at, own.likelihood, np.int64(1))


@compiled
def _take(at, rows, count):
    """Let the entries of rows be those of ancestors."""
    batch, own = at.work.batch, _own(at.work.own)
    for number in range(count):
        values = ahead(rows, number * batch.stride)
        copy_numbers(values, own.row, batch.width)
        take_ancestors(at.work.scratch, own.row, values, np.int64(0), batch.width)


# --- moves ----------------------------------------------------------------------------------------


@compiled
def _move(measurement, k):
    """Propose noise, compute paths from where it changes, and accept or not."""
    at, t, stream, _, _ = measurement
    own, batch = _own(at.work.own), at.work.batch
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
            _go(at, step, source, own.tried_path, own.tried if step <= last else own.noise)
    _judge(measurement, first, last)


@compiled
def _noise(at, rows, step):
    return ahead(rows, step * at.work.request.components * at.work.batch.spacious)


@compiled
def _path(at, rows, step):
    return ahead(rows, step * at.work.request.states * at.work.batch.stride)


@compiled
def _go(at, step, source, target, noise):
    """Fill in the states behind a step; the arguments are rows of all steps."""
    request, batch = at.work.request, at.work.batch
    block, before = (TRANSITION, step - 1) if step > 0 else (INITIAL, step)
    at.work.results.work[0] += request.particles
    call_block(
        at.work.blocks,
        block * request.instants + before,
        (_path(at, target, step), batch.stride),
        (_path(at, source, before), batch.stride),
        (_noise(at, noise, step), batch.spacious),
        (batch.means, 0, 0),
        (1, batch.width),
    )


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
    request, batch, own = at.work.request, at.work.batch, _own(at.work.own)
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
    request, batch, own = at.work.request, at.work.batch, _own(at.work.own)
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
    batch, own = at.work.batch, _own(at.work.own)
    count = own.process
    _go(at, np.int64(0), own.tried_path, own.tried_path, own.tried)
    for step in range(1, t + 1):
        _go(at, step, own.tried_path, own.tried_path, own.noise)
        there, here = _path(at, own.path, step), _path(at, own.tried_path, step)
        old, new = _noise(at, own.noise, step), _noise(at, own.tried, step)
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
        _go(at, step, own.tried_path, own.tried_path, own.tried)


@compiled
def _stretch(at, t, stream, k):
    """The first and the last step that a move of process noise changes; none if first > last."""
    own = _own(at.work.own)
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
    request, batch, own = at.work.request, at.work.batch, _own(at.work.own)
    cosine, steps = np.sqrt(1.0 - sine * sine), last - first + 1
    for step in range(first, last + 1):
        _fill_noise(at, stream, step, own.process, _noise(at, own.tried, step))
    for c in range(own.process):
        kind = request.kinds[PROCESS_NOISE * request.components + c]
        for i in range(batch.width):
            place, old_mean, new_mean = c * batch.spacious + i, 0.0, 0.0
            if keeps_sum and kind == NORMAL:
                for step in range(first, last + 1):
                    old_mean += np.float64(_noise(at, own.noise, step)[place])
                    new_mean += np.float64(_noise(at, own.tried, step)[place])
            old_mean, new_mean = old_mean / steps, new_mean / steps
            for step in range(first, last + 1):
                old = np.float64(_noise(at, own.noise, step)[place])
                new = _noise(at, own.tried, step)
                drawn = sine * (np.float64(new[place]) - new_mean)
                if kind == NORMAL:
                    new[place] = np.float32(old_mean + cosine * (old - old_mean) + drawn)
                else:
                    new[place] = np.float32(_on_circle(old + drawn, kind))


@compiled
def _fill_likelihood(at, t, sensor, cloud, target):
    """Log-likelihoods of a sensor's measurement."""
    request = at.work.request
    y = sensors_at(at, t, request.first_components[sensor])
    of_draw = request.instants * request.measurements
    with_given(at, SENSORS + sensor, t, cloud, target, y, of_draw, 1)


@compiled
def _judge(measurement, first, last):
    """Accept the proposals by all likelihoods so far, and take what is accepted."""
    at, t, stream, power, sensor = measurement
    request, batch, own = at.work.request, at.work.batch, _own(at.work.own)
    earliest = own.now[1]
    while earliest > 0 and own.event[2 * earliest - 2] >= first:
        earliest -= 1
    for event in range(earliest, own.now[1]):
        when, tried = own.event[2 * event], ahead(own.tried_known, event * batch.stride)
        cloud = _path(at, own.tried_path, when)
        _fill_likelihood(at, when, own.event[2 * event + 1], cloud, tried)
        known = ahead(own.known, event * batch.stride)
        for i in range(batch.width):
            own.ratio[i] += tried[i] - known[i]
    _fill_likelihood(at, t, sensor, _path(at, own.tried_path, t), own.tried_likelihood)
    _fill(at, Key(stream, np.int64(0), ACCEPTED, 0), EXPONENTIAL, own.single)
    for i in range(batch.width):
        new = own.tried_likelihood[i]
        own.ratio[i] += power * (new - own.likelihood[i])
        is_better = -np.float64(own.single[i]) < own.ratio[i] < np.inf
        own.row[i] = 1.0 if is_better and np.isfinite(new) else 0.0
    for step in range(first, last + 1):
        count = (own.components if step == 0 else own.process) * batch.spacious
        old, new = _noise(at, own.noise, step), _noise(at, own.tried, step)
        for c in range(np.int64(0), count, batch.spacious):
            _accept(own, ahead(old, c), ahead(new, c), batch.width)
    for step in range(first, t + 1):
        old, new = _path(at, own.path, step), _path(at, own.tried_path, step)
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
