"""The intermittent particle filter (paper, section 2.1) for any model, compiled once a machine.

A model is a set of blocks: machine code that is called by its address, see
`pfdist.kernels.blocks`. All else is here. Several draws go through an instant in lockstep, as a
*batch*, so that a step has enough particles. No result depends on the size of a batch.

Arrays of particles are flat. Particle i of the batch's draw d is at the position ``d * width + i``,
where width is the number of particles, rounded up to whole vectors. An array with several rows has
``stride`` entries a row.
"""

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.kernels.ancestors import (
    ENTRIES,
    Drawn,
    Resampling,
    Search,
    resampling_scratch,
    sort_by_state,
    sum_of_first,
    sum_of_squares,
    sum_of_weights,
    take,
    weigh,
    weighted_sum,
)
from pfdist.kernels.blocks import Blocks, call_block
from pfdist.kernels.cached import Entry, compiled, entry
from pfdist.kernels.estimators import ErrorWeights
from pfdist.kernels.memory import States, ahead, call, read, readers, zeros
from pfdist.kernels.prefixes import Plan
from pfdist.kernels.schemes import ALL_SCHEMES
from pfdist.kernels.variates import FILTER_INITIAL, FILTER_PROCESS, SPARE, Key, Row, number_of_words
from pfdist.kernels.vectors import LANES

