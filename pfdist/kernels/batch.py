"""A batch of draws in a filter: its arrays, and the common parts of the filter's steps.

Arrays of particles are flat. Particle i of the batch's draw d is at the position ``d * width + i``,
where width is the number of particles, rounded up to whole vectors. An array with several rows has
``stride`` entries a row.
"""

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.kernels.ancestors import Resampling, sum_of_first, sum_of_squares, weighted_sum
from pfdist.kernels.blocks import Blocks, call_block
from pfdist.kernels.cached import compiled
from pfdist.kernels.estimators import ErrorWeights
from pfdist.kernels.memory import ahead, call
from pfdist.kernels.prefixes import Plan
from pfdist.kernels.rules import Ruling
from pfdist.kernels.variates import Key, VariateRow

INITIAL, TRANSITION, QUANTITY, DEVIATIONS, ESTIMATE, ERROR, DISTANCE, LOGARITHM, SENSORS = (
    np.arange(9)  # NumPy's: Numba compiles a function again for each integer of Python
)
"""Rows of `Blocks`: what each block computes. The last is the log-likelihood of the first sensor;
those of further sensors follow.

========== =================================== ====================================================
block      from                                to
========== =================================== ====================================================
INITIAL    noise                               x(0)
TRANSITION x, noise                            x(t + 1)
QUANTITY   x                                   z; then the sines of the components that are angles
DEVIATIONS x, mean of z                        squared deviation of each component of z
ESTIMATE   weighted means of QUANTITY          mean of z (of draws)
ERROR      z, its mean                         error of the mean (of draws)
DISTANCE   mean, variance, mean of another     squared distance of the means (of draws)
LOGARITHM  weight                              its logarithm
========== =================================== ====================================================

After the sensors come the blocks of a proposal; see `pfdist.kernels.filter.Extension`.
"""


