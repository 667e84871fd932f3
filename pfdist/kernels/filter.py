"""The intermittent particle filter (paper, section 2.1) for any model, compiled once per machine.

A model is a set of blocks: machine code that is called by its address, see
`pfdist.kernels.blocks`. All else is here, and in the extension of a proposal. Several draws go
through an instant in lockstep, as a *batch*, so that a step has enough particles; see
`pfdist.kernels.batch`. No result depends on the size of a batch.
"""

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from pfdist.kernels import lines
from pfdist.kernels.ancestors import (
    ENTRIES,
    Drawn,
    Search,
    resampling_scratch,
    sum_of_squares,
    sum_of_weights,
    take_ancestors,
    weigh,
)
from pfdist.kernels.batch import (
    INITIAL,
    INITIAL_NOISE,
    LOGARITHM,
    PROCESS_NOISE,
    QUANTITY,
    SENSORS,
    TRANSITION,
    At,
    CloudBatch,
    FilterArrays,
    FilterCall,
    FilterRequest,
    Instant,
    Lines,
    SavedBatches,
    Slot,
    Steps,
    Wanted,
    add_squared_errors,
    add_variances,
    copy_numbers,
    fill_mean_of_z,
    fill_noise,
    fill_variances,
    is_drawn_again,
    measuring,
    of_particles,
    other,
    present,
    record_sizes,
    sensors_at,
)
from pfdist.kernels.blocks import Compiled, Source, call_block
from pfdist.kernels.cached import Entry, compiled, entry
from pfdist.kernels.deciding import is_measured, with_measured
from pfdist.kernels.log_evidence import add_log_evidence
from pfdist.kernels.memory import ahead, call, read, zeros
from pfdist.kernels.prefixes import Plan
from pfdist.kernels.rules import Ruling
from pfdist.kernels.variates import FILTER_INITIAL, FILTER_PROCESS, SPARE, number_of_words
from pfdist.kernels.vectors import LANES


@entry(FilterCall)
def filter_draws(work):
    """Filter all draws with all sets of a plan.

    The innermost loop goes over sets in the plan's order: a set resumes from a batch that an
    earlier set saved for the same draws and filter. The filter of a set pauses at each instant at
    which a later set resumes.
    """
    request, batch = work.request, work.batch
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
    plan, steps = at.work.plan, at.work.steps
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
            _filter_instant(at, s, t, resamples)
        if plan.slots[k] >= 0:
            call(steps.save, Slot(at, plan.slots[k]))
    call(steps.finish, Instant(at, s, 0, 0, 0))


@compiled
def _filter_instant(at, s, t, resamples):
    """Propagate, weight, estimate and resample; sensors weigh in their turn.

    The cloud is also resampled between two sensors, but not propagated. The estimate comes before
    the last resampling, which adds noise.
    """
    request, steps = at.work.request, at.work.steps
    _predict(Instant(at, s, t, 0, 0))
    sensors = measuring(at, s, t)
    instant = Instant(at, s, t, sensors, 0)
    if steps.set_out != 0 and t == 0:  # with a prior, the path to the first measurement begins here
        call(steps.set_out, instant)
    if sensors != 0:
        call(steps.forget, instant)
        for sensor in range(request.sensors):
            if (sensors >> sensor) & 1:
                _measure(Instant(at, s, t, sensors, sensor))
    call(steps.estimate, instant)
    if sensors != 0 and steps.rank != 0:
        call(steps.rank, instant)
    if sensors != 0 and resamples:
        call(steps.resample, Instant(at, s, t, sensors, request.sensors))
        if steps.set_out != 0:
            call(steps.set_out, instant)


@compiled
def _predict(instant):
    """Propagate to an instant; then a rule decides whether it is measured."""
    steps = instant.at.work.steps
    if instant.t > 0:
        call(steps.move, instant)
    if steps.put_truth != 0:
        call(steps.put_truth, instant)
    if instant.at.work.rule.decide != 0:
        call(instant.at.work.rule.decide, instant)