INITIAL, TRANSITION, GUIDED, QUANTITY, DEVIATIONS, ESTIMATE, ERROR, DISTANCE, LOGARITHM, SENSORS = (
    np.arange(10)  # NumPy's: Numba compiles a function again for each integer of Python
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
    # (D, T+1): of a single set, the effective sample size at measured instants
    sizes: NDArray[np.float64]
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
    """Which of the results are wanted besides the mse, the ranks and the cloud."""

    moments: bool
    errors: bool


class Batch(NamedTuple):
    """The arrays of a batch of draws; a row has a number for each particle, or for each draw."""

    draws: int  # the most that it holds
    width: int
    stride: int  # of rows of particles
    spacious: int  # of rows of noise
    row: int  # of rows of draws
    half: NDArray[np.int64]  # (1,): which half of the cloud counts
    # of particles: two halves with n states, and a row each for the logarithms of a proposal; a
    # step reads one half and writes the other
    cloud: States
    again: States  # n rows, for filters with a proposal
    quantity: NDArray[np.float64]  # z, with cosines and sines of angles; squared deviations
    log_weight: States
    log_carried: NDArray[np.float64]
    cumulative: NDArray[np.float64]
    noise: NDArray[np.float32]
    weight: NDArray[np.float32]
    words: NDArray[np.uint32]  # see `pfdist.kernels.variates.number_of_words`
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

    cloud: States  # (slots, n * stride)
    weight: NDArray[np.float32]  # (slots, stride)
    numbers: NDArray[np.float64]  # (slots, 2, row): `total` and `error`
    flags: NDArray[np.uint8]  # (slots, 2, row): `weighted` and `degenerate`


class Steps(NamedTuple):
    """The addresses of the steps of a filter; 0 for one that it does not need.

    So a step is compiled alone, and only if a filter needs it, see `pfdist.kernels.cached.Entry`.
    """

    begin: int
    resume: int
    save: int
    move: int
    put_truth: int
    forget: int
    weigh: int
    move_again: int
    sort: int
    resample: int
    scheme: int  # one of `pfdist.kernels.ancestors.ENTRIES`
    estimate: int
    estimate_variance: int
    rank: int
    finish: int
    keep: int


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
    steps: Steps


(
    _blocks, _request, _plan, _results, _wanted, _batch, _scratch, _saved, _steps,
) = readers(Work)  # fmt: skip


class At(NamedTuple):
    """A batch, and the filter of its draws."""

    work: Annotated[int, Work]  # address
    stream: np.uint64  # key of the filter's noise
    number: int  # of the filter
    first: int  # row of the batch's first draw in the arrays
    draws: int  # number of draws


class Instant(NamedTuple):
    """An instant, as a step of a filter gets it."""

    at: At
    s: int  # the set
    t: int
    sensors: int  # a bit for each sensor that measures
    sensor: int  # whose turn it is


class Slot(NamedTuple):
    """A batch, and where it is saved."""

    at: At
    slot: int


@entry(Work)
def filter_draws(work):
    """Filter all draws with all sets of a plan.

    Sets are innermost and in the plan's order: a set resumes from a batch that an earlier set saved
    for the same draws and filter. The filter of a set pauses at each instant before which a later
    set resumes.
    """
    request, batch = _request(work), _batch(work)
    for first in range(np.int64(0), request.draws, batch.draws):
        left = request.draws - first
        draws = batch.draws if batch.draws < left else left
        for number in range(request.filters):
            at = At(work, request.streams[number], number, first, draws)
            for s in range(request.sets):
                _filter_set(at, s)


@compiled
def _filter_set(at, s):
    """Filter a batch with a set."""
    plan, steps, instants = _plan(at.work), _steps(at.work), _request(at.work).instants
    stop = plan.begins[s]
    if stop > 0:
        call(steps.resume, Slot(at, plan.sources[s]))
    else:
        call(steps.begin, Instant(at, s, 0, 0, 0))
    last = plan.first_stops[s + 1] - 1
    # Whether the last cloud counts, so that it is resampled after a measurement.
    goes_on = plan.slots[last] >= 0 or steps.keep != 0
    for k in range(plan.first_stops[s], last + 1):
        begin, stop = stop, plan.stops[k]
        for t in range(begin, stop):
            resamples = goes_on or t + 1 < plan.ends[s]
            _filter_instant(at, s, t, plan.measured[s * instants + t], resamples)
        if plan.slots[k] >= 0:
            call(steps.save, Slot(at, plan.slots[k]))
    call(steps.finish, Instant(at, s, 0, 0, 0))


@compiled
def _filter_instant(at, s, t, sensors, resamples):
    """Propagate, weight, estimate and resample; sensors weigh in their turn.

    The cloud is also resampled between two sensors, but not propagated. The estimate comes before
    the last resampling, which adds noise. `sensors` has a bit for each sensor that measures.
    """
    request, steps = _request(at.work), _steps(at.work)
    instant = Instant(at, s, t, sensors, 0)
    if t > 0:
        call(steps.move, instant)
    if steps.put_truth != 0:
        call(steps.put_truth, instant)
    if sensors > 0:
        call(steps.forget, instant)
        for sensor in range(request.sensors):
            if (sensors >> sensor) & 1:
                measurement = Instant(at, s, t, sensors, sensor)
                call(steps.resample, measurement)
                call(steps.weigh, measurement)
                if steps.move_again != 0 and t > 0:
                    call(steps.move_again, measurement)
                if steps.sort != 0:
                    call(steps.sort, measurement)
    call(steps.estimate, instant)
    if sensors > 0 and steps.rank != 0:
        call(steps.rank, instant)
    if sensors > 0 and resamples:
        call(steps.resample, Instant(at, s, t, sensors, request.sensors))


@compiled
def _present(at):
    """The half of the cloud that counts."""
    request, batch = _request(at.work), _batch(at.work)
    return ahead(batch.cloud, batch.half[0] * (request.states + 1) * batch.stride)


@compiled
def _other(at):
    """The half of the cloud that a step writes."""
    request, batch = _request(at.work), _batch(at.work)
    return ahead(batch.cloud, (1 - batch.half[0]) * (request.states + 1) * batch.stride)


# --- the first cloud, and steps -------------------------------------------------------------------


@entry(Slot)
def _resume(place):
    """Fill the first half from a saved batch."""
    at, slot = read(place)
    request, saved, batch = _request(at.work), _saved(at.work), _batch(at.work)
    count, row = request.states * batch.stride, batch.row
    batch.half[0] = 0
    _copy(ahead(saved.cloud, slot * count), batch.cloud, count)
    _copy(ahead(saved.weight, slot * batch.stride), batch.weight, batch.stride)
    _copy(ahead(saved.numbers, 2 * slot * row), batch.total, row)
    _copy(ahead(saved.numbers, (2 * slot + 1) * row), batch.error, row)
    _copy(ahead(saved.flags, 2 * slot * row), batch.weighted, row)
    _copy(ahead(saved.flags, (2 * slot + 1) * row), batch.degenerate, row)


@entry(Slot)
def _save(place):
    """Save the batch, because a later set resumes from it."""
    at, slot = read(place)
    request, saved, batch = _request(at.work), _saved(at.work), _batch(at.work)
    count, row = request.states * batch.stride, batch.row
    _copy(_present(at), ahead(saved.cloud, slot * count), count)
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
def _begin(at):
    """Begin a set with an empty sum of errors."""
    request, batch = _request(at.work), _batch(at.work)
    batch.half[0] = 0
    for d in range(at.draws):
        batch.total[d], batch.error[d] = float(request.particles), 0.0
        batch.weighted[d] = batch.weighs[d] = batch.degenerate[d] = 0


@entry(Instant)
def _draw_prior(instant):
    """Begin a set with x(0) in the first half."""
    at = read(instant).at
    batch = _batch(at.work)
    _begin(at)
    _fill_noise(at, INITIAL_NOISE, np.int64(0), FILTER_INITIAL)
    _of_particles(at, INITIAL, np.int64(0), batch.cloud, batch.cloud)


@entry(Instant)
def _take_prior(instant):
    """Begin a set with particles of the prior, and their weights, in the first half."""
    at = read(instant).at
    request, batch = _request(at.work), _batch(at.work)
    particles, width, stride = request.particles, batch.width, batch.stride
    _begin(at)
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
def _fill_noise(at, process, t, role):
    """A row of noise for each component of a process."""
    request, batch = _request(at.work), _batch(at.work)
    for c in range(request.components):
        kind = request.kinds[process * request.components + c]
        if kind >= 0:
            row = Row(
                batch.words, ahead(batch.noise, c * batch.spacious), batch.width, kind,
                Key(at.stream, t, role, c), request.first_draw + at.first, at.draws,
            )  # fmt: skip
            call(_scratch(at.work).fill, row)


@compiled
def _of_particles(at, block, t, source, target):
    """Call a block for all particles of the batch: from states and noise to rows of particles."""
    blocks, request, batch = _blocks(at.work), _request(at.work), _batch(at.work)
    which, stride = block * request.instants + t, batch.stride
    call_block(
        blocks.addresses[which],
        (target, stride),
        (source, stride),
        (batch.noise, batch.spacious),
        (batch.means, 0, 0),
        ahead(blocks.table, blocks.places[which]),
        (1, at.draws * batch.width),
    )


@compiled
def _with_given(at, block, t, source, target, given, of_draw, of_component):
    """Call a block that also gets numbers of each draw, from a pointer on with two strides."""
    blocks, request, batch = _blocks(at.work), _request(at.work), _batch(at.work)
    which, stride = block * request.instants + t, batch.stride
    call_block(
        blocks.addresses[which],
        (target, stride),
        (source, stride),
        (batch.noise, batch.spacious),
        (given, of_draw, of_component),
        ahead(blocks.table, blocks.places[which]),
        (at.draws, batch.width),
    )


@compiled
def _of_draws(at, block, t, source, target):
    """Call a block for all draws of the batch: from rows of draws to other rows."""
    blocks, request, batch = _blocks(at.work), _request(at.work), _batch(at.work)
    which, row = block * request.instants + t, batch.row
    call_block(
        blocks.addresses[which],
        (target, row),
        (source, row),
        (batch.noise, 0),
        (batch.means, 0, 0),
        ahead(blocks.table, blocks.places[which]),
        (1, row),
    )


@compiled
def _measured_at(at, t, component):
    """The pointer to a component of y(t) of the batch's first draw."""
    request = _request(at.work)
    instant = at.first * request.instants + t
    return ahead(request.y, instant * request.measurements + component)


@entry(Instant)
def _move(instant):
    """Fill the other half with x(t); to a measurement by the proposal if there is one."""
    at, _, t, sensors, _ = read(instant)
    request, batch = _request(at.work), _batch(at.work)
    source, target, before = _present(at), _other(at), request.start + t - 1
    if sensors > 0 and request.guided:
        _fill_noise(at, PROPOSAL_NOISE, before, FILTER_PROCESS)
        y = _measured_at(at, t, np.int64(0))
        of_draw = request.instants * request.measurements
        _with_given(at, GUIDED, t - 1, source, target, y, of_draw, 1)
    else:
        _fill_noise(at, PROCESS_NOISE, before, FILTER_PROCESS)
        _of_particles(at, TRANSITION, t - 1, source, target)
    batch.half[0] = 1 - batch.half[0]


@entry(Instant)
def _put_truth(instant):
    """Let particle 0 of each draw be the truth."""
    at, _, t, _, _ = read(instant)
    request, batch, cloud = _request(at.work), _batch(at.work), _present(at)
    for d in range(at.draws):
        x = ahead(request.x, ((at.first + d) * request.instants + t) * request.states)
        for c in range(request.states):
            cloud[c * batch.stride + d * batch.width] = x[c]


# --- measurements ---------------------------------------------------------------------------------


@entry(Instant)
def _forget(instant):
    """Forget which draws were weighed before this instant."""
    at = read(instant).at
    batch = _batch(at.work)
    for d in range(at.draws):
        batch.weighs[d] = 0


@entry(Instant)
def _weigh(instant):
    """Weigh the particles by a sensor.

    If no particle explains a measurement, the draw is degenerate, and the measurement is left out.
    """
    at, _, t, _, sensor = read(instant)
    request, batch = _request(at.work), _batch(at.work)
    _fill_log_weights(at, t, sensor)
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


@entry(Instant)
def _move_again(instant):
    """Repeat the step to t without the proposal for draws whose measurement is left out."""
    at, _, t, _, _ = read(instant)
    request, batch = _request(at.work), _batch(at.work)
    fails = False
    for d in range(at.draws):
        fails |= batch.weighs[d] == 0
    if not fails:
        return
    source, cloud = _other(at), _present(at)
    _fill_noise(at, PROCESS_NOISE, request.start + t - 1, FILTER_PROCESS)
    _of_particles(at, TRANSITION, t - 1, source, batch.again)
    for d in range(at.draws):
        if not batch.weighs[d]:
            for c in range(request.states):
                place = c * batch.stride + d * batch.width
                _copy(ahead(batch.again, place), ahead(cloud, place), batch.width)


@compiled
def _fill_log_weights(at, t, sensor):
    """Log-likelihoods, with the logarithms of a proposal and of carried weights."""
    blocks, request, batch = _blocks(at.work), _request(at.work), _batch(at.work)
    cloud, used = _present(at), at.draws * batch.width
    y = _measured_at(at, t, request.first_components[sensor])
    of_draw, block = request.instants * request.measurements, SENSORS + sensor
    _with_given(at, block, t, cloud, batch.log_weight, y, of_draw, 1)
    if request.guided and t > 0:
        guide = ahead(cloud, request.states * batch.stride)
        for i in range(used):
            batch.log_weight[i] += guide[i]
    if request.threshold < np.inf:
        which = LOGARITHM * request.instants
        call_block(
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


@entry(Instant)
def _sort(instant):
    """Sort the particles of each weighed draw by their state."""
    at = read(instant).at
    request, batch, source, target = _request(at.work), _batch(at.work), _present(at), _other(at)
    for d in range(at.draws):
        sort_by_state(
            source, target, batch.weight, batch.cumulative, d * batch.width, batch.width,
            request.particles, batch.weighs[d] > 0, _scratch(at.work),
        )  # fmt: skip
    batch.half[0] = 1 - batch.half[0]


@compiled
def _is_uneven(request, batch, d):
    """Whether the effective sample size of a draw lies below the threshold."""
    if request.threshold == np.inf:
        return True
    squares = sum_of_squares(batch.weight, d * batch.width, batch.width)
    return batch.total[d] * batch.total[d] < request.threshold * request.particles * squares


@entry(Instant)
def _resample(instant):
    """Resample the draws that the last measurement of the instant weighed.

    Behind all sensors, only those with uneven weights are resampled.
    """
    at, _, t, _, sensor = read(instant)
    request, batch, scratch = _request(at.work), _batch(at.work), _scratch(at.work)
    some = False
    for d in range(at.draws):
        weighs = batch.weighs[d] > 0
        batch.resamples[d] = weighs and (sensor < request.sensors or _is_uneven(request, batch, d))
        some |= batch.resamples[d] > 0
    if not some:
        return
    key = (request.start + t) * request.sensors + sensor - 1
    first = request.first_draw + at.first
    drawn = Drawn(at.stream, key, first, at.draws, batch.width, request.particles)
    search = Search(batch.cumulative, batch.resamples, request.holds_truth, drawn, scratch)
    call(_steps(at.work).scheme, search)
    source, target = _present(at), _other(at)
    for c in range(request.states):
        row = c * batch.stride
        take(scratch, ahead(source, row), ahead(target, row), at.draws, batch.width)
    for d in range(at.draws):
        if batch.resamples[d]:
            batch.weighted[d], batch.total[d] = 0, float(request.particles)
    batch.half[0] = 1 - batch.half[0]


# --- estimates and errors -------------------------------------------------------------------------


@entry(Instant)
def _estimate(instant):
    """Estimate z(t) of each draw, and add the errors."""
    instant = read(instant)
    at, s, t, _, _ = instant
    request, steps, batch = _request(at.work), _steps(at.work), _batch(at.work)
    quantities, weights = request.quantities, request.weights
    cloud, mean = _present(at), ahead(batch.moments, quantities * batch.row)
    if request.is_state:
        for r in range(request.means):
            values = ahead(cloud, request.components_of_state[r] * batch.stride)
            _fill_mean(at, values, ahead(batch.means, r * batch.row))
    else:
        _of_particles(at, QUANTITY, t, cloud, batch.quantity)
        _fill_means(at, batch.means, request.means)
    _of_draws(at, ESTIMATE, t, batch.means, mean)
    if steps.estimate_variance != 0:
        call(steps.estimate_variance, instant)
    if weights.squared_error != 0.0:
        for d in range(at.draws):
            z = ahead(request.z, ((at.first + d) * request.instants + t) * quantities)
            for c in range(quantities):
                batch.moments[c * batch.row + d] = z[c]
        _of_draws(at, ERROR, t, batch.moments, batch.distance)
        weight = request.instant_weights[t] * weights.squared_error
        for d in range(at.draws):
            _add(at, s, t, d, batch.distance[d], weight)
    for d in range(at.draws):
        if not batch.error[d] < np.inf:
            batch.error[d] = np.inf


@compiled
def _fill_means(at, means, rows):
    """Fill rows of draws with the weighted means of z, or of squared deviations."""
    batch = _batch(at.work)
    for r in range(rows):
        values = ahead(batch.quantity, r * batch.stride)
        _fill_mean(at, values, ahead(means, r * batch.row))


@compiled
def _fill_mean(at, values, mean):
    """Fill a row of draws with the weighted mean of a row of particles."""
    request, batch = _request(at.work), _batch(at.work)
    for d in range(at.draws):
        origin = d * batch.width
        if batch.weighted[d]:
            value = weighted_sum(batch.weight, values, origin, batch.width)
        else:
            value = sum_of_first(values, origin, request.particles)
        mean[d] = value / batch.total[d]


@entry(Instant)
def _estimate_variance(instant):
    """Record mean and variance, and add the part of the error that they estimate.

    Each filter contributes its variance, by the estimator's weights. The first of two filters
    stores its mean, and the second adds the distance to it, as `pfdist.filters.interface` does.
    """
    at, s, t, sensors, _ = read(instant)
    request, wanted, batch = _request(at.work), _wanted(at.work), _batch(at.work)
    quantities, row = request.quantities, batch.row
    mean = ahead(batch.moments, quantities * row)
    variance = ahead(mean, quantities * row)
    _with_given(at, DEVIATIONS, t, _present(at), batch.quantity, mean, 1, row)
    _fill_means(at, variance, quantities)
    if wanted.moments:
        _record(at, t, mean, variance)
        if sensors > 0:
            _record_sizes(at, t)
    has_distance = request.filters > 1
    if has_distance:
        _measure_distance(at, t, s, mean)
    for d in range(at.draws):
        error = 0.0
        if request.weights.variance != 0.0:  # else an infinite variance would make a NaN
            for c in range(quantities):
                error += variance[c * row + d]
            error *= request.weights.variance
        if has_distance and at.number > 0:
            error += request.weights.distance * batch.distance[d]
        _add(at, s, t, d, error, request.instant_weights[t])


@compiled
def _record(at, t, mean, variance):
    request, results, batch = _request(at.work), _results(at.work), _batch(at.work)
    for d in range(at.draws):
        if batch.error[d] < np.inf:
            first = ((at.first + d) * request.instants + t) * request.quantities
            for c in range(request.quantities):
                results.estimate[first + c] = mean[c * batch.row + d]
                results.variance[first + c] = variance[c * batch.row + d]


@compiled
def _record_sizes(at, t):
    """Record the effective sample sizes of draws that the instant's last measurement weighed.

    Source: Kong, Liu, Wong, "Sequential imputations and Bayesian missing data problems", Journal of
    the American Statistical Association 89, 1994.
    """
    request, results, batch = _request(at.work), _results(at.work), _batch(at.work)
    for d in range(at.draws):
        if batch.weighs[d] and batch.error[d] < np.inf:
            squares = sum_of_squares(batch.weight, d * batch.width, batch.width)
            place = (at.first + d) * request.instants + t
            results.sizes[place] = batch.total[d] * batch.total[d] / squares


@compiled
def _measure_distance(at, t, s, mean):
    """Keep the means of the first filter; the second measures the distance of its own to these."""
    request, batch = _request(at.work), _batch(at.work)
    count = request.quantities * batch.row
    first_means = ahead(batch.first_means, (s * request.instants + t) * count)
    if at.number == 0:
        _copy(mean, first_means, count)
    else:
        _copy(first_means, ahead(mean, 2 * count), count)
        _of_draws(at, DISTANCE, t, mean, batch.distance)


@compiled
def _add(at, s, t, d, error, weight):
    """Add a weighted error to those of a draw that has not ended, and to the sum over draws.

    An instant of weight 0 does not count, even if its error is infinite.
    """
    request, results, wanted, batch = (
        _request(at.work),
        _results(at.work),
        _wanted(at.work),
        _batch(at.work),
    )
    if batch.error[d] < np.inf and weight != 0.0:
        batch.error[d] += weight * error
        if wanted.errors:
            results.errors[s * request.instants + t] += weight * error


@entry(Instant)
def _rank_truth(instant):
    """The place of the truth's z, which is that of particle 0, among the weighted particles."""
    at, _, t, _, _ = read(instant)
    results, request, batch = _results(at.work), _request(at.work), _batch(at.work)
    half = request.draws * request.instants * request.quantities
    _of_particles(at, QUANTITY, t, _present(at), batch.quantity)
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


@entry(Instant)
def _finish(instant):
    """Write the results of a set: mean errors, degenerate draws, and clouds that are wanted."""
    at, s, _, _, _ = read(instant)
    request, results, batch, keep = (
        _request(at.work), _results(at.work), _batch(at.work), _steps(at.work).keep,
    )  # fmt: skip
    for d in range(at.draws):
        place = (at.first + d) * request.sets + s
        mse = batch.error[d] / request.instants
        results.mse[place] = mse if at.number == 0 else results.mse[place] + mse
        results.degenerate[place] |= batch.degenerate[d]
    if keep != 0:
        call(keep, Instant(at, s, 0, 0, 0))


@entry(Instant)
def _keep(instant):
    """Copy the particles and their weights into the results."""
    at = read(instant).at
    request, results, batch = _request(at.work), _results(at.work), _batch(at.work)
    cloud, particles = _present(at), request.particles
    for d in range(at.draws):
        if batch.error[d] < np.inf:
            row = at.first + d
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


def filter_all(
    blocks: Blocks, request: Request, plan: Plan, results: Results, scheme: str, dtype: str
) -> None:
    """Filter all draws, in arrays that each call makes for itself: threads filter together.

    `dtype` is the type of the particles' states, "float64" or "float32", as in the blocks.
    """
    width = -(-request.particles // LANES) * LANES
    numbers = (request.states + 1) * width * max(1, plan.clouds)
    draws = max(1, min(request.draws, _TOGETHER // width, _MOST_SAVED // numbers))
    batch, saved, _memory = _arrays(request, plan, width, draws, dtype)
    wanted = Wanted(results.estimate.size > 0, results.errors.size > 0)
    scratch = resampling_scratch(draws, width)
    steps = _needed(request, plan, results, scheme, dtype)
    filter_draws(Work(blocks, request, plan, results, wanted, batch, scratch, saved, steps), dtype)


def _needed(request: Request, plan: Plan, results: Results, scheme: str, dtype: str) -> Steps:
    """The steps that this filter needs."""
    weights, saves = request.weights, bool((plan.slots >= 0).any())
    has_variance = weights.variance != 0.0 or weights.distance != 0.0 or results.estimate.size > 0

    def address(function: Entry, is_needed: bool = True) -> int:
        return function.address_for(dtype) if is_needed else 0

    return Steps(
        begin=address(_take_prior if request.has_prior else _draw_prior),
        resume=address(_resume, saves),
        save=address(_save, saves),
        move=address(_move),
        put_truth=address(_put_truth, request.holds_truth),
        forget=address(_forget),
        weigh=address(_weigh),
        move_again=address(_move_again, request.guided),
        sort=address(_sort, ALL_SCHEMES[scheme].sorts),
        resample=address(_resample),
        scheme=ENTRIES[scheme].address,
        estimate=address(_estimate),
        estimate_variance=address(_estimate_variance, has_variance),
        rank=address(_rank_truth, results.ranks.size > 0),
        finish=address(_finish),
        keep=address(_keep, results.cloud.size > 0),
    )


def _arrays(
    request: Request, plan: Plan, width: int, draws: int, dtype: str
) -> tuple[Batch, Saved, list[NDArray[np.uint8]]]:
    """The arrays of a batch of draws, and their memory."""
    stride, row, slots = draws * width, -(-draws // LANES) * LANES, plan.clouds
    states, quantities, spacious = request.states, request.quantities, stride + SPARE
    sets = request.sets if request.filters > 1 else 0
    memory, arrays = zeros(
        Batch,
        dtype,
        half=1,
        cloud=2 * (states + 1) * stride,
        again=states * stride if request.guided else 0,
        quantity=request.means * stride,
        log_weight=stride,
        log_carried=stride,
        cumulative=stride,
        noise=request.components * spacious,
        weight=stride,
        words=number_of_words(draws, width),
        means=request.means * row,
        moments=4 * quantities * row,
        distance=row,
        total=row,
        error=row,
        weighted=row,
        weighs=row,
        resamples=row,
        degenerate=row,
        first_means=sets * request.instants * quantities * row,
    )
    kept, places = zeros(
        Saved,
        dtype,
        cloud=slots * states * stride,
        weight=slots * stride,
        numbers=slots * 2 * row,
        flags=slots * 2 * row,
    )
    batch = Batch(draws, width, stride, spacious, row, **arrays)
    return batch, Saved(**places), [memory, kept]
