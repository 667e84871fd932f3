"""The filter that moves its particles, compiled: one draw at a time.

A line is the noise of a particle from the start on; its path follows from it. At a measurement the
likelihood enters by exponents that grow to 1, each as large as keeps half of the particles
effective. After each, all lines are resampled and moved, see `moves.py`. So no component of x is
only copied.

References
----------
Gilks, Berzuini, "Following a moving target: Monte Carlo inference for dynamic Bayesian models",
Journal of the Royal Statistical Society B 63, 2001. Chopin, "A sequential particle filter method
for static models", Biometrika 89, 2002. Del Moral, Doucet, Jasra, "Sequential Monte Carlo
samplers", Journal of the Royal Statistical Society B 68, 2006.
"""

import numpy as np

from pfdist.kernels import lines
from pfdist.kernels.ancestors import Drawn, Search, sum_of_squares, take_ancestors, weigh
from pfdist.kernels.batch import Instant, Slot, add_error, copy_numbers, present, record_sizes
from pfdist.kernels.cached import compiled, entry
from pfdist.kernels.deciding import is_measured
from pfdist.kernels.filter import begin_sums
from pfdist.kernels.log_evidence import fill_logarithms
from pfdist.kernels.memory import ahead, call, read
from pfdist.kernels.variates import NORMAL
from pfdist.plugins.moving.moves import (
    Powered,
    derived,
    fill_likelihood,
    go,
    lines_at,
    move_lines,
    noise_behind,
    states_behind,
)

EFFECTIVE = 0.5
"""Share of the particles that an exponent keeps effective."""
HALVINGS, BISECTIONS, MOST = np.int64(100), np.int64(10), np.int64(300)
"""Steps of the search for an exponent, and exponents of a measurement, at most."""
LEAST = 1e-14  # variance that a cloud has at least, in units of noise

# --- the filter's steps ---------------------------------------------------------------------------


@entry(Instant)
def begin(instant):
    """Begin a set, with the initial noise of lines, or with lines that it continues."""
    instant = read(instant)
    own = lines_at(instant.at.work.own)
    if own.until >= 0:
        _continue_lines(instant.at)
        return
    call(own.begin, instant)
    own.now[0], own.now[1], own.now[2], own.now[3] = 0, 0, -1, 0
    _note_step(instant.at, np.int64(0), own.components)


@compiled
def _continue_lines(at):
    """Take the lines of another filter, of which each particle has one."""
    request, batch, own = at.work.request, at.work.batch, lines_at(at.work.own)
    begin_sums(at)
    place = (at.number * request.draws + at.first) * request.particles
    chosen = ahead(request.chosen, place)
    steps = own.until + 1
    for i in range(batch.width):
        column = chosen[i if i < request.particles else 0]
        for c in range(request.states):
            own.path[c * batch.stride + i] = own.carried_states[c * own.columns + column]
        for step in range(steps):
            noise = noise_behind(at, own.noise, step)
            for c in range(request.components):
                row = (step * request.components + c) * own.columns
                noise[c * batch.spacious + i] = own.carried_noise[row + column]
    own.now[0], own.now[1], own.now[2], own.now[3] = own.until, 0, -1, 0
    for t in range(steps):
        if t > 0:
            go(at, t, own.path, own.path, own.noise)
        for sensor in range(request.sensors):
            if own.carried_counts[t * request.sensors + sensor] != 0:
                _note_instant(own, t)
                known = ahead(own.known, own.now[1] * batch.stride)
                fill_likelihood(at, t, sensor, states_behind(at, own.path, t), known)
                _note_event(own, t, sensor)
    count = request.states * batch.stride
    copy_numbers(states_behind(at, own.path, own.until), present(at), count)


@compiled
def _note_event(own, t, sensor):
    place = own.now[1]
    own.event[2 * place], own.event[2 * place + 1] = t, sensor
    own.now[1] += 1


@entry(Instant)
def move(instant):
    """Propagate, and keep noise and states; lines that are continued are already there."""
    instant = read(instant)
    own = lines_at(instant.at.work.own)
    if own.now[0] >= instant.t:
        return
    call(own.move, instant)
    instant.at.work.results.work[0] += instant.at.work.request.particles
    _note_step(instant.at, instant.t, own.process)


