"""A model's formulas and a resampling scheme, fused into one compiled filter.

Inside, arrays are named and their rows and draws numbered: a part of an array that goes from hand
to hand, or two that change names, cost an atomic count each, 0.07 ns a particle-step in all.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit

from pfdist.kernels.components import naming, reader, tuple_of, writer
from pfdist.kernels.disk_cache import kept_on_disk
from pfdist.kernels.formulas import formula
from pfdist.kernels.noise import FILTER_INITIAL, FILTER_PROCESS, filler, padded
from pfdist.kernels.resampling import RESAMPLE, SPARE
from pfdist.kernels.weights import IMPOSSIBLE, cumulate, weigh, width

# The rows of weights: where nothing is measured, and where something is.
_ALIKE, _WEIGHED = np.uintp(0), np.uintp(1)


@lru_cache(maxsize=32)
def fused_filter(
    functions: tuple[Callable[..., Any], ...],
    noise_kinds: tuple[tuple[str, ...], ...],
    components: tuple[int, int, int],
    parameters: tuple[tuple[str, ...], ...],
    resampling: str,
    dtype: str,
) -> Callable[..., None]:
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
    callable
        ``filter_draws(stream, first, y, z, plan, clouds, particles, parameters, truths, mse,
        estimate, variance)`` fills mse (D, U), the errors up to each set's end over T + 1, as
        `pfdist.kernels.prefixes.plan` has the sets; and estimate and variance (D, T+1, q) of one
        set, unless they are empty.
    """
    filter_draw = _filter_draw(functions, noise_kinds, components, resampling)
    named, named_truth = map(naming, parameters)
    rows, kind = max(1, *map(len, noise_kinds)), np.dtype(dtype).type
    states = components[0]

    @njit(nogil=True, error_model="numpy")
    def filter_draws(
        stream, first, y, z, plan, clouds, particles, parameters, truths, mse, estimate, variance
    ):
        p, truth = named(parameters), named_truth(truths)
        size, spacious = width(particles), padded(particles + SPARE)
        cloud = np.empty((2, states, size), kind)
        noise = np.empty((rows, spacious), np.float32)
        log_weight, weight = np.empty(size), np.zeros((2, size), np.float32)
        weight[_ALIKE, :particles] = 1.0
        cumulative, sums = np.empty(size), np.empty(spacious)
        points, shares = np.empty(spacious, np.uint32), np.empty(spacious, np.uint32)
        ancestor = np.zeros(spacious, np.uint32)
        saved, before = np.empty((clouds, states, size), kind), np.empty(clouds)
        for d in range(mse.shape[0]):
            for s in range(mse.shape[1]):
                mse[d, s] = filter_draw(
                    stream, first + d, d, s, y, z, plan, particles, p, truth,
                    estimate, variance, saved, before, cloud, noise, log_weight, weight,
                    cumulative, sums, points, shares, ancestor,
                )  # fmt: skip

    return kept_on_disk(
        filter_draws, functions, noise_kinds, components, parameters, resampling, dtype
    )


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
    average, record = _moments(functions[3], components)
    read_z, error_of = reader(components[2], "d, t, c"), formula(functions[4])
    resample = RESAMPLE[resampling]

    @njit(forceinline=True, nogil=True, error_model="numpy")
    def filter_draw(
        stream, draw, d, s, y, z, plan, particles, p, truth,
        estimate, variance, saved, before, cloud, noise, log_weight, weight,
        cumulative, sums, points, shares, ancestor,
    ):  # fmt: skip
        measured, begins, ends, sources, stops, slots = plan
        here, stop = np.int64(0), begins[s]
        error = begin(stream, draw, stop, sources[s], noise, particles, p, cloud, saved, before)
        while stop < ends[s] and error < np.inf:
            first, stop = stop, stops[s, stop]
            for t in range(first, stop):
                if t > 0:
                    propagate(stream, draw, t - 1, noise, particles, p, cloud, here)
                    here = 1 - here
                by, total = _ALIKE, float(particles)
                if measured[s, t]:
                    explain(cloud, here, particles, y, d, t, p, log_weight)
                    weigh(log_weight, weight, _WEIGHED)
                    by, total = _WEIGHED, cumulate(weight, _WEIGHED, log_weight.size, cumulative)
                if total == 0.0:
                    return _ended(before, slots, s, t, np.nan)  # degenerate
                mean = average(cloud, here, t, p, weight, by, total)
                record(estimate, variance, d, cloud, here, t, p, weight, by, total, mean)
                error += error_of(read_z(z, d, t), mean, t, truth)
                if not error < np.inf:
                    return _ended(before, slots, s, t, np.inf)
                if measured[s, t]:
                    resample(
                        cumulative,
                        particles,
                        stream,
                        draw,
                        t,
                        noise,
                        sums,
                        points,
                        shares,
                        ancestor,
                    )
                    _take(cloud, here, particles, ancestor)
                    here = 1 - here
            if slots[s, stop] >= 0:  # in the inner loop it would cost 3 %
                before[slots[s, stop]] = error
                _copy(cloud, here, saved, slots[s, stop])
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
    initial, transition, log_likelihood = map(formula, functions)
    fill_w0, fill_w = map(filler, noise_kinds)
    read_w0, read_w = (reader(len(kinds), "c, i") for kinds in noise_kinds)
    states, measurements, _ = components
    read_x, write_x = reader(states, "half, c, i"), writer(states, "half, c, i")
    read_y = reader(measurements, "d, t, c")

    @njit(forceinline=True, nogil=True, error_model="numpy")
    def begin(stream, draw, t, source, noise, particles, p, cloud, saved, before):
        if t > 0:
            _copy(saved, source, cloud, 0)
            return before[source]
        fill_w0(noise, particles, stream, draw, np.int64(0), FILTER_INITIAL)
        for i in range(cloud.shape[2]):
            write_x(cloud, 0, i, initial(read_w0(noise, i), p))
        return 0.0

    @njit(forceinline=True, nogil=True, error_model="numpy")
    def propagate(stream, draw, t, noise, particles, p, cloud, here):
        fill_w(noise, particles, stream, draw, t, FILTER_PROCESS)
        for i in range(cloud.shape[2]):
            x = transition(read_x(cloud, here, i), t, read_w(noise, i), p)
            write_x(cloud, 1 - here, i, x)

    @njit(forceinline=True, nogil=True, error_model="numpy")
    def explain(cloud, here, particles, y, d, t, p, out):
        measured = read_y(y, d, t)
        for i in range(out.size):
            value = log_likelihood(measured, read_x(cloud, here, i), t, p)
            out[i] = value if abs(value) < np.inf else IMPOSSIBLE
        for i in range(particles, out.size):
            out[i] = IMPOSSIBLE

    return begin, propagate, explain