@compiled
def _measure(measurement):
    """Weigh the particles by a sensor."""
    steps = measurement.at.work.steps
    call(steps.resample, measurement)
    if measurement.at.work.rule.replicates.penalise != 0:
        call(measurement.at.work.rule.replicates.penalise, measurement)
    if is_drawn_again(measurement):
        call(steps.redraw, measurement)
    call(steps.weigh, measurement)
    if steps.leave_out != 0:
        call(steps.leave_out, measurement)


# --- the first cloud, and steps -------------------------------------------------------------------


@entry(Slot)
def _resume(place):
    """Fill the first half from a saved batch."""
    at, slot = read(place)
    request, saved, batch = at.work.request, at.work.saved, at.work.batch
    count, row = request.states * batch.stride, batch.row
    batch.half[0] = 0
    copy_numbers(ahead(saved.cloud, slot * count), batch.cloud, count)
    copy_numbers(ahead(saved.weight, slot * batch.stride), batch.weight, batch.stride)
    copy_numbers(ahead(saved.numbers, 2 * slot * row), batch.total, row)
    copy_numbers(ahead(saved.numbers, (2 * slot + 1) * row), batch.error, row)
    copy_numbers(ahead(saved.flags, 2 * slot * row), batch.weighted, row)
    copy_numbers(ahead(saved.flags, (2 * slot + 1) * row), batch.degenerate, row)


@entry(Slot)
def _save(place):
    """Save the batch, because a later set resumes from it."""
    at, slot = read(place)
    request, saved, batch = at.work.request, at.work.saved, at.work.batch
    count, row = request.states * batch.stride, batch.row
    copy_numbers(present(at), ahead(saved.cloud, slot * count), count)
    copy_numbers(batch.weight, ahead(saved.weight, slot * batch.stride), batch.stride)
    copy_numbers(batch.total, ahead(saved.numbers, 2 * slot * row), row)
    copy_numbers(batch.error, ahead(saved.numbers, (2 * slot + 1) * row), row)
    copy_numbers(batch.weighted, ahead(saved.flags, 2 * slot * row), row)
    copy_numbers(batch.degenerate, ahead(saved.flags, (2 * slot + 1) * row), row)


@compiled
def begin_sums(at):
    """Begin a set with an empty sum of errors."""
    request, batch = at.work.request, at.work.batch
    batch.half[0] = 0
    for d in range(at.draws):
        batch.total[d], batch.error[d] = float(request.particles), 0.0
        batch.weighted[d] = batch.weighs[d] = batch.degenerate[d] = 0


@entry(Instant)
def _draw_prior(instant):
    """Begin a set with x(0) in the first half."""
    at = read(instant).at
    batch = at.work.batch
    begin_sums(at)
    fill_noise(at, INITIAL_NOISE, np.int64(0), FILTER_INITIAL)
    of_particles(at, INITIAL, np.int64(0), batch.cloud, batch.cloud)


@entry(Instant)
def _take_prior(instant):
    """Begin a set with particles of the prior, and their weights, in the first half."""
    at = read(instant).at
    request, batch = at.work.request, at.work.batch
    particles, width, stride = request.particles, batch.width, batch.stride
    begin_sums(at)
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


@entry(Instant)
def _move(instant):
    """Fill the other half with x(t)."""
    at, _, t, _, _ = read(instant)
    request, batch = at.work.request, at.work.batch
    fill_noise(at, PROCESS_NOISE, request.start + t - 1, FILTER_PROCESS)
    of_particles(at, TRANSITION, t - 1, present(at), other(at))
    batch.half[0] = 1 - batch.half[0]


@entry(Instant)
def _put_truth(instant):
    """Let particle 0 of each draw be the truth."""
    at, _, t, _, _ = read(instant)
    request, batch, cloud = at.work.request, at.work.batch, present(at)
    for d in range(at.draws):
        x = ahead(request.x, ((at.first + d) * request.instants + t) * request.states)
        for c in range(request.states):
            cloud[c * batch.stride + d * batch.width] = x[c]


