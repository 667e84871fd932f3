"""The intermittent particle filter (paper, section 2.1) for any model, compiled once a machine.

A model is a set of blocks: machine code that is called by its address, see
`pfdist.kernels.blocks`. All else is here. Several draws go through an instant in lockstep, as a
*batch*, so that a step has enough particles. No result depends on the size of a batch.

Arrays of particles are flat. Particle i of the batch's draw d is at the position ``d * width + i``,
where width is the number of particles, rounded up to whole vectors. An array with several rows has
``stride`` entries a row.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.kernels.ancestors import (
    Resampling,
    find_ancestors,
    resampling_scratch,
    sort_by_state,
    sum_of_first,
    sum_of_squares,
    sum_of_weights,
    take,
    weigh,
    weighted_sum,
)
from pfdist.kernels.blocks import Blocks, call
from pfdist.kernels.cached import entry, inlined
from pfdist.kernels.estimators import ErrorWeights
from pfdist.kernels.prefixes import Plan
from pfdist.kernels.variates import FILTER_INITIAL, FILTER_PROCESS, SPARE, fill, words_of
from pfdist.kernels.vectors import LANES

INITIAL, TRANSITION, GUIDED, QUANTITY, DEVIATIONS, ESTIMATE, ERROR, DISTANCE, LOGARITHM, SENSORS = (
    np.arange(10)  # NumPy's: Numba compiles a function anew for each integer of Python
)
"""Rows of `Blocks`: what each block computes. The last is the log-likelihood of the first sensor;
those of further sensors follow.