class FilterRequest(NamedTuple):
    """A request to filter D draws with F filters; T+1 is the number of instants.

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
    is_angle: NDArray[np.uint8]  # (q,): whether each component of z is an angle
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
    log_particles: float
    holds_truth: bool  # whether particle 0 is the truth
    # (sensors,): whether a measurement of each sensor redraws the noise since the last one; empty
    # if the proposal redraws none
    redrawn: NDArray[np.uint8]
    threshold: float  # see `pfdist.kernels.schemes.threshold_of`
    weights: ErrorWeights  # the terms of the estimator
    instant_weights: NDArray[np.float64]  # (T+1,): of each instant's error, mean 1
    components: int  # of the longest process
    # (2, components): kinds of INITIAL_NOISE and PROCESS_NOISE; -1 for none
    kinds: NDArray[np.int64]
    # the estimate of z(t) uses measurements until t + lag, at most; 0 for the filter's
    lag: int
    # (T+1,): the first instant whose estimate uses the measurement at each instant
    first_smoothed: NDArray[np.int64]


INITIAL_NOISE, PROCESS_NOISE = np.arange(2)


class FilterArrays(NamedTuple):
    """The arrays that a filter fills, for D draws and U sets; unneeded ones are empty.

    Every engine gives its results in them; see `pfdist.filters.interface`. In the compiled filter,
    the sets are those of the plan.
    """

    # (D, U): mean over t = 0..T of the errors up to the end of the set, as the true model defines
    # them. Inf marks a draw whose particles are no longer finite. If the truth is among them,
    # NaN marks a degenerate draw.
    mse: NDArray[np.float64]
    # (D, U): whether at some measurement, up to the set's end, no particle has a finite
    # log-likelihood: the filter leaves this measurement out. Bytes in the kernel, at first 0.
    degenerate: NDArray[np.uint8] | NDArray[np.bool_]
    # (D, T+1, q): of a single set, weighted mean and variance of the particles' z(t); NaN after the
    # instant at which a draw became infinite. With a lag they are those over the lines
    estimate: NDArray[np.float64] = np.empty((0, 0, 0))
    variance: NDArray[np.float64] = np.empty((0, 0, 0))
    # (D, T+1): of a single set, the effective sample size after the last measurement of an instant;
    # NaN if there is none, or if no particle explains it
    sizes: NDArray[np.float64] = np.empty((0, 0))
    # (U, T+1): sums over the draws of the weighted errors of each instant; or (D, U, T+1): the
    # errors of each draw, not weighted. The kernel adds to zeros, and leaves out the prefix that a
    # set shares.
    errors: NDArray[np.float64] = np.empty((0, 0))
    # (2, D, T+1, q): of a single set whose particles contain the truth, at measured instants: the
    # share of the weight of particles whose z lies below that of the truth, and of those whose z
    # equals it; NaN elsewhere
    ranks: NDArray[np.float64] = np.empty((2, 0, 0, 0))
    # (D, n, P): the particles of a single set after its last instant, resampled if the filter
    # measured then, NaN if the draw is infinite; of the Kalman filter the mean and the covariance,
    # (D, n, 1 + n)
    cloud: NDArray[np.float64] = np.empty((0, 0, 0))
    weight: NDArray[np.float64] = np.empty((0, 0))  # (D, P): their weights; 1 if none is carried
    # (D, T+1): of a single set, with a lag: the number of lines behind each estimate, see
    # `pfdist.kernels.lines`. NaN where the estimate uses no later measurement: all particles
    lines: NDArray[np.float64] = np.empty((0, 0))
    # (D, T+1, q, P) and (D, T+1, P), of the plain twin: z of particles, and the weights with which
    # they estimate z(t)
    line_z: NDArray[np.float64] = np.empty((0, 0, 0, 0))
    line_weight: NDArray[np.float64] = np.empty((0, 0, 0))
    # (2, D, T+1), of the plain twin, and of lines that move: log evidence of an instant's
    # measurements, and the particles' mean log-likelihood after them; 0 without a measurement
    log_likelihoods: NDArray[np.float64] = np.empty((2, 0, 0))
    # (D, (T+1) sensors): whether a rule measures each draw at each point; else empty. In the
    # kernel, bits as in `Plan.measured`
    measured: NDArray[np.uint8] = np.empty((0, 0), np.uint8)
    # (D,): deviation at a rule's flipped point, NaN where it may not be measured; else empty
    deviation: NDArray[np.float64] = np.empty(0)
    # (1,): particle-steps of particles that move, of all draws and sets
    work: NDArray[np.float64] = np.empty(0)
    # lines of particles that move, of a system whose truth is not known, from the first instant:
    # (D, T+1, c, P) noise of each step, (D, n, P) first states, (D, T+1, sensors) what counts
    noise: NDArray[np.float32] = np.empty((0, 0, 0, 0), np.float32)
    first_states: NDArray[np.float64] = np.empty((0, 0, 0))
    counts: NDArray[np.uint8] = np.empty((0, 0, 0), np.uint8)


class Wanted(NamedTuple):
    """The optional results that are needed besides the mse, the ranks and the cloud."""

    moments: bool
    errors: bool
    errors_stride: int  # distance of two draws in `errors`; 0 for sums over the draws


class CloudBatch(NamedTuple):
    """The arrays of a batch of draws; a row has a number for each particle, or for each draw."""

    draws: int  # the most that it holds
    width: int
    stride: int  # of rows of particles
    spacious: int  # of rows of noise
    row: int  # of rows of draws
    half: NDArray[np.int64]  # (1,): which half of the cloud counts
    # of particles: two halves with n states; a step reads one half and writes the other
    cloud: NDArray[np.float64]
    quantity: NDArray[np.float64]  # z, with cosines and sines of angles; squared deviations
    log_weight: NDArray[np.float64]
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


class SavedBatches(NamedTuple):
    """Batches from which later sets resume, one for each slot of the plan."""

    cloud: NDArray[np.float64]  # (slots, n * stride)
    weight: NDArray[np.float32]  # (slots, stride)
    numbers: NDArray[np.float64]  # (slots, 2, row): `total` and `error`
    flags: NDArray[np.uint8]  # (slots, 2, row): `weighted` and `degenerate`


class Steps(NamedTuple):
    """The addresses of the steps of a filter; 0 for an unneeded step.

    So a step is compiled alone, and only if a filter needs it, see `pfdist.kernels.cached.Entry`.
    """

    begin: int
    resume: int
    save: int
    move: int
    put_truth: int
    forget: int
    weigh: int
    tell: int
    resample: int
    scheme: int  # one of `pfdist.kernels.ancestors.ENTRIES`
    estimate: int
    estimate_variance: int
    rank: int
    finish: int
    keep: int
    # of a proposal that redraws noise since the last measurement: where paths begin, the redrawing,
    # the logarithms of the old density over the new one, and what undoes it
    set_out: int = 0
    redraw: int = 0
    add_ratio: int = 0
    leave_out: int = 0


class Lines(NamedTuple):
    """The ancestral lines of a batch's particles; see `pfdist.kernels.lines`.

    Arrays begin with the instant. All are empty if the filter keeps no lines.
    """

    # of particles; a second half where noise is redrawn: on the paths that result
    quantity: NDArray[np.float64]  # (T+1, means, stride): results of the block QUANTITY
    weight: NDArray[np.float32]  # (T+1, stride): at measured instants, before resampling
    # (T+1, sensors + 1, stride): ancestors by each resampling before a sensor, and by the last
    ancestor: NDArray[np.int32]
    moved: NDArray[np.uint8]  # (T+1, sensors + 1, row): whether each draw was resampled
    flow: NDArray[np.float64]  # (2, stride): weights of the lines through each particle, or zeros
    listed: NDArray[np.int32]  # (stride,): first in each draw, the particles with such a weight
    # of draws
    number: NDArray[np.int64]  # (row,): of these particles
    # (row,): of `flow`, once lines have met; before, -1: weights are those of particles
    half: NDArray[np.int64]
    # (T+1, rows, row): weighted means of `quantity`, then variances: the filter's,
    means: NDArray[np.float64]
    smoothed: NDArray[np.float64]  # and those over the lines
    total: NDArray[np.float64]  # (row,): sum of the weights
    rows: int  # of means, and of variances if they are needed
    # addresses of the filter's own steps
    resample: int = 0
    finish: int = 0


class FilterCall(NamedTuple):
    """The data that all functions of a filter share."""

    blocks: Blocks
    request: FilterRequest
    plan: Plan
    results: FilterArrays
    wanted: Wanted
    batch: CloudBatch
    scratch: Resampling
    saved: SavedBatches
    steps: Steps
    lines: Lines
    rule: Ruling
    own: int = 0  # address of what else the steps of a proposal need


class At(NamedTuple):
    """A batch, and the filter of its draws."""

    work: Annotated[int, FilterCall]  # address
    stream: np.uint64  # key of the filter's noise
    number: int  # of the filter
    first: int  # row of the batch's first draw in the arrays
    draws: int  # number of draws


class Instant(NamedTuple):
    """An instant, in the form that a step of a filter receives."""

    at: At
    s: int  # the set
    t: int
    sensors: int  # a bit for each sensor that measures
    sensor: int  # whose turn it is


class Slot(NamedTuple):
    """A batch, and the place where it is saved."""

    at: At
    slot: int


@compiled
def present(at):
    """The half of the cloud with the current particles."""
    request, batch = at.work.request, at.work.batch
    return ahead(batch.cloud, batch.half[0] * request.states * batch.stride)


@compiled
def other(at):
    """The half of the cloud to which a step writes."""
    request, batch = at.work.request, at.work.batch
    return ahead(batch.cloud, (1 - batch.half[0]) * request.states * batch.stride)


@compiled
def copy_numbers(source, target, count):
    """Copy successive numbers."""
    for i in range(count):
        target[i] = source[i]


@compiled
def fill_noise(at, process, t, role):
    """Fill a row of noise for each component of a process."""
    fill_rows(at, process, t, role, at.work.batch.noise)


@compiled
def fill_rows(at, process, t, role, noise):
    """Fill rows of noise from a pointer on."""
    request, batch = at.work.request, at.work.batch
    for c in range(request.components):
        kind = request.kinds[process * request.components + c]
        if kind >= 0:
            row = VariateRow(
                batch.words, ahead(noise, c * batch.spacious), batch.width, kind,
                Key(at.stream, t, role, c), request.first_draw + at.first, at.draws,
            )  # fmt: skip
            call(at.work.scratch.fill, row)


@compiled
def of_particles(at, block, t, source, target):
    """Call a block for all particles of the batch: from states and noise to rows of particles."""
    blocks, request, batch = at.work.blocks, at.work.request, at.work.batch
    which, stride = block * request.instants + t, batch.stride
    call_block(
        blocks,
        which,
        (target, stride),
        (source, stride),
        (batch.noise, batch.spacious),
        (batch.means, 0, 0),
        (1, at.draws * batch.width),
    )


@compiled
def with_given(at, block, t, source, target, given, of_draw, of_component):
    """Call a block that also receives numbers of each draw, from a pointer on with two strides."""
    blocks, request, batch = at.work.blocks, at.work.request, at.work.batch
    which, stride = block * request.instants + t, batch.stride
    call_block(
        blocks,
        which,
        (target, stride),
        (source, stride),
        (batch.noise, batch.spacious),
        (given, of_draw, of_component),
        (at.draws, batch.width),
    )


@compiled
def of_draws(at, block, t, source, target):
    """Call a block for all draws of the batch: from rows of draws to other rows."""
    blocks, request, batch = at.work.blocks, at.work.request, at.work.batch
    which, row = block * request.instants + t, batch.row
    call_block(
        blocks,
        which,
        (target, row),
        (source, row),
        (batch.noise, 0),
        (batch.means, 0, 0),
        (1, row),
    )


@compiled
def sensors_at(at, t, component):
    """The pointer to a component of y(t) of the batch's first draw."""
    request = at.work.request
    instant = at.first * request.instants + t
    return ahead(request.y, instant * request.measurements + component)


