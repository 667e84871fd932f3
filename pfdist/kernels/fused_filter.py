"""A model's formulas and a resampling scheme, fused into one compiled filter.

Inside, arrays are named and their rows and draws numbered: a part of an array that goes from hand
to hand, or two that change names, cost an atomic count each, 0.07 ns a particle-step in all.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit

from pfdist.kernels.arithmetic import shaped
from pfdist.kernels.components import naming, reader, writer
from pfdist.kernels.disk_cache import kept_on_disk
from pfdist.kernels.estimators import SQUARED_ERROR_INDEX
from pfdist.kernels.formulas import formula
from pfdist.kernels.melting import melted
from pfdist.kernels.moments import moments, recorders
from pfdist.kernels.noise import FILTER_INITIAL, FILTER_PROCESS, filler, padded
from pfdist.kernels.resampling import RESAMPLE, SPARE
from pfdist.kernels.schemes import SCHEMES
from pfdist.kernels.scratch import ALIKE, WEIGHED, WithScratch, aligned, filter_scratch
from pfdist.kernels.sorting import DIGITS, sort_by_state
from pfdist.kernels.weights import IMPOSSIBLE, cumulate, weigh, width

_OF_A_CLOUD = ("initial", "transition", "log_likelihood")


@lru_cache(maxsize=32)
def fused_filter(
    functions: tuple[Callable[..., Any], ...],
    noise_kinds: tuple[tuple[str, ...], ...],
    components: tuple[int, int, int],
    parameters: tuple[tuple[str, ...], ...],
    resampling: str,
    dtype: str,
) -> WithScratch:
    """Compile a filter, or load it from disk.

    Parameters
    ----------
    functions : tuple of callables
        initial, transition, log_likelihood and quantity_of_interest of the filter's model, and
        error of the truth.
    noise_kinds : tuple of tuples of {"normal", "uniform"}
        Of the initial state and of the process.
    components : (int, int, int)
        Numbers of components of x, y and z.
    parameters : tuple of tuples of str
        Names of the parameters of the filter's model, and of the truth.
    resampling : str
    dtype : str

    Returns
    -------
    WithScratch
        ``filter_draws(streams, first, y, z, plan, clouds, particles, estimator, parameters, truths,
        mse, estimate, variance)`` fills mse (D, U), the errors up to each set's end over T + 1, as
        `pfdist.kernels.prefixes.plan` has the sets; and estimate and variance (D, T+1, q) of one
        set, unless they are empty. streams (uint64) holds each filter's key, estimator the place in
        `pfdist.kernels.estimators.ESTIMATORS`.
    """
    filter_draw = _filter_draw(functions, noise_kinds, components, resampling)
    named, named_truth = map(naming, parameters)
    rows, kind = max(1, *map(len, noise_kinds)), np.dtype(dtype).type
    states, _, quantities = components

    @njit(nogil=True, error_model="numpy", _nrt=False)
    def filter_draws(
        streams, first, y, z, plan, particles, estimator, parameters, truths,
        mse, estimate, variance, scratch,
    ):  # fmt: skip
        p, truth = named(parameters), named_truth(truths)
        size, spacious = width(particles), padded(particles + SPARE)
        cloud = shaped(scratch[0], (2, states, size))
        noise = shaped(scratch[1], (rows, spacious))
        terms, weight = shaped(scratch[2], (quantities, size)), shaped(scratch[3], (2, size))
        log_weight = shaped(scratch[2], (size,))  # needed no longer when terms are
        cumulative, sums = shaped(scratch[4], (size,)), shaped(scratch[5], (spacious,))
        points, shares = shaped(scratch[6], (spacious,)), shaped(scratch[7], (spacious,))
        ancestor, counts = shaped(scratch[8], (spacious,)), shaped(scratch[9], (2, DIGITS))
        before, others = scratch[11], scratch[12]
        saved = shaped(scratch[10], (before.size, states, size))
        for d in range(mse.shape[0]):
            for k in range(streams.size):
                for s in range(mse.shape[1]):
                    of_filter = filter_draw(
                        streams[k], k, first + d, d, s, y, z, plan, particles, estimator, p, truth,
                        estimate, variance, others, saved, before, cloud, noise, log_weight, weight,
                        cumulative, sums, points, shares, ancestor, counts, terms,
                    )  # fmt: skip
                    mse[d, s] = of_filter if k == 0 else mse[d, s] + of_filter

    compiled = kept_on_disk(
        filter_draws, functions, noise_kinds, components, parameters, resampling, dtype
    )

    def with_scratch(
        streams, first, y, z, plan, clouds, particles, estimator, parameters, truths,
        mse, estimate, variance,
    ):  # fmt: skip
        second = mse.shape[1] if streams.size > 1 else 0
        scratch = filter_scratch((states, quantities), rows, particles, clouds, kind)
        others = aligned((second, y.shape[1], quantities), np.float64)
        compiled(
            streams, first, y, z, plan, particles, estimator, parameters, truths,
            mse, estimate, variance, (*scratch, others),
        )  # fmt: skip

    return WithScratch(compiled, with_scratch)


def _filter_draw(
    functions: tuple[Callable[..., Any], ...],
    noise_kinds: tuple[tuple[str, ...], ...],
    components: tuple[int, int, int],
    resampling: str,
) -> Callable[..., float]:
    """Compile the filter of one draw with one set of times; it gives the draw's MSE.

    It goes on from where a set before it was the same, and keeps what a later one goes on from.
    """
    begin, propagate, explain = _cloud_steps(functions[:3], noise_kinds, components)
    average, spread = moments(functions[3], components)
    read_z, error_of = reader(components[2], "d, t, c"), formula(functions[4], "error")
    record, cost_of = recorders(functions[4], components[2])
    resample = RESAMPLE[resampling]
    in_line = sort_by_state if SCHEMES[resampling].sorts else _as_it_is

    @melted
    def filter_draw(
        stream, k, draw, d, s, y, z, plan, particles, estimator, p, truth,
        estimate, variance, others, saved, before, cloud, noise, log_weight, weight,
        cumulative, sums, points, shares, ancestor, counts, terms,
    ):  # fmt: skip
        measured, begins, ends, sources, stops, slots = plan
        here, stop = np.int64(0), begins[s]
        by_error = estimator == SQUARED_ERROR_INDEX
        by_error_alone = by_error and estimate.size == 0
        error = begin(stream, draw, stop, sources[s], noise, particles, p, cloud, saved, before)
        while stop < ends[s] and error < np.inf:
            first, stop = stop, stops[s, stop]
            for t in range(first, stop):
                if t > 0:
                    propagate(stream, draw, t - 1, noise, particles, p, cloud, here)
                    here = 1 - here
                weighing, total = ALIKE, float(particles)
                if measured[s, t]:
                    explain(cloud, here, particles, y, d, t, p, log_weight)
                    weigh(log_weight, weight, WEIGHED)
                    here = in_line(
                        cloud, here, particles, weight, WEIGHED, log_weight,
                        counts, points, shares, ancestor,
                    )  # fmt: skip
                    weighing, total = (
                        WEIGHED,
                        cumulate(weight, WEIGHED, log_weight.size, cumulative),
                    )
                if total == 0.0:
                    return _ended(before, slots, s, t, np.nan)  # degenerate
                mean = average(cloud, here, t, p, weight, weighing, total, terms)
                if not by_error_alone:
                    variances = spread(cloud, here, t, p, weight, weighing, total, mean, terms)
                    record(estimate, variance, d, t, mean, variances)
                    error += cost_of(estimator, k, others, s, t, mean, variances, truth)
                error += error_of(read_z(z, d, t), mean, t, truth) if by_error else 0.0
                if not error < np.inf:
                    return _ended(before, slots, s, t, np.inf)
                if measured[s, t]:
                    resample(
                        cumulative, particles, stream, draw, t,
                        noise, sums, points, shares, ancestor,
                    )  # fmt: skip
                    _take(cloud, here, particles, ancestor)
                    here = 1 - here
            _keep(error, cloud, here, before, saved, slots, s, stop)  # further in it costs 3 %
        return _mean(error, measured.shape[1], before, slots, s, stop)

    return filter_draw


def _cloud_steps(
    functions: tuple[Callable[..., Any], ...],
    noise_kinds: tuple[tuple[str, ...], ...],
    components: tuple[int, int, int],
) -> tuple[Callable[..., Any], ...]:
    """Compile what a model does to a cloud: begin, propagate, explain y.

    The cloud is (2, states, particles): what is computed from one half goes to the other.
    """
    initial, transition, log_likelihood = map(formula, functions, _OF_A_CLOUD)
    fill_w0, fill_w = map(filler, noise_kinds)
    read_w0, read_w = (reader(len(kinds), "c, i") for kinds in noise_kinds)
    states, measurements, _ = components
    read_x, write_x = reader(states, "half, c, i"), writer(states, "half, c, i")
    read_y = reader(measurements, "d, t, c")

    @melted
    def begin(stream, draw, t, source, noise, particles, p, cloud, saved, before):
        if t > 0:
            _copy(saved, source, cloud, 0)
            return before[source]
        fill_w0(noise, particles, stream, draw, np.int64(0), FILTER_INITIAL)
        _repeat_first(noise, particles, cloud.shape[2])
        for i in range(cloud.shape[2]):
            write_x(cloud, 0, i, initial(read_w0(noise, i), p))
        return 0.0

    @melted
    def propagate(stream, draw, t, noise, particles, p, cloud, here):
        fill_w(noise, particles, stream, draw, t, FILTER_PROCESS)
        _repeat_first(noise, particles, cloud.shape[2])
        for i in range(cloud.shape[2]):
            x = transition(read_x(cloud, here, i), t, read_w(noise, i), p)
            write_x(cloud, 1 - here, i, x)

    @melted
    def explain(cloud, here, particles, y, d, t, p, out):
        measured = read_y(y, d, t)
        for i in range(out.size):
            value = log_likelihood(measured, read_x(cloud, here, i), t, p)
            out[i] = value if abs(value) < np.inf else IMPOSSIBLE
        for i in range(particles, out.size):
            out[i] = IMPOSSIBLE

    return begin, propagate, explain


@melted
def _as_it_is(
    cloud, here, particles, weight, row, log_weight, counts, keys, half_sorted, order
):  # fmt: skip
    """Sort nothing; see `sort_by_state`."""
    return here


@melted
def _ended(before, slots, s, t, mse):
    """Say it to the sets that share what follows t."""
    for later in range(t + 1, slots.shape[1]):
        if slots[s, later] >= 0:
            before[slots[s, later]] = mse
    return mse


@melted
def _keep(error, cloud, here, before, saved, slots, s, stop):
    """Keep what sets that share what lies before stop go on from."""
    if slots[s, stop] >= 0:
        before[slots[s, stop]] = error
        _copy(cloud, here, saved, slots[s, stop])


@melted
def _mean(error, instants, before, slots, s, stop):
    """Of the errors, or what became of what the set shares."""
    return error / instants if error < np.inf else _ended(before, slots, s, stop, error)


@melted
def _copy(clouds, source, others, target):
    """Copy a cloud from one array of them to another."""
    for component in range(clouds.shape[1]):
        for i in range(clouds.shape[2]):
            others[target, component, i] = clouds[source, component, i]


@melted
def _repeat_first(noise, particles, size):
    """Repeat the first particle behind the last: no formula fails there that fails nowhere else."""
    for row in range(noise.shape[0]):
        for i in range(particles, size):
            noise[row, i] = noise[row, 0]


@melted
def _take(cloud, here, particles, ancestor):
    """Copy each particle's ancestor to the other half; behind the last the first is repeated."""
    for i in range(particles, cloud.shape[2]):
        ancestor[i] = ancestor[0]
    for component in range(cloud.shape[1]):
        for i in range(cloud.shape[2]):
            cloud[1 - here, component, i] = cloud[here, component, ancestor[i]]