# --- measurements ---------------------------------------------------------------------------------


@entry(Instant)
def _forget(instant):
    """Forget which draws were weighed before this instant."""
    at = read(instant).at
    batch = at.work.batch
    for d in range(at.draws):
        batch.weighs[d] = 0


@entry(Instant)
def _weigh(instant):
    """Weigh the particles by a sensor.

    If no particle explains a measurement, the draw is degenerate, and the measurement is left out.
    """
    at, _, t, _, _ = read(instant)
    request, batch = at.work.request, at.work.batch
    _fill_log_weights(read(instant))
    for d in range(at.draws):
        if not is_measured(at, t, d):
            continue
        total = weigh(
            batch.log_weight, d * batch.width, batch.width, request.particles, batch.weight,
            batch.cumulative,
        )  # fmt: skip
        batch.weighs[d] = total > 0.0
        if total > 0.0:
            batch.weighted[d], batch.total[d] = 1, total
        elif batch.error[d] < np.inf:
            batch.degenerate[d] = 1
    if at.work.steps.tell != 0:
        call(at.work.steps.tell, read(instant))


@compiled
def _fill_log_weights(instant):
    """Log-likelihoods, with the logarithms of a proposal and of carried weights."""
    at, _, t, _, sensor = instant
    blocks, request, batch = at.work.blocks, at.work.request, at.work.batch
    cloud, used = present(at), at.draws * batch.width
    y = sensors_at(at, t, request.first_components[sensor])
    of_draw, block = request.instants * request.measurements, SENSORS + sensor
    with_measured(at, block, t, cloud, batch.log_weight, y, of_draw, 1)
    if is_drawn_again(instant):
        call(at.work.steps.add_ratio, instant)
    if request.threshold < np.inf:
        which = LOGARITHM * request.instants
        call_block(
            blocks,
            which,
            (batch.log_carried, batch.stride),
            (batch.cloud, 0),
            (batch.weight, 0),
            (batch.means, 0, 0),
            (1, used),
        )
        for d in range(at.draws):
            if batch.weighted[d]:
                for i in range(d * batch.width, (d + 1) * batch.width):
                    batch.log_weight[i] += batch.log_carried[i]


@compiled
def _is_uneven(request, batch, d):
    """Whether the effective sample size of a draw lies below the threshold.

    The largest weight is 1, so weights are equal if their sum is the number of particles: then the
    measurement has told nothing.
    """
    if request.threshold == np.inf:
        return batch.total[d] < float(request.particles)
    squares = sum_of_squares(batch.weight, d * batch.width, batch.width)
    return batch.total[d] * batch.total[d] < request.threshold * request.particles * squares


@entry(Instant)
def resample_cloud(instant):
    """Resample the draws that the last measurement of the instant weighed.

    Behind all sensors, only those with uneven weights are resampled.
    """
    at, _, t, _, sensor = read(instant)
    request, batch, scratch = at.work.request, at.work.batch, at.work.scratch
    some, every = False, True
    for d in range(at.draws):
        weighs = batch.weighs[d] > 0
        uneven = _is_uneven(request, batch, d)
        batch.resamples[d] = weighs and (
            uneven or (sensor < request.sensors and request.threshold < np.inf)
        )
        some |= batch.resamples[d] > 0
        every &= batch.resamples[d] > 0
    if not some:
        return
    key = (request.start + t) * request.sensors + sensor - 1
    first = request.first_draw + at.first
    drawn = Drawn(at.stream, key, first, at.draws, batch.width, request.particles)
    search = Search(batch.cumulative, batch.resamples, request.holds_truth, drawn, scratch)
    call(at.work.steps.scheme, search)
    for d in range(at.draws):
        if not batch.resamples[d]:
            continue
        for c in range(request.states):
            row, origin = c * batch.stride, d * batch.width
            source, target = ahead(present(at), row), ahead(other(at), row)
            take_ancestors(scratch, source, target, d, batch.width)
            if not every:  # the other draws stay in place
                copy_numbers(ahead(target, origin), ahead(source, origin), batch.width)
        batch.weighted[d], batch.total[d] = 0, float(request.particles)
    if every:
        batch.half[0] = 1 - batch.half[0]