========== =================================== ====================================================
block      from                                to
========== =================================== ====================================================
INITIAL    noise                               x(0)
TRANSITION x, noise                            x(t + 1)
GUIDED     x, noise of the proposal, y(t + 1)  x(t + 1), and log p(w) - log q(w | x, y)
QUANTITY   x                                   z; then the sines of the components that are angles
DEVIATIONS x, mean of z                        squared deviation of each component of z
ESTIMATE   weighted means of QUANTITY          mean of z (of draws)
ERROR      z, its mean                         error of the mean (of draws)
DISTANCE   mean, variance, mean of another     squared distance of the means (of draws)
LOGARITHM  weight                              its logarithm
========== =================================== ====================================================
"""


class Request(NamedTuple):
    """Which D draws are filtered, and by which F filters; T+1 is the number of instants."""

    streams: NDArray[np.uint64]  # (F,): the key of each filter's noise
    first_draw: int  # index of the first draw in its stream
    start: int  # first instant, 0 without a prior; sets, plans and arrays count from it
    # (n, M): states of all particles of the prior
    prior: NDArray[np.float64]
    # (F, D, P): the column of the prior that each particle of each filter of each draw starts as;
    # empty if the filters start from `initial`
    chosen: NDArray[np.int64]
    # (P,): weights, if the prior is that of a filter that carries weights; else empty
    prior_weight: NDArray[np.float64]
    x: NDArray[np.float64]  # (D, T+1, n): true states; read only if the truth is a particle
    y: NDArray[np.float64]  # (D, T+1, m): measurements
    z: NDArray[np.float64]  # (D, T+1, q): true quantities of interest
    first_components: NDArray[np.int64]  # (sensors,): of y, for each sensor
    states: int  # n
    particles: int
    scheme: int  # position in `pfdist.kernels.schemes.ALL_SCHEMES`
    sorts: bool  # whether the scheme sorts the particles
    holds_truth: bool  # whether particle 0 is the truth
    guided: bool
    threshold: float  # see `pfdist.kernels.schemes.threshold_of`
    weights: ErrorWeights  # the terms of the estimator
    instant_weights: NDArray[np.float64]  # (T+1,): of each instant's error, mean 1
    # (3, most components): kinds of the components of INITIAL_NOISE, PROCESS_NOISE and
    # PROPOSAL_NOISE; -1 for none
    kinds: NDArray[np.int64]


INITIAL_NOISE, PROCESS_NOISE, PROPOSAL_NOISE = np.arange(3)


class Results(NamedTuple):
    """Arrays that the filter fills, for the U sets of the plan; those not wanted are empty."""

    mse: NDArray[np.float64]  # (D, U): errors up to the set's end, over T + 1
    # (D, U): whether no particle explains a measurement, up to the set's end. The caller fills it
    # with False.
    degenerate: NDArray[np.bool_]
    estimate: NDArray[np.float64]  # (D, T+1, q): of a single set
    variance: NDArray[np.float64]  # (D, T+1, q): of a single set
    # (U, T+1): sums over the draws of the errors of each instant that a set filters itself, not
    # those of its shared prefix. The caller fills them with 0.
    errors: NDArray[np.float64]
    # (2, D, T+1, q): of a single set whose particles contain the truth, at measured instants: the
    # share of the weight of particles whose z lies below that of the truth, and of those whose z
    # equals it
    ranks: NDArray[np.float64]
    cloud: NDArray[np.float64]  # (D, n, P): the particles of a single set after its last instant
    weight: NDArray[np.float64]  # (D, P): their weights


class Batch(NamedTuple):
    """The arrays of a batch of draws; a row has a number for each particle, or for each draw."""

    draws: int  # the most that it holds
    width: int
    # (rows, stride), of particles: two halves with the states, and a row each for the logarithms of
    # a proposal; a step reads one half and writes the other. Then follow z with cosines and sines
    # of angles, or squared deviations; log-weights; logarithms of carried weights; cumulative
    # weights.
    particles: NDArray[np.float64]
    quantity: int  # first row of z
    log_weight: int
    carried: int
    cumulative: int
    singles: NDArray[np.float32]  # (rows, stride), of particles: noise, and at last the weights
    weight: int
    # (rows, row), of draws: weighted means of z, cosines and sines; z, mean, variance, and the mean
    # of the first of two filters; squared distance; sum of the weights; sum of errors so far, which
    # is infinite for a draw that has ended
    numbers: NDArray[np.float64]
    moment: int  # first row of z
    distance: int
    total: int
    error: int
    flags: NDArray[np.bool_]  # (4, row), of draws: WEIGHTED, WEIGHS, RESAMPLES, DEGENERATE
    words: NDArray[np.uint32]  # see `pfdist.kernels.variates.words_of`
    first_means: NDArray[np.float64]  # (U, T+1, q, row) of two filters; else empty
    resampling: Resampling


FLAGS = np.arange(4)
WEIGHTED, WEIGHS, RESAMPLES, DEGENERATE = FLAGS
"""Rows of `Batch.flags`: whether weights differ, and else all are 1; whether the last measurement
of the instant gave the weights; whether the draw is resampled now; whether no particle explained a
measurement."""


class Saved(NamedTuple):
    """Batches from which later sets resume, one for each slot of the plan."""

    particles: NDArray[np.float64]  # (slots, n, stride)
    weight: NDArray[np.float32]  # (slots, stride)
    numbers: NDArray[np.float64]  # (slots, 2, row): sums of weights, and of errors
    flags: NDArray[np.bool_]  # (slots, 4, row)


class At(NamedTuple):
    """A batch, and the filter of its draws."""

    stream: int  # key of the filter's noise
    number: int  # of the filter
    first: int  # row of the batch's first draw in the arrays
    draws: int  # number of draws


@entry
def filter_draws(blocks, request, plan, results, batch, saved):
    """Filter all draws with all sets of a plan.

    Sets are innermost and in the plan's order: a set resumes from a batch that an earlier set saved
    for the same draws and filter. The filter of a set pauses at each instant before which a later
    set resumes. `here` is the first row of the half that counts.
    """
    count, sets = results.mse.shape
    for first in range(np.int64(0), count, batch.draws):
        draws = min(batch.draws, count - first)
        for number in range(request.streams.size):
            at = At(request.streams[number], number, first, draws)
            for s in range(sets):
                here, stop = np.int64(0), plan.begins[s]
                if stop > 0:
                    _resume(saved, batch, plan.sources[s])
                else:
                    _begin(blocks, request, batch, at)
                last = plan.first_stops[s + 1] - 1
                # Whether the last cloud counts, so that it is resampled after a measurement.
                goes_on = plan.slots[last] >= 0 or results.cloud.size > 0
                for k in range(plan.first_stops[s], last + 1):
                    begin, stop = stop, plan.stops[k]
                    for t in range(begin, stop):
                        resamples = goes_on or t + 1 < plan.ends[s]
                        sensors = plan.measured[s, t]
                        here = _filter_instant(
                            blocks, request, results, batch, at, here, t, s, sensors, resamples
                        )
                    if plan.slots[k] >= 0:
                        _save(saved, batch, here, plan.slots[k])
                _finish(request, plan, results, batch, at, here, s)


@inlined
def _filter_instant(blocks, request, results, batch, at, here, t, s, sensors, resamples):
    """Propagate, weight, estimate and resample; the half that then counts.

    The estimate comes before resampling, which adds noise. `sensors` has a bit for each sensor that
    measures.
    """
    if t > 0:
        here = _step(blocks, request, batch, at, here, t, sensors > 0)
    if request.holds_truth:
        for c in range(request.states):
            for d in range(at.draws):
                batch.particles[here + c, d * batch.width] = request.x[at.first + d, t, c]
    if sensors > 0:
        here = _measure(blocks, request, batch, at, here, t, sensors)
    _estimate(blocks, request, results, batch, at, here, t, s)
    if sensors > 0 and results.ranks.size > 0:
        _rank_truth(results, request, batch, at, t)
    if sensors > 0 and resamples:
        for d in range(at.draws):
            weighs = batch.flags[WEIGHS, d]
            batch.flags[RESAMPLES, d] = weighs and _is_uneven(request, batch, d)
        key = (request.start + t + 1) * request.first_components.size - 1
        here = _resample(request, batch, at, here, key)
    return here


# --- the first cloud, and steps -------------------------------------------------------------------


@inlined
def _resume(saved, batch, slot):
    """Fill the first half from a saved batch."""
    for c in range(saved.particles.shape[1]):
        _copy(saved.particles[slot, c], batch.particles[c])
    _copy(saved.weight[slot], batch.singles[batch.weight])
    _copy(saved.numbers[slot, 0], batch.numbers[batch.total])
    _copy(saved.numbers[slot, 1], batch.numbers[batch.error])
    for flag in range(len(FLAGS)):
        _copy(saved.flags[slot, flag], batch.flags[flag])


@inlined
def _save(saved, batch, here, slot):
    """Save the batch, because a later set resumes from it."""
    for c in range(saved.particles.shape[1]):
        _copy(batch.particles[here + c], saved.particles[slot, c])
    _copy(batch.singles[batch.weight], saved.weight[slot])
    _copy(batch.numbers[batch.total], saved.numbers[slot, 0])
    _copy(batch.numbers[batch.error], saved.numbers[slot, 1])
    for flag in range(len(FLAGS)):
        _copy(batch.flags[flag], saved.flags[slot, flag])


@inlined
def _copy(source, target):
    """Copy a row; Numba compiles this much faster than the assignment of a slice."""
    for i in range(source.size):
        target[i] = source[i]


@inlined
def _begin(blocks, request, batch, at):
    """Fill the first half with the prior, or with x(0)."""
    for d in range(at.draws):
        batch.numbers[batch.total, d], batch.numbers[batch.error, d] = request.particles, 0.0
        for flag in FLAGS:
            batch.flags[flag, d] = False
    if request.chosen.size > 0:
        _take_prior(request, batch, at)
        return
    _fill_noise(request, batch, at, INITIAL_NOISE, np.int64(0), FILTER_INITIAL)
    _of_particles(blocks, batch, INITIAL, np.int64(0), np.int64(0), np.int64(0), at.draws)


@inlined
def _take_prior(request, batch, at):
    states, weight = request.prior.shape[0], batch.singles[batch.weight]
    for d in range(at.draws):
        origin, chosen = d * batch.width, request.chosen[at.number, at.first + d]
        for i in range(batch.width):
            column = chosen[i if i < request.particles else 0]
            for c in range(states):
                batch.particles[c, origin + i] = request.prior[c, column]
        if request.prior_weight.size > 0:
            for i in range(batch.width):
                is_particle = i < request.particles
                weight[origin + i] = request.prior_weight[i] if is_particle else 0.0
            batch.flags[WEIGHTED, d] = True
            batch.numbers[batch.total, d] = sum_of_weights(weight, origin, batch.width)


@inlined
def _fill_noise(request, batch, at, process, t, role):
    """A row of noise for each component of a process."""
    for c in range(request.kinds.shape[1]):
        if request.kinds[process, c] >= 0:
            fill(
                batch.words, batch.singles[c], batch.width, request.kinds[process, c], at.stream,
                t, role, c, request.first_draw + at.first, at.draws,
            )  # fmt: skip


@inlined
def _of_particles(blocks, batch, block, k, source, target, draws):
    """Call a block for all particles of some draws: from rows of states and noise to other rows."""
    stride, spacious = batch.particles.shape[1], batch.singles.shape[1]
    call(
        blocks.addresses[block, k], batch.particles, target * stride, stride,
        batch.particles, source * stride, stride, batch.singles, 0, spacious,
        batch.numbers, 0, 0, 0, blocks.table, blocks.places[block, k], 1, draws * batch.width,
    )  # fmt: skip


@inlined
def _of_draws(blocks, batch, block, k, source, target):
    """Call a block for all draws: from rows of draws to other rows."""
    row = batch.numbers.shape[1]
    call(
        blocks.addresses[block, k], batch.numbers, target * row, row,
        batch.numbers, source * row, row, batch.singles, 0, 0,
        batch.numbers, 0, 0, 0, blocks.table, blocks.places[block, k], 1, row,
    )  # fmt: skip


@inlined
def _step(blocks, request, batch, at, here, t, is_measured):
    """Fill the other half with x(t), and return it; to a measurement by the proposal, if any."""
    other, before = request.states + 1 - here, request.start + t - 1
    if not (is_measured and request.guided):
        _fill_noise(request, batch, at, PROCESS_NOISE, before, FILTER_PROCESS)
        _of_particles(blocks, batch, TRANSITION, t - 1, here, other, at.draws)
        return other
    _fill_noise(request, batch, at, PROPOSAL_NOISE, before, FILTER_PROCESS)
    stride, (_, instants, components) = batch.particles.shape[1], request.y.shape
    call(
        blocks.addresses[GUIDED, t - 1], batch.particles, other * stride, stride,
        batch.particles, here * stride, stride, batch.singles, 0, batch.singles.shape[1],
        request.y, (at.first * instants + t) * components, instants * components, 1,
        blocks.table, blocks.places[GUIDED, t - 1], at.draws, batch.width,
    )  # fmt: skip
    return other


# --- measurements ---------------------------------------------------------------------------------


@inlined
def _measure(blocks, request, batch, at, here, t, sensors):
    """Weigh the particles by the sensors that measure at t, and return the half that then counts.

    The sensors weigh in their turn. In between the cloud is resampled, but not propagated. If no
    particle explains a measurement, the draw is degenerate, and the measurement is left out.
    """
    count, flags = request.first_components.size, batch.flags
    for d in range(at.draws):
        flags[WEIGHS, d] = False
    for sensor in range(count):
        if (sensors >> sensor) & 1:
            _copy(flags[WEIGHS], flags[RESAMPLES])
            key = (request.start + t) * count + sensor - 1
            here = _resample(request, batch, at, here, key)
            _fill_log_weights(blocks, request, batch, at, here, t, sensor)
            _weigh(request, batch, at)
            if request.guided and t > 0:
                _step_without(blocks, request, batch, at, here, t)
            if request.sorts:
                here = _sort(request, batch, at, here)
    return here


@inlined
def _weigh(request, batch, at):
    weight, numbers, flags = batch.singles[batch.weight], batch.numbers, batch.flags
    log_weight = batch.particles[batch.log_weight]
    cumulative = batch.particles[batch.cumulative]
    for d in range(at.draws):
        origin = d * batch.width
        total = weigh(log_weight, origin, batch.width, request.particles, weight, cumulative)
        flags[WEIGHS, d] = total > 0.0
        if total > 0.0:
            flags[WEIGHTED, d], numbers[batch.total, d] = True, total
        elif numbers[batch.error, d] < np.inf:
            flags[DEGENERATE, d] = True


@inlined
def _step_without(blocks, request, batch, at, here, t):
    """Repeat the step to t without the proposal for draws whose measurement is left out."""
    states, other = request.states, request.states + 1 - here
    fails = False
    for d in range(at.draws):
        fails |= not batch.flags[WEIGHS, d]
    if not fails:
        return
    _fill_noise(request, batch, at, PROCESS_NOISE, request.start + t - 1, FILTER_PROCESS)
    _of_particles(blocks, batch, TRANSITION, t - 1, other, batch.quantity, at.draws)
    for d in range(at.draws):
        if not batch.flags[WEIGHS, d]:
            for c in range(states):
                for i in range(d * batch.width, (d + 1) * batch.width):
                    batch.particles[here + c, i] = batch.particles[batch.quantity + c, i]


@inlined
def _fill_log_weights(blocks, request, batch, at, here, t, sensor):
    """Log-likelihoods, with the logarithms of a proposal and of carried weights."""
    stride, (_, instants, components) = batch.particles.shape[1], request.y.shape
    first = (at.first * instants + t) * components + request.first_components[sensor]
    block, used = SENSORS + sensor, at.draws * batch.width
    log_weight = batch.particles[batch.log_weight]
    call(
        blocks.addresses[block, t], batch.particles, batch.log_weight * stride, stride,
        batch.particles, here * stride, stride, batch.singles, 0, stride,
        request.y, first, instants * components, 1,
        blocks.table, blocks.places[block, t], at.draws, batch.width,
    )  # fmt: skip
    if request.guided and t > 0:
        guide = batch.particles[here + request.states]
        for i in range(used):
            log_weight[i] += guide[i]
    if request.threshold < np.inf:
        carried = batch.particles[batch.carried]
        call(
            blocks.addresses[LOGARITHM, 0], batch.particles, batch.carried * stride, stride,
            batch.particles, 0, 0, batch.singles, batch.weight * batch.singles.shape[1], 0,
            batch.numbers, 0, 0, 0, blocks.table, blocks.places[LOGARITHM, 0], 1, used,
        )  # fmt: skip
        for d in range(at.draws):
            if batch.flags[WEIGHTED, d]:
                for i in range(d * batch.width, (d + 1) * batch.width):
                    log_weight[i] += carried[i]


@inlined
def _sort(request, batch, at, here):
    """Sort the particles of each weighed draw by their state; the other half has the result."""
    other = 2 - here  # a scalar state
    for d in range(at.draws):
        sort_by_state(
            batch.particles[here], batch.particles[other], batch.singles[batch.weight],
            batch.particles[batch.cumulative], d * batch.width, batch.width, request.particles,
            batch.flags[WEIGHS, d], batch.resampling,
        )  # fmt: skip
    return other


@inlined
def _is_uneven(request, batch, d):
    """Whether the effective sample size of a draw lies below the threshold.

    Source: Kong, Liu, Wong, "Sequential imputations and Bayesian missing data problems", Journal of
    the American Statistical Association 89, 1994.
    """
    if request.threshold == np.inf:
        return True
    squares = sum_of_squares(batch.singles[batch.weight], d * batch.width, batch.width)
    return batch.numbers[batch.total, d] ** 2 < request.threshold * request.particles * squares


@inlined
def _resample(request, batch, at, here, key):
    """Resample the draws with the flag; the half that then counts."""
    some = False
    for d in range(at.draws):
        some |= batch.flags[RESAMPLES, d]
    if not some:
        return here
    other, total = request.states + 1 - here, batch.numbers[batch.total]
    find_ancestors(
        request.scheme, batch.particles[batch.cumulative], batch.flags[RESAMPLES], at.stream,
        request.first_draw + at.first, key, at.draws, batch.width, request.particles,
        batch.resampling,
    )  # fmt: skip
    for c in range(request.states):
        take(
            batch.resampling, batch.particles[here + c], batch.particles[other + c],
            at.draws, batch.width,
        )  # fmt: skip
    for d in range(at.draws):
        if batch.flags[RESAMPLES, d]:
            batch.flags[WEIGHTED, d], total[d] = False, request.particles
    return other


# --- estimates and errors -------------------------------------------------------------------------


@inlined
def _estimate(blocks, request, results, batch, at, here, t, s):
    """Estimate z(t) of each draw, and add the errors."""
    quantities, weights = request.z.shape[2], request.weights
    _of_particles(blocks, batch, QUANTITY, t, here, batch.quantity, at.draws)
    _fill_means(request, batch, at, np.int64(0), batch.moment)
    _of_draws(blocks, batch, ESTIMATE, t, np.int64(0), batch.moment + quantities)
    if weights.variance != 0.0 or weights.distance != 0.0 or results.estimate.size > 0:
        _estimate_variance(blocks, request, results, batch, at, here, t, s)
    if weights.squared_error != 0.0:
        for c in range(quantities):
            for d in range(at.draws):
                batch.numbers[batch.moment + c, d] = request.z[at.first + d, t, c]
        _of_draws(blocks, batch, ERROR, t, batch.moment, batch.distance)
        for d in range(at.draws):
            weight = request.instant_weights[t] * weights.squared_error
            _add(results, batch, s, t, d, batch.numbers[batch.distance, d], weight)
    for d in range(at.draws):
        if not batch.numbers[batch.error, d] < np.inf:
            batch.numbers[batch.error, d] = np.inf


@inlined
def _fill_means(request, batch, at, first, behind):
    """Fill rows of draws with the weighted means of the rows of z, or of squared deviations."""
    weight, total = batch.singles[batch.weight], batch.numbers[batch.total]
    for r in range(behind - first):
        values = batch.particles[batch.quantity + r]
        for d in range(at.draws):
            if batch.flags[WEIGHTED, d]:
                value = weighted_sum(weight, values, d * batch.width, batch.width)
            else:
                value = sum_of_first(values, d * batch.width, request.particles)
            batch.numbers[first + r, d] = value / total[d]


@inlined
def _estimate_variance(blocks, request, results, batch, at, here, t, s):
    """Record mean and variance, and add the part of the error that they estimate.

    Each filter contributes its variance, by the estimator's weights. The first of two filters
    stores its mean, and the second adds the distance to it, as `pfdist.filters.interface` does.
    """
    quantities, numbers, (stride, row) = (
        request.z.shape[2], batch.numbers, (batch.particles.shape[1], batch.numbers.shape[1]),
    )  # fmt: skip
    mean = batch.moment + quantities
    variance, first = mean + quantities, mean + 2 * quantities
    call(
        blocks.addresses[DEVIATIONS, t], batch.particles, batch.quantity * stride, stride,
        batch.particles, here * stride, stride, batch.singles, 0, stride,
        numbers, mean * row, 1, row,
        blocks.table, blocks.places[DEVIATIONS, t], at.draws, batch.width,
    )  # fmt: skip
    _fill_means(request, batch, at, variance, first)
    if results.estimate.size > 0:
        for d in range(at.draws):
            if numbers[batch.error, d] < np.inf:
                for c in range(quantities):
                    results.estimate[at.first + d, t, c] = numbers[mean + c, d]
                    results.variance[at.first + d, t, c] = numbers[variance + c, d]
    has_distance = batch.first_means.size > 0
    if has_distance:
        _measure_distance(blocks, batch, at, t, s, mean, first)
    for d in range(at.draws):
        error = 0.0
        if request.weights.variance != 0.0:  # else an infinite variance would make a NaN
            for c in range(variance, first):
                error += numbers[c, d]
            error *= request.weights.variance
        if has_distance and at.number > 0:
            error += request.weights.distance * numbers[batch.distance, d]
        _add(results, batch, s, t, d, error, request.instant_weights[t])


@inlined
def _measure_distance(blocks, batch, at, t, s, mean, first):
    """Keep the means of the first filter; the second measures the distance of its own to these."""
    for c in range(batch.first_means.shape[2]):
        if at.number == 0:
            _copy(batch.numbers[mean + c], batch.first_means[s, t, c])
        else:
            _copy(batch.first_means[s, t, c], batch.numbers[first + c])
    if at.number > 0:
        _of_draws(blocks, batch, DISTANCE, t, mean, batch.distance)


@inlined
def _add(results, batch, s, t, d, error, weight):
    """Add a weighted error to those of a draw that has not ended, and to the sum over draws.

    An instant of weight 0 does not count, even if its error is infinite.
    """
    if batch.numbers[batch.error, d] < np.inf and weight != 0.0:
        batch.numbers[batch.error, d] += weight * error
        if results.errors.size > 0:
            results.errors[s, t] += weight * error


@inlined
def _rank_truth(results, request, batch, at, t):
    """The place of the truth's z, which is that of particle 0, among the weighted particles."""
    for d in range(at.draws):
        origin, total = d * batch.width, batch.numbers[batch.total, d]
        for c in range(request.z.shape[2]):
            z = batch.particles[batch.quantity + c]
            below = equal = 0.0
            for i in range(origin, origin + request.particles):
                weight = batch.singles[batch.weight, i] if batch.flags[WEIGHTED, d] else 1.0
                if z[i] < z[origin]:
                    below += weight
                elif z[i] == z[origin]:
                    equal += weight
            results.ranks[0, at.first + d, t, c] = below / total
            results.ranks[1, at.first + d, t, c] = equal / total


