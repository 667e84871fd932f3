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
    Drawn,
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
from pfdist.kernels.cached import compiled, entry
from pfdist.kernels.estimators import ErrorWeights
from pfdist.kernels.prefixes import Plan
from pfdist.kernels.variates import FILTER_INITIAL, FILTER_PROCESS, SPARE, Key, fill, words_of
from pfdist.kernels.vectors import LANES, ahead, with_pointers

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
    """Which D draws are filtered, and by which F filters; T+1 is the number of instants.

    Compiled functions get pointers to the arrays.
    """

    draws: int
    filters: int
    sets: int
    instants: int
    states: int  # n
    measurements: int  # m
    quantities: int  # q
    means: int  # number of results of the block QUANTITY
    # (means,): the components of x that are these results; if there are others, this is not used,
    # and `is_state` is False
    components_of_state: NDArray[np.int64]
    is_state: bool
    sensors: int
    streams: NDArray[np.uint64]  # (F,): the key of each filter's noise
    first_draw: int  # index of the first draw in its stream
    start: int  # first instant, 0 without a prior; sets, plans and arrays count from it
    has_prior: bool
    has_weights: bool  # whether the prior has weights, which a filter carries
    columns: int  # M
    prior: NDArray[np.float64]  # (n, M): states of all particles
    # (F, D, P): the column of the prior that each particle of each filter of each draw starts as
    chosen: NDArray[np.int64]
    prior_weight: NDArray[np.float64]  # (P,)
    x: NDArray[np.float64]  # (D, T+1, n): true states; read only if the truth is a particle
    y: NDArray[np.float64]  # (D, T+1, m): measurements
    z: NDArray[np.float64]  # (D, T+1, q): true quantities of interest
    first_components: NDArray[np.int64]  # (sensors,): of y, for each sensor
    particles: int
    scheme: int  # position in `pfdist.kernels.schemes.ALL_SCHEMES`
    sorts: bool  # whether the scheme sorts the particles
    holds_truth: bool  # whether particle 0 is the truth
    guided: bool
    threshold: float  # see `pfdist.kernels.schemes.threshold_of`
    weights: ErrorWeights  # the terms of the estimator
    instant_weights: NDArray[np.float64]  # (T+1,): of each instant's error, mean 1
    components: int  # of the longest process
    # (3, components): kinds of INITIAL_NOISE, PROCESS_NOISE and PROPOSAL_NOISE; -1 for none
    kinds: NDArray[np.int64]


INITIAL_NOISE, PROCESS_NOISE, PROPOSAL_NOISE = np.arange(3)


class Results(NamedTuple):
    """Arrays that the filter fills, for the U sets of the plan; those not wanted are empty."""

    mse: NDArray[np.float64]  # (D, U): errors up to the set's end, over T + 1
    # (D, U): 1 if no particle explains a measurement, up to the set's end; the caller fills it
    # with 0
    degenerate: NDArray[np.uint8]
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


class Wanted(NamedTuple):
    """Which of the results are wanted besides the mse."""

    moments: bool
    errors: bool
    ranks: bool
    cloud: bool


class Batch(NamedTuple):
    """The arrays of a batch of draws; a row has a number for each particle, or for each draw."""

    draws: int  # the most that it holds
    width: int
    stride: int  # of rows of particles
    spacious: int  # of rows of noise
    row: int  # of rows of draws
    # of particles: two halves with n states, and a row each for the logarithms of a proposal; a
    # step reads one half and writes the other
    cloud: NDArray[np.float64]
    quantity: NDArray[np.float64]  # z, with cosines and sines of angles; squared deviations
    log_weight: NDArray[np.float64]
    log_carried: NDArray[np.float64]
    cumulative: NDArray[np.float64]
    noise: NDArray[np.float32]
    weight: NDArray[np.float32]
    words: NDArray[np.uint32]  # see `pfdist.kernels.variates.words_of`
    # of draws
    means: NDArray[np.float64]  # weighted means of `quantity`
    moments: NDArray[np.float64]  # (4 q rows): z, mean, variance, and the first filter's mean
    distance: NDArray[np.float64]
    total: NDArray[np.float64]  # sum of the weights
    error: NDArray[np.float64]  # the sum of errors so far; infinite for a draw that has ended
    weighted: NDArray[np.uint8]  # whether weights differ: they are `weight`, and else all 1
    weighs: NDArray[np.uint8]  # whether the last measurement of the instant gave the weights
    resamples: NDArray[np.uint8]
    degenerate: NDArray[np.uint8]
    first_means: NDArray[np.float64]  # (U, T+1, q, row) of two filters; else empty