# --- estimates and errors -------------------------------------------------------------------------


@entry(Instant)
def _estimate(instant):
    """Estimate z(t) of each draw, and add the errors."""
    instant = read(instant)
    at, s, t, _, _ = instant
    request, steps, batch = at.work.request, at.work.steps, at.work.batch
    fill_mean_of_z(at, t, ahead(batch.moments, request.quantities * batch.row))
    if steps.estimate_variance != 0:
        call(steps.estimate_variance, instant)
    add_squared_errors(at, s, t)


@entry(Instant)
def _estimate_variance(instant):
    """Compute the variance of z, and what follows from it."""
    at, s, t, sensors, _ = read(instant)
    request, batch = at.work.request, at.work.batch
    quantities, row = request.quantities, batch.row
    mean = ahead(batch.moments, quantities * row)
    variance = ahead(mean, quantities * row)
    fill_variances(at, t, mean, variance)
    if at.work.wanted.moments and sensors != 0:
        record_sizes(at, t)
    add_variances(at, s, t, mean, variance)


@entry(Instant)
def _rank_truth(instant):
    """The place of the truth's z, which is that of particle 0, among the weighted particles."""
    at, _, t, _, _ = read(instant)
    results, request, batch = at.work.results, at.work.request, at.work.batch
    half = request.draws * request.instants * request.quantities
    of_particles(at, QUANTITY, t, present(at), batch.quantity)
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
        at.work.request, at.work.results, at.work.batch, at.work.steps.keep,
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
    at = read(instant).at
    request, results, batch = at.work.request, at.work.results, at.work.batch
    cloud, particles = present(at), request.particles
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
_MOST_SAVED = 2**22  # numbers of all saved batches and of the noise of paths, about


class Extension(Protocol):
    """The steps that a proposal adds to a filter, and what they need."""

    @property
    def redrawn(self) -> tuple[bool, ...]:
        """Whether a measurement of each sensor redraws the noise since the last one; or empty."""

    @property
    def blocks(self) -> Mapping[int, Source]:
        """Blocks beyond those of all sensors, by their place."""

    def together(self, request: FilterRequest, plan: Plan, width: int) -> int:
        """The most draws of a batch, for rows of so many particles."""

    def planned(self, request: FilterRequest, plan: Plan) -> Plan:
        """The plan of the filter, whose saved batches fit into memory."""

    def arranged(
        self,
        request: FilterRequest,
        plan: Plan,
        results: FilterArrays,
        batch: CloudBatch,
        kept: Lines,
        steps: Steps,
    ) -> tuple[Steps, int, Any]:
        """The steps, and the address of their own data with the memory that holds it."""