@inlined
def _finish(request, plan, results, batch, at, here, s):
    """Write the results of a set: mean errors, degenerate draws, and clouds that are wanted."""
    for d in range(at.draws):
        row, error = at.first + d, batch.numbers[batch.error, d]
        mse = error / plan.measured.shape[1]
        results.mse[row, s] = mse if at.number == 0 else results.mse[row, s] + mse
        results.degenerate[row, s] |= batch.flags[DEGENERATE, d]
        if results.cloud.size > 0 and error < np.inf:
            for i in range(request.particles):
                place, is_weighted = d * batch.width + i, batch.flags[WEIGHTED, d]
                results.weight[row, i] = batch.singles[batch.weight, place] if is_weighted else 1.0
                for c in range(request.states):
                    results.cloud[row, c, i] = batch.particles[here + c, place]


# --- the arrays that a filter works in ------------------------------------------------------------

_TOGETHER = 2048  # particles of a batch, about: its arrays fit into a cache
_MOST_SAVED = 2**22  # numbers of all saved batches, about
_CACHE_LINE = 64  # bytes


def filter_all(
    blocks: Blocks, quantity: int, request: Request, plan: Plan, results: Results
) -> None:
    """Filter all draws, in arrays that each call makes for itself: threads filter together.

    `quantity` is the number of results of the block QUANTITY.
    """
    draws, states = results.mse.shape[0], request.states
    width = -(-request.particles // LANES) * LANES
    numbers = (states + 1) * width * max(1, plan.clouds)
    together = max(1, min(draws, _TOGETHER // width, _MOST_SAVED // numbers))
    batch, saved = _scratch(quantity, request, plan, results, width, together)
    filter_draws(blocks, request, plan, results, batch, saved)


def _scratch(
    rows: int, request: Request, plan: Plan, results: Results, width: int, draws: int
) -> tuple[Batch, Saved]:
    """The arrays of a batch of draws; `rows` is the number of results of the block QUANTITY."""
    states, quantities = request.states, request.z.shape[2]
    stride, row, noises = draws * width, -(-draws // LANES) * LANES, request.kinds.shape[1]
    quantity, distance, slots = 2 * (states + 1), rows + 4 * quantities, plan.clouds
    log_weight = quantity + max(rows, states, quantities)
    sets = results.mse.shape[1] if len(request.streams) > 1 else 0

    def array(*shape: int, dtype: Any = np.float64) -> NDArray[Any]:
        """An array of zeros that begins where a line of the processor's cache begins."""
        size = math.prod(shape) * np.dtype(dtype).itemsize
        buffer = np.zeros(size + _CACHE_LINE, np.uint8)
        start = -buffer.ctypes.data % _CACHE_LINE
        return buffer[start : start + size].view(dtype).reshape(shape)

    batch = Batch(
        draws,
        width,
        array(log_weight + 3, stride),
        quantity,
        log_weight,
        log_weight + 1,
        log_weight + 2,
        array(noises + 1, stride + SPARE, dtype=np.float32),
        noises,
        array(distance + 3, row),
        rows,
        distance,
        distance + 1,
        distance + 2,
        array(4, row, dtype=np.bool_),
        words_of(draws, width),
        array(sets, request.y.shape[1], quantities, row),
        resampling_scratch(draws, width),
    )
    saved = Saved(
        array(slots, states, stride),
        array(slots, stride + SPARE, dtype=np.float32),
        array(slots, 2, row),
        array(slots, 4, row, dtype=np.bool_),
    )
    return batch, saved