class Saved(NamedTuple):
    """Batches from which later sets resume, one for each slot of the plan."""

    cloud: NDArray[np.float64]  # (slots, n * stride)
    weight: NDArray[np.float32]  # (slots, stride)
    numbers: NDArray[np.float64]  # (slots, 2, row): `total` and `error`
    flags: NDArray[np.uint8]  # (slots, 2, row): `weighted` and `degenerate`


class At(NamedTuple):
    """A batch, and the filter of its draws."""

    stream: int  # key of the filter's noise
    number: int  # of the filter
    first: int  # row of the batch's first draw in the arrays
    draws: int  # number of draws


class Work(NamedTuple):
    """All that the functions of a filter share."""

    blocks: Blocks
    request: Request
    plan: Plan
    results: Results
    wanted: Wanted
    batch: Batch
    scratch: Resampling
    saved: Saved


@entry
def filter_draws(work):
    """Filter all draws with all sets of a plan.

    Sets are innermost and in the plan's order: a set resumes from a batch that an earlier set saved
    for the same draws and filter. The filter of a set pauses at each instant before which a later
    set resumes. `here` is 0 or 1: the half that counts.
    """
    work = with_pointers(work)
    request, plan, batch = work.request, work.plan, work.batch
    for first in range(np.int64(0), request.draws, batch.draws):
        draws = min(batch.draws, request.draws - first)
        for number in range(request.filters):
            at = At(request.streams[number], number, first, draws)
            for s in range(request.sets):
                here, stop = np.int64(0), plan.begins[s]
                if stop > 0:
                    _resume(work, plan.sources[s])
                else:
                    _begin(work, at)
                last = plan.first_stops[s + 1] - 1
                # Whether the last cloud counts, so that it is resampled after a measurement.
                goes_on = plan.slots[last] >= 0 or work.wanted.cloud
                for k in range(plan.first_stops[s], last + 1):
                    begin, stop = stop, plan.stops[k]
                    for t in range(begin, stop):
                        resamples = goes_on or t + 1 < plan.ends[s]
                        sensors = plan.measured[s * request.instants + t]
                        here = _filter_instant(work, at, here, t, s, sensors, resamples)
                    if plan.slots[k] >= 0:
                        _save(work, here, plan.slots[k])
                _finish(work, at, here, s)


@compiled
def _filter_instant(work, at, here, t, s, sensors, resamples):
    """Propagate, weight, estimate and resample; the half that then counts.

    The estimate comes before resampling, which adds noise. `sensors` has a bit for each sensor that
    measures.
    """
    request, wanted, batch = work.request, work.wanted, work.batch
    if t > 0:
        _step(work, at, here, t, sensors > 0)
        here = 1 - here
    if request.holds_truth:
        _put_truth(work, at, here, t)
    if sensors > 0:
        here = _measure(work, at, here, t, sensors)
    _estimate(work, at, here, t, s)
    if sensors > 0 and wanted.ranks:
        _rank_truth(work, at, here, t)
    if sensors > 0 and resamples:
        for d in range(at.draws):
            batch.resamples[d] = batch.weighs[d] and _is_uneven(work, d)
        key = (request.start + t + 1) * request.sensors - 1
        here = _resample(work, at, here, key)
    return here


@compiled
def _half(work, here):
    """A half of the cloud."""
    request, batch = work.request, work.batch
    return ahead(batch.cloud, here * (request.states + 1) * batch.stride)


# --- the first cloud, and steps -------------------------------------------------------------------


