"""The estimate of z(t) that uses later measurements, by the particles' ancestral lines.

The filter keeps z of all particles at each instant, and the ancestors at each resampling. At the
end of a set, the weights of a measurement go back along the lines: the weight of a particle at t is
the sum over its descendants. So the estimate of z(t) is a weighted mean over those particles at t
that have descendants, which become few soon. No transition density is needed.

With a lag, z(t) is estimated by the lines of the last measurement until t + lag, before it is
resampled. If this measurement lies before t, the estimate is the filter's.

Sets come in the order of a tree, see `pfdist.kernels.prefixes`. So when a set resumes from a saved
batch at t, all that is kept of the instants before t is still that of the shared prefix.

Source: Kitagawa, "Monte Carlo filter and smoother for non-Gaussian nonlinear state space models",
Journal of Computational and Graphical Statistics 5, 1996 (storing the state vector; fixed lag).
"""

import numpy as np

from pfdist.kernels.ancestors import sum_of_weights, weighted_sum
from pfdist.kernels.batch import (
    ESTIMATE,
    QUANTITY,
    Instant,
    add_squared_errors,
    add_variances,
    copy_numbers,
    fill_mean,
    is_drawn_again,
    measuring,
    of_draws,
    of_particles,
    present,
    record_sizes,
)
from pfdist.kernels.cached import compiled, entry
from pfdist.kernels.memory import ahead, call, read

_FEW = np.int64(4)  # fewer lines than one in so many particles are added up one by one


@entry(Instant)
def estimate(instant):
    """Keep z and its mean, and at a measurement also the weights."""
    at, _, t, sensors, _ = read(instant)
    request, batch, lines = at.work.request, at.work.batch, at.work.lines
    keep_means(at, t, present(at))
    if sensors == 0:
        return
    for d in range(at.draws):
        origin = d * batch.width
        weight = ahead(lines.weight, t * batch.stride + origin)
        if batch.weighted[d]:
            copy_numbers(ahead(batch.weight, origin), weight, batch.width)
        else:
            for i in range(batch.width):
                weight[i] = np.float32(1.0 if i < request.particles else 0.0)
    if at.work.wanted.moments:
        record_sizes(at, t)


@compiled
def keep_means(at, t, cloud):
    """Keep z of particles at an instant, and its mean."""
    batch, lines = at.work.batch, at.work.lines
    z, means = quantity_at(at, t), ahead(lines.means, t * lines.rows * batch.row)
    of_particles(at, QUANTITY, t, cloud, z)
    for r in range(lines.rows):
        values = _values(at, z, means, r)
        fill_mean(at, values, ahead(means, r * batch.row))


@entry(Instant)
def resample(instant):
    """Resample, and keep the ancestors."""
    instant = read(instant)
    at, event = instant.at, _event(instant.at, instant.t, instant.sensor)
    batch, lines, scratch = at.work.batch, at.work.lines, at.work.scratch
    call(lines.resample, instant)
    for d in range(at.draws):
        lines.moved[event * batch.row + d] = batch.resamples[d]
        if batch.resamples[d]:
            ancestors = ahead(lines.ancestor, event * batch.stride + d * batch.width)
            copy_numbers(ahead(scratch.ancestor, d * scratch.span), ancestors, batch.width)


@entry(Instant)
def finish(instant):
    """Estimate z of all instants by the lines, and write the results of a set."""
    instant = read(instant)
    at, s, _, _, _ = instant
    request, batch, lines = at.work.request, at.work.batch, at.work.lines
    end, size = at.work.plan.ends[s], lines.rows * batch.row
    copy_numbers(lines.means, lines.smoothed, end * size)
    behind = end  # the estimates from here on are known
    for m in range(end - 1, -1, -1):
        first = request.first_smoothed[m]
        if first < behind and measuring(at, s, m) != 0:
            _trace(at, s, m, first, min(m + 1, behind))
            behind = first
    add_errors(at, s)
    call(lines.finish, instant)


@compiled
def add_errors(at, s):
    """Add the errors of the smoothed estimates of a set."""
    request, batch, lines = at.work.request, at.work.batch, at.work.lines
    mean = ahead(batch.moments, request.quantities * batch.row)
    for t in range(at.work.plan.ends[s]):
        means = ahead(lines.smoothed, t * lines.rows * batch.row)
        of_draws(at, ESTIMATE, t, means, mean)
        if lines.rows > request.means:
            variance = ahead(mean, request.quantities * batch.row)
            _fill_variances(at, means, variance)
            add_variances(at, s, t, mean, variance)
        add_squared_errors(at, s, t)


@compiled
def _fill_variances(at, means, variance):
    """Fill the variances of z from the moments of an instant: 1 - R of an angle."""
    request, row = at.work.request, at.work.batch.row
    cosine = ahead(means, request.quantities * row)
    for c in range(request.quantities):
        of_component = ahead(variance, c * row)
        copy_numbers(ahead(means, (request.means + c) * row), of_component, row)
        if request.is_angle[c]:
            for d in range(at.draws):
                squares = cosine[d] * cosine[d] + cosine[row + d] * cosine[row + d]
                of_component[d] = max(0.0, 1.0 - np.sqrt(squares))
            cosine = ahead(cosine, 2 * row)