def _moments(
    quantity_of_interest: Callable[..., Any], components: tuple[int, int, int]
) -> tuple[Callable[..., Any], ...]:
    """Compile the weighted mean of z, and what records it; a particle of weight 0 does not count.

    Sums that may be added in any order become vectors.
    """
    states, _, quantities = components
    quantity, read_x = formula(quantity_of_interest), reader(states, "half, c, i")
    write_z = writer(quantities, "d, t, c")
    add = tuple_of(
        quantities,
        "sums, weight, values",
        "sums[c] + weight * (values[c] if weight > 0.0 else 0.0)",
        any_order=True,
    )
    divided = tuple_of(quantities, "sums, total", "sums[c] / total")
    squares = tuple_of(quantities, "values, mean", "(values[c] - mean[c]) ** 2")
    nothing = (0.0,) * quantities

    @njit(forceinline=True, nogil=True, error_model="numpy")
    def average(cloud, here, t, p, weight, row, total):
        sums = nothing
        for i in range(cloud.shape[2]):
            z = quantity(read_x(cloud, here, i), t, p)
            sums = add(sums, weight[row, i], z)
        return divided(sums, total)

    @njit(forceinline=True, nogil=True, error_model="numpy")
    def record(estimate, variance, d, cloud, here, t, p, weight, row, total, mean):
        if estimate.size == 0:  # nobody asks
            return
        sums = nothing
        for i in range(cloud.shape[2]):
            z = quantity(read_x(cloud, here, i), t, p)
            sums = add(sums, weight[row, i], squares(z, mean))
        write_z(estimate, d, t, mean)
        write_z(variance, d, t, divided(sums, total))

    return average, record


@njit(forceinline=True, nogil=True)
def _ended(before, slots, s, t, mse):
    """Say it to the sets that share what follows t."""
    for later in range(t + 1, slots.shape[1]):
        if slots[s, later] >= 0:
            before[slots[s, later]] = mse
    return mse


@njit(forceinline=True, nogil=True)
def _mean(error, instants, before, slots, s, stop):
    """Of the errors, or what became of what the set shares."""
    return error / instants if error < np.inf else _ended(before, slots, s, stop, error)


@njit(forceinline=True, nogil=True)
def _copy(clouds, one, others, other):
    """Copy a cloud from one array of them to another."""
    for component in range(clouds.shape[1]):
        for i in range(clouds.shape[2]):
            others[other, component, i] = clouds[one, component, i]


@njit(forceinline=True, nogil=True)
def _take(cloud, here, particles, ancestor):
    """Copy each particle's ancestor to the other half; what lies behind the last is any one."""
    for i in range(particles, cloud.shape[2]):
        ancestor[i] = 0
    for component in range(cloud.shape[1]):
        for i in range(cloud.shape[2]):
            cloud[1 - here, component, i] = cloud[here, component, ancestor[i]]