@compiled
def is_drawn_again(instant):
    """Whether noise is redrawn before a measurement: only for the first sensor of an instant."""
    request = instant.at.work.request
    if instant.at.work.steps.redraw == 0 or request.redrawn[instant.sensor] == 0:
        return False
    is_first = instant.sensors & ((1 << instant.sensor) - 1) == 0
    return is_first and (instant.t > 0 or not request.has_prior)


@compiled
def measuring(at, s, t):
    """The sensors that measure, a bit for each: the last of 64 is the sign."""
    request, measured, sensors = at.work.request, at.work.plan.measured, np.int64(0)
    width = (request.sensors + 7) // 8
    for place in range(width):
        byte = np.int64(measured[(s * request.instants + t) * width + place])
        sensors |= byte << (8 * place)
    return sensors


@compiled
def fill_mean(at, values, mean):
    """Fill a row with the weighted mean of each draw's particles."""
    request, batch = at.work.request, at.work.batch
    for d in range(at.draws):
        origin = d * batch.width
        if batch.weighted[d]:
            value = weighted_sum(batch.weight, values, origin, batch.width)
        else:
            value = sum_of_first(values, origin, request.particles)
        mean[d] = value / batch.total[d]


@compiled
def fill_mean_of_z(at, t, mean):
    """Fill rows of draws with the weighted mean of each component of z."""
    request, batch, cloud = at.work.request, at.work.batch, present(at)
    if request.is_state:
        for r in range(request.means):
            values = ahead(cloud, request.components_of_state[r] * batch.stride)
            fill_mean(at, values, ahead(batch.means, r * batch.row))
    else:
        of_particles(at, QUANTITY, t, cloud, batch.quantity)
        _fill_means(at, batch.means, request.means)
    of_draws(at, ESTIMATE, t, batch.means, mean)