@compiled
def _resume(work, slot):
    """Fill the first half from a saved batch."""
    request, saved, batch = work.request, work.saved, work.batch
    count, row = request.states * batch.stride, batch.row
    _copy(ahead(saved.cloud, slot * count), batch.cloud, count)
    _copy(ahead(saved.weight, slot * batch.stride), batch.weight, batch.stride)
    _copy(ahead(saved.numbers, 2 * slot * row), batch.total, row)
    _copy(ahead(saved.numbers, (2 * slot + 1) * row), batch.error, row)
    _copy(ahead(saved.flags, 2 * slot * row), batch.weighted, row)
    _copy(ahead(saved.flags, (2 * slot + 1) * row), batch.degenerate, row)


@compiled
def _save(work, here, slot):
    """Save the batch, because a later set resumes from it."""
    request, saved, batch = work.request, work.saved, work.batch
    count, row = request.states * batch.stride, batch.row
    _copy(_half(work, here), ahead(saved.cloud, slot * count), count)
    _copy(batch.weight, ahead(saved.weight, slot * batch.stride), batch.stride)
    _copy(batch.total, ahead(saved.numbers, 2 * slot * row), row)
    _copy(batch.error, ahead(saved.numbers, (2 * slot + 1) * row), row)
    _copy(batch.weighted, ahead(saved.flags, 2 * slot * row), row)
    _copy(batch.degenerate, ahead(saved.flags, (2 * slot + 1) * row), row)


@compiled
def _copy(source, target, count):
    for i in range(count):
        target[i] = source[i]


@compiled
def _begin(work, at):
    """Fill the first half with the prior, or with x(0)."""
    request, batch = work.request, work.batch
    for d in range(at.draws):
        batch.total[d], batch.error[d] = float(request.particles), 0.0
        batch.weighted[d] = batch.weighs[d] = batch.degenerate[d] = 0
    if request.has_prior:
        _take_prior(work, at)
        return
    _fill_noise(work, at, INITIAL_NOISE, np.int64(0), FILTER_INITIAL)
    _of_particles(work, at, INITIAL, np.int64(0), batch.cloud, batch.cloud)


@compiled
def _take_prior(work, at):
    request, batch = work.request, work.batch
    particles, width, stride = request.particles, batch.width, batch.stride
    for d in range(at.draws):
        origin = d * width
        chosen = ahead(request.chosen, (at.number * request.draws + at.first + d) * particles)
        for i in range(width):
            column = chosen[i if i < particles else 0]
            for c in range(request.states):
                value = request.prior[c * request.columns + column]
                batch.cloud[c * stride + origin + i] = value
        if request.has_weights:
            for i in range(width):
                is_particle = i < particles
                batch.weight[origin + i] = request.prior_weight[i] if is_particle else 0.0
            batch.weighted[d] = 1
            batch.total[d] = sum_of_weights(batch.weight, origin, width)


@compiled
def _fill_noise(work, at, process, t, role):
    """A row of noise for each component of a process."""
    request, batch = work.request, work.batch
    for c in range(request.components):
        kind = request.kinds[process * request.components + c]
        if kind >= 0:
            fill(
                batch.words, ahead(batch.noise, c * batch.spacious), batch.width, kind,
                Key(at.stream, t, role, c), request.first_draw + at.first, at.draws,
            )  # fmt: skip


@compiled
def _of_particles(work, at, block, t, source, target):
    """Call a block for all particles of the batch: from states and noise to rows of particles."""
    blocks, request, batch = work.blocks, work.request, work.batch
    which, stride = block * request.instants + t, batch.stride
    call(
        blocks.addresses[which],
        (target, stride),
        (source, stride),
        (batch.noise, batch.spacious),
        (batch.means, 0, 0),
        ahead(blocks.table, blocks.places[which]),
        (1, at.draws * batch.width),
    )


@compiled
def _with_given(work, at, block, t, source, target, given, of_draw, of_component):
    """Call a block that also gets numbers of each draw, from a pointer on with two strides."""
    blocks, request, batch = work.blocks, work.request, work.batch
    which, stride = block * request.instants + t, batch.stride
    call(
        blocks.addresses[which],
        (target, stride),
        (source, stride),
        (batch.noise, batch.spacious),
        (given, of_draw, of_component),
        ahead(blocks.table, blocks.places[which]),
        (at.draws, batch.width),
    )