def filter_all(
    compiled: Compiled, request: FilterRequest, plan: Plan, results: FilterArrays, scheme: str,
    rule: Ruling, extension: Extension | None = None,
) -> None:  # fmt: skip
    """Filter all draws, in arrays that each call allocates, so that threads can run in parallel.

    The number of particles that a Python function receives does not depend on the rest of the
    request.
    """
    if extension is not None:
        plan = extension.planned(request, plan)
    width = -(-request.particles // LANES) * LANES
    numbers = request.states * width * max(1, plan.clouds)
    if request.lag:
        numbers += request.instants * (request.means + request.sensors + 1) * width
    draws = max(1, min(request.draws, _TOGETHER // width, _MOST_SAVED // numbers))
    if compiled.together is not None:
        is_alone = not request.x.size  # a system whose truth is not known, see `OneFilter`
        draws = 1 if is_alone else max(1, compiled.together // width)
    if extension is not None:
        draws = min(draws, extension.together(request, plan, width))
    draws = min(draws, rule.together)
    batch, saved, kept, _memory = _arrays(
        request, plan, width, draws, _has_variance(request, results)
    )
    stride = results.errors[:1].size if results.errors.ndim == 3 else 0
    wanted = Wanted(results.estimate.size > 0, results.errors.size > 0, stride)
    scratch = resampling_scratch(draws, width)
    steps, own, _its_memory = _needed(request, plan, results, scheme), 0, None
    if extension is not None:
        steps, own, _its_memory = extension.arranged(request, plan, results, batch, kept, steps)
    filter_draws(
        FilterCall(
            compiled.blocks, request, plan, results, wanted, batch, scratch, saved, steps, kept,
            rule, own,
        )
    )  # fmt: skip


def _has_variance(request: FilterRequest, results: FilterArrays) -> bool:
    weights = request.weights
    return weights.variance != 0.0 or weights.distance != 0.0 or results.estimate.size > 0


def _needed(request: FilterRequest, plan: Plan, results: FilterArrays, scheme: str) -> Steps:
    saves = bool((plan.slots >= 0).any())

    def address(function: Entry, is_needed: bool = True) -> int:
        return function.address if is_needed else 0

    steps = Steps(
        begin=address(_take_prior if request.has_prior else _draw_prior),
        resume=address(_resume, saves),
        save=address(_save, saves),
        move=address(_move),
        put_truth=address(_put_truth, request.holds_truth),
        forget=address(_forget),
        weigh=address(_weigh),
        tell=address(add_log_evidence, request.weights.evidence != 0.0),
        resample=address(resample_cloud),
        scheme=ENTRIES[scheme].address,
        estimate=address(_estimate),
        estimate_variance=address(_estimate_variance, _has_variance(request, results)),
        rank=address(_rank_truth, request.holds_truth and results.ranks.size > 0),
        finish=address(_finish),
        keep=address(_keep, results.cloud.size > 0),
    )
    if not request.lag:
        return steps
    return steps._replace(
        estimate=lines.estimate.address,
        estimate_variance=0,
        resample=lines.resample.address,
        finish=lines.finish.address,
    )


def _arrays(
    request: FilterRequest, plan: Plan, width: int, draws: int, has_variance: bool
) -> tuple[CloudBatch, SavedBatches, Lines, list[NDArray[np.uint8]]]:
    """The arrays of a batch of draws, and their memory."""
    stride, row, slots = draws * width, -(-draws // LANES) * LANES, plan.clouds
    states, quantities, spacious = request.states, request.quantities, stride + SPARE
    sets = request.sets if request.filters > 1 else 0
    memory, arrays = zeros(
        CloudBatch,
        half=1,
        cloud=2 * states * stride,
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
        SavedBatches,
        cloud=slots * states * stride,
        weight=slots * stride,
        numbers=slots * 2 * row,
        flags=slots * 2 * row,
    )
    instants, events = (request.instants if request.lag else 0), request.sensors + 1
    moments = request.means + quantities * has_variance
    of_lines, rows = zeros(
        Lines,
        quantity=instants * request.means * stride * (2 if request.redrawn.size else 1),
        weight=instants * stride,
        ancestor=instants * events * stride,
        moved=instants * events * row,
        flow=2 * stride if instants else 0,
        listed=stride if instants else 0,
        number=row if instants else 0,
        half=row if instants else 0,
        means=instants * moments * row,
        smoothed=instants * moments * row,
        total=row if instants else 0,
    )
    batch = CloudBatch(draws, width, stride, spacious, row, **arrays)
    own = {"resample": resample_cloud, "finish": _finish} if instants else {}
    rows |= {"rows": moments} | {name: step.address for name, step in own.items()}
    return batch, SavedBatches(**places), Lines(**rows), [memory, kept, of_lines]