@compiled
def fill_variances(at, t, mean, variance):
    """Fill rows of draws with the variance of each component of z around a mean."""
    batch = at.work.batch
    with_given(at, DEVIATIONS, t, present(at), batch.quantity, mean, 1, batch.row)
    _fill_means(at, variance, at.work.request.quantities)


@compiled
def _fill_means(at, means, rows):
    """Fill rows of draws with the weighted means of z, or of squared deviations."""
    batch = at.work.batch
    for r in range(rows):
        values = ahead(batch.quantity, r * batch.stride)
        fill_mean(at, values, ahead(means, r * batch.row))


@compiled
def record_sizes(at, t):
    """Record the effective sample sizes of draws that the instant's last measurement weighed.

    Source: Kong, Liu, Wong, "Sequential imputations and Bayesian missing data problems", Journal of
    the American Statistical Association 89, 1994.
    """
    request, results, batch = at.work.request, at.work.results, at.work.batch
    for d in range(at.draws):
        if batch.weighs[d] and batch.error[d] < np.inf:
            squares = sum_of_squares(batch.weight, d * batch.width, batch.width)
            place = (at.first + d) * request.instants + t
            results.sizes[place] = batch.total[d] * batch.total[d] / squares


@compiled
def add_variances(at, s, t, mean, variance):
    """Record mean and variance, and add the part of the error that they estimate.

    Each filter contributes its variance, by the estimator's weights. The first of two filters
    stores its mean, and the second adds the distance to it, as `pfdist.filters.interface` does.
    """
    request, batch = at.work.request, at.work.batch
    if at.work.wanted.moments:
        _record(at, t, mean, variance)
    has_distance = request.filters > 1
    if has_distance:
        _measure_distance(at, t, s, mean)
    for d in range(at.draws):
        error = 0.0
        if request.weights.variance != 0.0:  # else an infinite variance would make a NaN
            for c in range(request.quantities):
                error += variance[c * batch.row + d]
            error *= request.weights.variance
        if has_distance and at.number > 0:
            error += request.weights.distance * batch.distance[d]
        add_error(at, s, t, d, error, request.instant_weights[t])