@compiled
def _of_draws(work, block, t, source, target):
    """Call a block for all draws of the batch: from rows of draws to other rows."""
    blocks, request, batch = work.blocks, work.request, work.batch
    which, row = block * request.instants + t, batch.row
    call(
        blocks.addresses[which],
        (target, row),
        (source, row),
        (batch.noise, 0),
        (batch.means, 0, 0),
        ahead(blocks.table, blocks.places[which]),
        (1, row),
    )


@compiled
def _measured_at(work, at, t, component):
    """The pointer to a component of y(t) of the batch's first draw."""
    request = work.request
    instant = at.first * request.instants + t
    return ahead(request.y, instant * request.measurements + component)


@compiled
def _step(work, at, here, t, is_measured):
    """Fill the other half with x(t); to a measurement by the proposal if there is one."""
    request = work.request
    source, target = _half(work, here), _half(work, 1 - here)
    before = request.start + t - 1
    if is_measured and request.guided:
        _fill_noise(work, at, PROPOSAL_NOISE, before, FILTER_PROCESS)
        y = _measured_at(work, at, t, np.int64(0))
        of_draw = request.instants * request.measurements
        _with_given(work, at, GUIDED, t - 1, source, target, y, of_draw, 1)
    else:
        _fill_noise(work, at, PROCESS_NOISE, before, FILTER_PROCESS)
        _of_particles(work, at, TRANSITION, t - 1, source, target)


@compiled
def _put_truth(work, at, here, t):
    request, batch = work.request, work.batch
    cloud = _half(work, here)
    for d in range(at.draws):
        x = ahead(request.x, ((at.first + d) * request.instants + t) * request.states)
        for c in range(request.states):
            cloud[c * batch.stride + d * batch.width] = x[c]


# --- measurements ---------------------------------------------------------------------------------


@compiled
def _measure(work, at, here, t, sensors):
    """Weigh the particles by the sensors that measure at t; the half that then counts.

    The sensors weigh in their turn. In between the cloud is resampled, but not propagated. If no
    particle explains a measurement, the draw is degenerate, and the measurement is left out.
    """
    request, batch = work.request, work.batch
    for d in range(at.draws):
        batch.weighs[d] = 0
    for sensor in range(request.sensors):
        if (sensors >> sensor) & 1:
            _copy(batch.weighs, batch.resamples, at.draws)
            key = (request.start + t) * request.sensors + sensor - 1
            here = _resample(work, at, here, key)
            _fill_log_weights(work, at, here, t, sensor)
            _weigh(work, at)
            if request.guided and t > 0:
                _step_without(work, at, here, t)
            if request.sorts:
                here = _sort(work, at, here)
    return here


@compiled
def _weigh(work, at):
    request, batch = work.request, work.batch
    for d in range(at.draws):
        total = weigh(
            batch.log_weight, d * batch.width, batch.width, request.particles, batch.weight,
            batch.cumulative,
        )  # fmt: skip
        batch.weighs[d] = total > 0.0
        if total > 0.0:
            batch.weighted[d], batch.total[d] = 1, total
        elif batch.error[d] < np.inf:
            batch.degenerate[d] = 1


@compiled
def _step_without(work, at, here, t):
    """Repeat the step to t without the proposal for draws whose measurement is left out."""
    request, batch = work.request, work.batch
    fails = False
    for d in range(at.draws):
        fails |= batch.weighs[d] == 0
    if not fails:
        return
    source, cloud = _half(work, 1 - here), _half(work, here)
    _fill_noise(work, at, PROCESS_NOISE, request.start + t - 1, FILTER_PROCESS)
    _of_particles(work, at, TRANSITION, t - 1, source, batch.quantity)
    for d in range(at.draws):
        if not batch.weighs[d]:
            for c in range(request.states):
                place = c * batch.stride + d * batch.width
                _copy(ahead(batch.quantity, place), ahead(cloud, place), batch.width)