@compiled
def _note_step(at, t, count):
    own, request, batch = lines_at(at.work.own), at.work.request, at.work.batch
    copy_numbers(batch.noise, noise_behind(at, own.noise, t), count * batch.spacious)
    copy_numbers(present(at), states_behind(at, own.path, t), request.states * batch.stride)
    own.now[0] = t


@entry(Slot)
def save(place):
    """Save the lines, because a later set resumes from them."""
    slot = read(place)
    call(lines_at(slot.at.work.own).save, slot)
    _copy_lines(slot, True)


@entry(Slot)
def resume(place):
    """Take saved lines, or those that the filter continues, and compute their paths again."""
    slot = read(place)
    own = lines_at(slot.at.work.own)
    if slot.slot < 0:
        _continue_lines(slot.at)
        return
    call(own.resume, slot)
    _copy_lines(slot, False)
    for t in range(1, own.now[0] + 1):
        go(slot.at, t, own.path, own.path, own.noise)


@compiled
def _copy_lines(slot, saves):
    """Copy lines to a slot, or from it."""
    at, number = slot
    own, batch, kept, request = lines_at(at.work.own), at.work.batch, at.work.lines, at.work.request
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
    own = lines_at(at.work.own)
    lines.keep_means(at, t, present(at))
    if sensors == 0:
        return
    first, results = at.work.request.first_smoothed[t], at.work.results
    for earlier in range(first, t):
        lines.keep_means(at, earlier, states_behind(at, own.path, earlier))
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
    call(lines_at(at.work.own).finish, instant)


@entry(Instant)
def measure(instant):
    """Let the likelihood of a measurement enter by exponents, with moves behind each.

    If no particle explains it, the draw is degenerate, and the measurement is left out.
    """
    at, s, t, _, sensor = read(instant)
    request, batch, own = at.work.request, at.work.batch, lines_at(at.work.own)
    if not is_measured(at, t, 0):
        return
    fill_likelihood(at, t, sensor, states_behind(at, own.path, t), own.likelihood)
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
    copy_numbers(states_behind(at, own.path, t), present(at), request.states * count)
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
        at.work.request, at.work.batch, lines_at(at.work.own), at.work.results,
    )  # fmt: skip
    call(own.keep, instant)
    if not own.keeps:
        return
    steps, particles = own.now[0] + 1, request.particles
    for step in range(steps):
        noise = noise_behind(at, own.noise, step)
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
    request, own = at.work.request, lines_at(at.work.own)
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
            move_lines(Powered(at, t, derived(key, k + 1), power, sensor), k)
        number += 1
    return evidence


@compiled
def _weigh(at, exponent):
    """Weights by a power of the likelihood, of particles that explain the measurement."""
    request, batch, own = at.work.request, at.work.batch, lines_at(at.work.own)
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
    request, batch, own = at.work.request, at.work.batch, lines_at(at.work.own)
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
    request, batch, own = at.work.request, at.work.batch, lines_at(at.work.own)
    batch.resamples[0] = 1
    first = request.first_draw + at.first
    drawn = Drawn(stream, np.int64(0), first, np.int64(1), batch.width, request.particles)
    search = Search(batch.cumulative, batch.resamples, np.int64(0), drawn, at.work.scratch)
    call(at.work.steps.scheme, search)
    for step in range(own.now[0] + 1):
        for c in range(own.components if step == 0 else own.process):
            values = ahead(noise_behind(at, own.noise, step), c * batch.spacious)
            copy_numbers(values, own.single, batch.width)
            take_ancestors(at.work.scratch, own.single, values, np.int64(0), batch.width)
    _take(at, own.path, (own.now[0] + 1) * request.states)
    _take(at, own.known, own.now[1])
    _take(at, own.likelihood, np.int64(1))


@compiled
def _take(at, rows, count):
    """Let the entries of rows be those of ancestors."""
    batch, own = at.work.batch, lines_at(at.work.own)
    for number in range(count):
        values = ahead(rows, number * batch.stride)
        copy_numbers(values, own.row, batch.width)
        take_ancestors(at.work.scratch, own.row, values, np.int64(0), batch.width)