@compiled
def _record(at, t, mean, variance):
    request, results, batch = at.work.request, at.work.results, at.work.batch
    for d in range(at.draws):
        if batch.error[d] < np.inf:
            first = ((at.first + d) * request.instants + t) * request.quantities
            for c in range(request.quantities):
                results.estimate[first + c] = mean[c * batch.row + d]
                results.variance[first + c] = variance[c * batch.row + d]


@compiled
def _measure_distance(at, t, s, mean):
    """Keep the means of the first filter; the second measures the distance of its own to these."""
    request, batch = at.work.request, at.work.batch
    count = request.quantities * batch.row
    first_means = ahead(batch.first_means, (s * request.instants + t) * count)
    if at.number == 0:
        copy_numbers(mean, first_means, count)
    else:
        copy_numbers(first_means, ahead(mean, 2 * count), count)
        of_draws(at, DISTANCE, t, mean, batch.distance)


@compiled
def add_squared_errors(at, s, t):
    """Add the errors of the means of z in `moments`; let draws with another sum be infinite."""
    request, batch = at.work.request, at.work.batch
    quantities, weights = request.quantities, request.weights
    if weights.squared_error != 0.0:
        for d in range(at.draws):
            z = ahead(request.z, ((at.first + d) * request.instants + t) * quantities)
            for c in range(quantities):
                batch.moments[c * batch.row + d] = z[c]
        of_draws(at, ERROR, t, batch.moments, batch.distance)
        for d in range(at.draws):
            error = weights.squared_error * batch.distance[d]
            add_error(at, s, t, d, error, request.instant_weights[t])
    for d in range(at.draws):
        if not batch.error[d] < np.inf:
            batch.error[d] = np.inf


@compiled
def add_error(at, s, t, d, error, weight):
    """Add an error, by the instant's weight, to those of a draw that has not ended.

    An instant of weight 0 does not count, even if its error is infinite. If they are wanted, add it
    also to the errors at the instant: weighted to a sum over the draws, and else as it is.
    """
    request, results, wanted, batch = (
        at.work.request,
        at.work.results,
        at.work.wanted,
        at.work.batch,
    )
    if not batch.error[d] < np.inf:
        return
    stride = wanted.errors_stride
    place = (at.first + d) * stride + s * request.instants + t
    if stride > 0:
        results.errors[place] += error
    if weight != 0.0:
        batch.error[d] += weight * error
        if wanted.errors and stride == 0:
            results.errors[place] += weight * error