@compiled
def _fill_log_weights(work, at, here, t, sensor):
    """Log-likelihoods, with the logarithms of a proposal and of carried weights."""
    blocks, request, batch = work.blocks, work.request, work.batch
    cloud, used = _half(work, here), at.draws * batch.width
    y = _measured_at(work, at, t, request.first_components[sensor])
    of_draw, block = request.instants * request.measurements, SENSORS + sensor
    _with_given(work, at, block, t, cloud, batch.log_weight, y, of_draw, 1)
    if request.guided and t > 0:
        guide = ahead(cloud, request.states * batch.stride)
        for i in range(used):
            batch.log_weight[i] += guide[i]
    if request.threshold < np.inf:
        which = LOGARITHM * request.instants
        call(
            blocks.addresses[which],
            (batch.log_carried, batch.stride),
            (batch.cloud, 0),
            (batch.weight, 0),
            (batch.means, 0, 0),
            ahead(blocks.table, blocks.places[which]),
            (1, used),
        )
        for d in range(at.draws):
            if batch.weighted[d]:
                for i in range(d * batch.width, (d + 1) * batch.width):
                    batch.log_weight[i] += batch.log_carried[i]


@compiled
def _sort(work, at, here):
    """Sort the particles of each weighed draw by their state; the other half has the result."""
    request, batch, scratch = work.request, work.batch, work.scratch
    source, target = _half(work, here), _half(work, 1 - here)
    for d in range(at.draws):
        sort_by_state(
            source, target, batch.weight, batch.cumulative, d * batch.width, batch.width,
            request.particles, batch.weighs[d] > 0, scratch,
        )  # fmt: skip
    return 1 - here


@compiled
def _is_uneven(work, d):
    """Whether the effective sample size of a draw lies below the threshold.

    Source: Kong, Liu, Wong, "Sequential imputations and Bayesian missing data problems", Journal of
    the American Statistical Association 89, 1994.
    """
    request, batch = work.request, work.batch
    if request.threshold == np.inf:
        return True
    squares = sum_of_squares(batch.weight, d * batch.width, batch.width)
    return batch.total[d] ** 2 < request.threshold * request.particles * squares


@compiled
def _resample(work, at, here, key):
    """Resample the draws with the flag; the half that then counts."""
    request, batch, scratch = work.request, work.batch, work.scratch
    some = False
    for d in range(at.draws):
        some |= batch.resamples[d] > 0
    if not some:
        return here
    first = request.first_draw + at.first
    drawn = Drawn(at.stream, key, first, at.draws, batch.width, request.particles)
    find_ancestors(request.scheme, batch.cumulative, batch.resamples, drawn, scratch)
    source, target = _half(work, here), _half(work, 1 - here)
    for c in range(request.states):
        row = c * batch.stride
        take(scratch, ahead(source, row), ahead(target, row), at.draws, batch.width)
    for d in range(at.draws):
        if batch.resamples[d]:
            batch.weighted[d], batch.total[d] = 0, float(request.particles)
    return 1 - here


# --- estimates and errors -------------------------------------------------------------------------


@compiled
def _estimate(work, at, here, t, s):
    """Estimate z(t) of each draw, and add the errors."""
    request, wanted, batch = work.request, work.wanted, work.batch
    quantities, weights = request.quantities, request.weights
    cloud, mean = _half(work, here), ahead(batch.moments, quantities * batch.row)
    if request.is_state:
        for r in range(request.means):
            values = ahead(cloud, request.components_of_state[r] * batch.stride)
            _fill_mean(work, at, values, ahead(batch.means, r * batch.row))
    else:
        _of_particles(work, at, QUANTITY, t, cloud, batch.quantity)
        _fill_means(work, at, batch.means, request.means)
    _of_draws(work, ESTIMATE, t, batch.means, mean)
    if weights.variance != 0.0 or weights.distance != 0.0 or wanted.moments:
        _estimate_variance(work, at, cloud, t, s)
    if weights.squared_error != 0.0:
        for d in range(at.draws):
            z = ahead(request.z, ((at.first + d) * request.instants + t) * quantities)
            for c in range(quantities):
                batch.moments[c * batch.row + d] = z[c]
        _of_draws(work, ERROR, t, batch.moments, batch.distance)
        weight = request.instant_weights[t] * weights.squared_error
        for d in range(at.draws):
            _add(work, s, t, d, batch.distance[d], weight)
    for d in range(at.draws):
        if not batch.error[d] < np.inf:
            batch.error[d] = np.inf