@compiled
def _values(at, z, means, row):
    """The numbers of particles whose mean a row has: those of z, or its squared deviations."""
    request, batch = at.work.request, at.work.batch
    c = row - request.means
    if c < 0:
        return ahead(z, row * batch.stride)
    for d in range(at.draws):
        mean = means[c * batch.row + d]
        for i in range(d * batch.width, (d + 1) * batch.width):
            difference = z[c * batch.stride + i] - mean
            batch.quantity[i] = difference * difference
    return batch.quantity


@compiled
def _event(at, t, number):
    return t * (at.work.request.sensors + 1) + number


@compiled
def quantity_at(at, row):
    """The rows of z at an instant; those of redrawn paths come after those of all instants."""
    stride = at.work.batch.stride
    return ahead(at.work.lines.quantity, row * at.work.request.means * stride)


@compiled
def _trace(at, s, m, first, behind):
    """Estimate z at the instants from `first`, before `behind`, by the lines of a measurement."""
    request, batch, lines = at.work.request, at.work.batch, at.work.lines
    weight = ahead(lines.weight, m * batch.stride)
    for d in range(at.draws):
        lines.total[d] = sum_of_weights(weight, d * batch.width, batch.width)
        lines.half[d] = -1
    redrawn = False  # whether the noise until the next measurement was drawn again
    for t in range(m, first - 1, -1):
        sensors = measuring(at, s, t)
        if sensors != 0 and t < m:
            _back(at, weight, _event(at, t, request.sensors))
        if t < behind:
            z = quantity_at(at, request.instants + t if redrawn and sensors == 0 else t)
            means = ahead(lines.smoothed, t * lines.rows * batch.row)
            for r in range(lines.rows):
                values = _values(at, z, means, r)
                _fill_mean(at, weight, values, ahead(means, r * batch.row))
            _record_lines(at, t, weight)
        for sensor in range(request.sensors - 1, -1, -1):
            if (sensors >> sensor) & 1:
                redrawn = is_drawn_again(Instant(at, s, t, sensors, sensor))
                _back(at, weight, _event(at, t, sensor))
    _clear(at)


@compiled
def _record_lines(at, t, weights):
    """Record the number of lines of each draw, if moments are wanted."""
    request, batch = at.work.request, at.work.batch
    for d in range(at.draws if at.work.wanted.moments else 0):
        half = at.work.lines.half[d]
        weight, flow, lines = ahead(weights, d * batch.width), _flow(at, half, d), 0
        for i in range(request.particles):
            lines += (weight[i] if half < 0 else flow[i]) > 0.0
        at.work.results.lines[(at.first + d) * request.instants + t] = lines


@compiled
def _clear(at):
    """Leave zeros in `flow`."""
    batch, lines = at.work.batch, at.work.lines
    for d in range(at.draws):
        flow, index = _flow(at, lines.half[d], d), ahead(lines.listed, d * batch.width)
        for i in range(lines.number[d] if lines.half[d] >= 0 else 0):
            flow[np.int64(index[i])] = 0.0


@compiled
def _flow(at, half, d):
    batch = at.work.batch
    return ahead(at.work.lines.flow, half * batch.stride + d * batch.width)


@compiled
def _fill_mean(at, weight, z, mean):
    """Fill a row of draws with the mean of z, weighted with the lines through each particle."""
    batch, lines = at.work.batch, at.work.lines
    for d in range(at.draws):
        origin, half = d * batch.width, lines.half[d]
        if half < 0:
            value = weighted_sum(weight, z, origin, batch.width)
        elif lines.number[d] * _FEW > batch.width:
            value = weighted_sum(_flow(at, half, d), ahead(z, origin), np.int64(0), batch.width)
        else:
            flow, index = _flow(at, half, d), ahead(lines.listed, origin)
            value = 0.0
            for i in range(lines.number[d]):
                value += flow[np.int64(index[i])] * z[origin + index[i]]
        mean[d] = value / lines.total[d]


@compiled
def _back(at, weight, event):
    """Move the weights of each draw that was resampled to ancestors, and list these."""
    batch, lines = at.work.batch, at.work.lines
    for d in range(at.draws):
        if lines.moved[event * batch.row + d] == 0:
            continue
        half, origin = lines.half[d], d * batch.width
        lines.half[d] = 1 if half == 0 else 0
        flow, index = _flow(at, lines.half[d], d), ahead(lines.listed, origin)
        ancestor = ahead(lines.ancestor, event * batch.stride + origin)
        if half < 0:
            _add_up(ahead(weight, origin), ancestor, flow, index, batch.width)
            lines.number[d] = batch.width
            continue
        children, parents = _flow(at, half, d), np.int64(0)
        for i in range(lines.number[d]):
            child = np.int64(index[i])
            parent, part = ancestor[child], children[child]
            before = flow[np.int64(parent)]
            flow[np.int64(parent)] = before + part
            children[child] = 0.0
            index[parents] = parent
            parents += (before == 0.0) & (part > 0.0)
        lines.number[d] = parents


@compiled
def _add_up(weight, ancestor, flow, index, width):
    """Add up the weights of a draw's particles, and list all."""
    for i in range(width):
        index[i] = i
    quarter = width // np.int64(4)
    for i in range(quarter):
        for stream in range(np.int64(4)):  # siblings are neighbours, and wait for each other
            k = i + stream * quarter
            flow[np.int64(ancestor[k])] += np.float64(weight[k])