@compiled
def _fill_means(work, at, means, rows):
    """Fill rows of draws with the weighted means of z, or of squared deviations."""
    batch = work.batch
    for r in range(rows):
        values = ahead(batch.quantity, r * batch.stride)
        _fill_mean(work, at, values, ahead(means, r * batch.row))


@compiled
def _fill_mean(work, at, values, mean):
    """Fill a row of draws with the weighted mean of a row of particles."""
    request, batch = work.request, work.batch
    for d in range(at.draws):
        origin = d * batch.width
        if batch.weighted[d]:
            value = weighted_sum(batch.weight, values, origin, batch.width)
        else:
            value = sum_of_first(values, origin, request.particles)
        mean[d] = value / batch.total[d]


@compiled
def _estimate_variance(work, at, cloud, t, s):
    """Record mean and variance, and add the part of the error that they estimate.

    Each filter contributes its variance, by the estimator's weights. The first of two filters
    stores its mean, and the second adds the distance to it, as `pfdist.filters.interface` does.
    """
    request, wanted, batch = work.request, work.wanted, work.batch
    quantities, row = request.quantities, batch.row
    mean = ahead(batch.moments, quantities * row)
    variance = ahead(mean, quantities * row)
    _with_given(work, at, DEVIATIONS, t, cloud, batch.quantity, mean, 1, row)
    _fill_means(work, at, variance, quantities)
    if wanted.moments:
        _record(work, at, t, mean, variance)
    has_distance = request.filters > 1
    if has_distance:
        _measure_distance(work, at, t, s, mean)
    for d in range(at.draws):
        error = 0.0
        if request.weights.variance != 0.0:  # else an infinite variance would make a NaN
            for c in range(quantities):
                error += variance[c * row + d]
            error *= request.weights.variance
        if has_distance and at.number > 0:
            error += request.weights.distance * batch.distance[d]
        _add(work, s, t, d, error, request.instant_weights[t])


@compiled
def _record(work, at, t, mean, variance):
    request, results, batch = work.request, work.results, work.batch
    for d in range(at.draws):
        if batch.error[d] < np.inf:
            first = ((at.first + d) * request.instants + t) * request.quantities
            for c in range(request.quantities):
                results.estimate[first + c] = mean[c * batch.row + d]
                results.variance[first + c] = variance[c * batch.row + d]


@compiled
def _measure_distance(work, at, t, s, mean):
    """Keep the means of the first filter; the second measures the distance of its own to these."""
    request, batch = work.request, work.batch
    count = request.quantities * batch.row
    first_means = ahead(batch.first_means, (s * request.instants + t) * count)
    if at.number == 0:
        _copy(mean, first_means, count)
    else:
        _copy(first_means, ahead(mean, 2 * count), count)
        _of_draws(work, DISTANCE, t, mean, batch.distance)


@compiled
def _add(work, s, t, d, error, weight):
    """Add a weighted error to those of a draw that has not ended, and to the sum over draws.

    An instant of weight 0 does not count, even if its error is infinite.
    """
    request, results, wanted, batch = work.request, work.results, work.wanted, work.batch
    if batch.error[d] < np.inf and weight != 0.0:
        batch.error[d] += weight * error
        if wanted.errors:
            results.errors[s * request.instants + t] += weight * error


@compiled
def _rank_truth(work, at, here, t):
    """The place of the truth's z, which is that of particle 0, among the weighted particles."""
    results, request, batch = work.results, work.request, work.batch
    half = request.draws * request.instants * request.quantities
    _of_particles(work, at, QUANTITY, t, _half(work, here), batch.quantity)
    for d in range(at.draws):
        origin, total = d * batch.width, batch.total[d]
        first = ((at.first + d) * request.instants + t) * request.quantities
        for c in range(request.quantities):
            z = ahead(batch.quantity, c * batch.stride)
            below = equal = 0.0
            for i in range(origin, origin + request.particles):
                weight = np.float64(batch.weight[i]) if batch.weighted[d] else 1.0
                if z[i] < z[origin]:
                    below += weight
                elif z[i] == z[origin]:
                    equal += weight
            results.ranks[first + c], results.ranks[half + first + c] = below / total, equal / total


@compiled
def _finish(work, at, here, s):
    """Write the results of a set: mean errors, degenerate draws, and clouds that are wanted."""
    request, results, wanted, batch = work.request, work.results, work.wanted, work.batch
    for d in range(at.draws):
        place = (at.first + d) * request.sets + s
        mse = batch.error[d] / request.instants
        results.mse[place] = mse if at.number == 0 else results.mse[place] + mse
        results.degenerate[place] |= batch.degenerate[d]
        if wanted.cloud and batch.error[d] < np.inf:
            _keep(work, at, here, d)


@compiled
def _keep(work, at, here, d):
    """Copy the particles of a draw and their weights into the results."""
    request, results, batch = work.request, work.results, work.batch
    cloud, particles, row = _half(work, here), request.particles, at.first + d
    for i in range(particles):
        place = d * batch.width + i
        weight = np.float64(batch.weight[place]) if batch.weighted[d] else 1.0
        results.weight[row * particles + i] = weight
        for c in range(request.states):
            value = cloud[c * batch.stride + place]
            results.cloud[(row * request.states + c) * particles + i] = value


# --- the arrays that a filter works in ------------------------------------------------------------

_TOGETHER = 2048  # particles of a batch, about: its arrays fit into a cache
_MOST_SAVED = 2**22  # numbers of all saved batches, about
_CACHE_LINE = 64  # bytes


def filter_all(blocks: Blocks, request: Request, plan: Plan, results: Results) -> None:
    """Filter all draws, in arrays that each call makes for itself: threads filter together."""
    width = -(-request.particles // LANES) * LANES
    numbers = (request.states + 1) * width * max(1, plan.clouds)
    draws = max(1, min(request.draws, _TOGETHER // width, _MOST_SAVED // numbers))
    batch, saved = _scratch(request, plan, width, draws)
    sizes = results.estimate.size, results.errors.size, results.ranks.size, results.cloud.size
    wanted = Wanted(*(size > 0 for size in sizes))
    scratch = resampling_scratch(draws, width)
    filter_draws(Work(blocks, request, plan, results, wanted, batch, scratch, saved))


def _scratch(request: Request, plan: Plan, width: int, draws: int) -> tuple[Batch, Saved]:
    """The arrays of a batch of draws."""
    stride, row, slots = draws * width, -(-draws // LANES) * LANES, plan.clouds
    states, quantities, spacious = request.states, request.quantities, stride + SPARE
    sets = request.sets if request.filters > 1 else 0

    def array(*shape: int, dtype: Any = np.float64) -> NDArray[Any]:
        """An array of zeros that begins where a line of the processor's cache begins."""
        size = math.prod(shape) * np.dtype(dtype).itemsize
        buffer = np.zeros(size + _CACHE_LINE, np.uint8)
        start = -buffer.ctypes.data % _CACHE_LINE
        return buffer[start : start + size].view(dtype).reshape(shape)

    batch = Batch(
        draws,
        width,
        stride,
        spacious,
        row,
        cloud=array(2 * (states + 1), stride),
        quantity=array(max(request.means, states, quantities), stride),
        log_weight=array(stride),
        log_carried=array(stride),
        cumulative=array(stride),
        noise=array(request.components, spacious, dtype=np.float32),
        weight=array(stride, dtype=np.float32),
        words=words_of(draws, width),
        means=array(request.means, row),
        moments=array(4 * quantities, row),
        distance=array(row),
        total=array(row),
        error=array(row),
        weighted=array(row, dtype=np.uint8),
        weighs=array(row, dtype=np.uint8),
        resamples=array(row, dtype=np.uint8),
        degenerate=array(row, dtype=np.uint8),
        first_means=array(sets, request.instants, quantities, row),
    )
    saved = Saved(
        array(slots, states * stride),
        array(slots, stride, dtype=np.float32),
        array(slots, 2, row),
        array(slots, 2, row, dtype=np.uint8),
    )
    return batch, saved
