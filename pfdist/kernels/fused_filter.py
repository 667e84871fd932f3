"""A model's formulas and a resampling scheme, fused into one compiled filter.

Named tuples hold the filter's request, the draws at hand, and the arrays it works in. They cost no
time: LLVM sees through them.
"""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pfdist.kernels.arithmetic import row_sum
from pfdist.kernels.cloud import FilterFormulas, Prior, cloud_steps, copy_ancestors, copy_cloud
from pfdist.kernels.components import naming, reader, tuple_of, writer
from pfdist.kernels.disk_cache import cached_on_disk
from pfdist.kernels.estimators import ErrorWeights
from pfdist.kernels.formulas import formula
from pfdist.kernels.guiding import step_of, weighting
from pfdist.kernels.melting import melted
from pfdist.kernels.overloads import ELEMENTARY
from pfdist.kernels.resampling import RESAMPLE
from pfdist.kernels.schemes import ALL_SCHEMES
from pfdist.kernels.scratch import WEIGHTED, WithScratch, filter_scratch, with_sizes
from pfdist.kernels.sorting import sort_by_state
from pfdist.kernels.weights import cumulate, weigh


def measuring(
    fillers: Sequence[Callable[..., None]],
    measurements: Sequence[int],
    resampling: str,
    unguided: Callable[..., None] | None,
) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """Compile the two steps of the measurements at an instant.

    - ``measure(scratch, here, row, total, request, p, at, t, sensors) -> here, row, total, weighs,
      fails``: the half that then holds the cloud, row and sum of the weights, whether the last
      measurement gave these weights, and whether a measurement was left out because no particle
      explains it. If it was the last, the weights are those before, and a guided filter repeats its
      step by `unguided`, as if t were not measured. `sensors` has a bit for each sensor that
      measures. Each weighs in its turn, and the cloud is resampled in between;
    - ``resample_cloud(scratch, here, request, at, t, left) -> here``, where so many sensors may
      still measure at t. Each number has noise of its own.

    `fillers` compute the log-weights of each sensor; see `pfdist.kernels.cloud.cloud_steps`.
    `measurements` are the numbers of components of their y.
    """
    resample, number_of_sensors = RESAMPLE[resampling], len(fillers)
    sort = sort_by_state if ALL_SCHEMES[resampling].sorts else _leave_unsorted
    fill_log_weights = _of_sensor(fillers, measurements)

    @melted
    def weigh_by(scratch, here, request, p, at, t, sensor):
        cloud, weight, log_weight = scratch.cloud, scratch.weight, scratch.log_weight
        fill_log_weights(cloud, here, request, p, at.d, t, log_weight, sensor)
        if not weigh(log_weight, weight, WEIGHTED):
            return here, 0.0
        here = sort(cloud, here, request.particles, weight, WEIGHTED, scratch.sorting)
        cumulative = scratch.resampling.cumulative
        return here, cumulate(weight, WEIGHTED, log_weight.size, cumulative)

    @melted
    def resample_cloud(scratch, here, request, at, t, left):
        key = (request.start + t + 1) * number_of_sensors - 1 - left
        resample(scratch.resampling, request.particles, at.stream, at.draw, key)
        copy_ancestors(scratch.cloud, here, request.particles, scratch.resampling.ancestor)
        return 1 - here

    @melted
    def weigh_cloud(scratch, here, request, p, at, t, sensors):
        total, fails = 0.0, False
        for sensor in range(number_of_sensors):
            if (sensors >> sensor) & 1:
                if total > 0.0:
                    here = resample_cloud(scratch, here, request, at, t, number_of_sensors - sensor)
                here, total = weigh_by(scratch, here, request, p, at, t, sensor)
                fails |= total == 0.0
        return here, total, fails

    @melted
    def weigh_by_the_only_sensor(scratch, here, request, p, at, t, sensors):
        here, total = weigh_by(scratch, here, request, p, at, t, 0)
        return here, total, total == 0.0

    if number_of_sensors == 1:
        weigh_cloud = weigh_by_the_only_sensor
    return _leaving_out(weigh_cloud, unguided or _keep_particles), resample_cloud


def _leaving_out(weigh_cloud: Callable[..., Any], step: Callable[..., None]) -> Callable[..., Any]:
    @melted
    def measure(scratch, here, row, total, request, p, at, t, sensors):
        cloud, noise, before = scratch.cloud, scratch.noise, request.start + t - 1
        here, weighed, fails = weigh_cloud(scratch, here, request, p, at, t, sensors)
        if weighed > 0.0:
            return here, WEIGHTED, weighed, True, fails
        if t > 0:
            step(cloud, 1 - here, noise, request.particles, p, at.stream, at.draw, before)
        return here, row, total, False, fails

    return measure


@melted
def _keep_particles(cloud, here, noise, particles, p, stream, draw, t):
    """Leave all particles as they are: no proposal has made them."""


def _of_sensor(
    fillers: Sequence[Callable[..., None]], measurements: Sequence[int], number: int = 0
) -> Callable[..., None]:
    """Compile the computation of log-weights by the sensor of a number."""
    fill = fillers[number]
    read_y = reader(measurements[number], "d, t, c", sum(measurements[:number]))

    @melted
    def fill_log_weights(cloud, here, request, p, d, t, log_weight, sensor):
        y, instant = read_y(request.y, d, t), request.start + t
        fill(cloud, here, request.particles, p, y, instant, log_weight)

    if number + 1 == len(fillers):
        return fill_log_weights
    others = _of_sensor(fillers, measurements, number + 1)

    @melted
    def fill_by_one(cloud, here, request, p, d, t, log_weight, sensor):
        if sensor == number:
            fill_log_weights(cloud, here, request, p, d, t, log_weight, sensor)
        else:
            others(cloud, here, request, p, d, t, log_weight, sensor)

    return fill_by_one


@melted
def _leave_unsorted(cloud, here, particles, weight, row, scratch):
    """Leave the cloud as it is: takes the place of `sort_by_state` in schemes that do not sort."""
    return here


_SIN, _COS = ELEMENTARY["sin"], ELEMENTARY["cos"]
_SQUARED = "(values[c] - mean[c]) ** 2"
_ANGULAR = "2.0 * sin(0.5 * (values[c] - mean[c])) ** 2"  # 1 - cos


@lru_cache(maxsize=32)
def moments(
    quantity_of_interest: Callable[..., Any], states: int, is_angle: tuple[bool, ...]
) -> tuple[Callable[..., Any], ...]:
    """Compile the weighted mean of z, and its variance; of an angle, mean direction and 1 - R.

    A particle of weight 0 does not count. The terms are computed first, in vectors whose length
    depends on the processor. Then `row_sum` adds them in a fixed order. The cosine of an angle has
    the row of its component, and the sines follow in rows of their own.
    """
    quantities = len(is_angle)
    angles = [c for c, angle in enumerate(is_angle) if angle]
    values = ["cos(values[c])" if angle else "values[c]" for angle in is_angle]
    values += [f"sin(values[{c}])" for c in angles]
    means = ["row_sum(terms, uintp(c)) / total"] * quantities
    for row, c in enumerate(angles, start=quantities):
        means[c] = f"arctan2(row_sum(terms, uintp({row})), row_sum(terms, uintp(c)))"
    quantity = formula(quantity_of_interest, "quantity_of_interest")
    read_x = reader(states, "half, c, i")
    terms_of = tuple(f"weight * ({value} if weight > 0.0 else 0.0)" for value in values)
    weighted = tuple_of(len(values), "weight, values", terms_of, sin=_SIN, cos=_COS)
    weighted_squares = tuple_of(
        quantities, "weight, values", "weight * (values[c] if weight > 0.0 else 0.0)"
    )
    entries = tuple(_ANGULAR if angle else _SQUARED for angle in is_angle)
    squares = tuple_of(quantities, "values, mean", entries, sin=_SIN)
    write_terms, write_squares = writer(len(values), "c, i"), writer(quantities, "c, i")
    mean_of = tuple_of(
        quantities, "terms, total", tuple(means), row_sum=row_sum, arctan2=ELEMENTARY["arctan2"]
    )
    mean_of_squares = tuple_of(
        quantities, "terms, total", "row_sum(terms, uintp(c)) / total", row_sum=row_sum
    )

    @melted
    def fill_terms(cloud, here, t, p, weight, row, terms):
        for i in range(cloud.shape[2]):
            z = quantity(read_x(cloud, here, i), t, p)
            write_terms(terms, i, weighted(weight[row, i], z))

    @melted
    def fill_squares(cloud, here, t, p, weight, row, mean, terms):
        for i in range(cloud.shape[2]):
            z = quantity(read_x(cloud, here, i), t, p)
            write_squares(terms, i, weighted_squares(weight[row, i], squares(z, mean)))

    return fill_terms, fill_squares, mean_of, mean_of_squares


@lru_cache(maxsize=32)
def recorders(is_angle: tuple[bool, ...]) -> tuple[Callable[..., Any], ...]:
    """Compile what records mean and variance, and the part of an instant's error they estimate.

    Each filter contributes its variance, by the estimator's weights. The first of two filters
    stores its mean, and the second adds the distance to it, as `pfdist.filters.interface` does.
    """
    quantities = len(is_angle)
    weighted = f"(1.0 - variances[c]) * {_ANGULAR}"  # by the second filter's R
    entries = tuple(weighted if angle else _SQUARED for angle in is_angle)
    distances = tuple_of(quantities, "values, mean, variances", entries, sin=_SIN)
    write_z = writer(quantities, "d, t, c")
    read_mean, write_mean = (make(quantities, "s, t, c") for make in (reader, writer))

    @melted
    def record(results, d, t, mean, variances):
        if results.estimate.size > 0:
            write_z(results.estimate, d, t, mean)
            write_z(results.variance, d, t, variances)

    @melted
    def error_by_variance(weights, first_means, filter_number, s, t, mean, variances):
        total = 0.0
        if weights.variance != 0.0:  # else an infinite variance would make a NaN
            for variance in variances:
                total += variance
            total *= weights.variance
        if first_means.size > 0:
            if filter_number > 0:
                distance = 0.0
                for each in distances(read_mean(first_means, s, t), mean, variances):
                    distance += each
                total += weights.distance * distance
            write_mean(first_means, s, t, mean)
        return total

    return record, error_by_variance


# --- the filter -----------------------------------------------------------------------------------


class Request(NamedTuple):
    """Which D draws are filtered, and by which F filters; T+1 is the number of instants."""

    streams: NDArray[np.uint64]  # (F,): the key of each filter's noise
    first_draw: int  # index of the first draw in its stream
    start: int  # first instant, 0 without a prior; sets, plans and arrays count from it
    prior: Prior
    # (D, T+1, n): true states, which a filter reads only if its scheme holds the truth
    x: NDArray[np.float64]
    y: NDArray[np.float64]  # (D, T+1, m): measurements
    z: NDArray[np.float64]  # (D, T+1, q): true quantities of interest
    particles: int
    weights: ErrorWeights  # the terms of the estimator
    instant_weights: NDArray[np.float64]  # (T+1,): of each instant's error, mean 1
    threshold: float  # see `pfdist.kernels.schemes.threshold_of`
    parameters: NDArray[np.float64]  # of the filter's model
    true_parameters: NDArray[np.float64]  # of the truth


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
    # (2,): the row of the draw and the number of the set that are filtered now; Python reads them
    # if a formula fails
    at: NDArray[np.int64]


class _At(NamedTuple):
    """The filter of one draw with one set of times."""

    stream: Any  # key of the filter's noise
    filter_number: Any
    draw: Any  # index in its stream, for the noise
    d: Any  # row of the draw in the arrays
    s: Any  # number of the set in the plan


class _Models(NamedTuple):
    """Parameters of the filter's model and of the truth, by their names."""

    p: Any
    truth: Any


@lru_cache(maxsize=32)
def fused_filter(
    formulas: FilterFormulas,
    noise_kinds: tuple[tuple[str, ...], ...],
    components: tuple[int, tuple[int, ...], int],
    parameters: tuple[tuple[str, ...], ...],
    resampling: str,
    is_angle: tuple[bool, ...],
    carries: bool = False,
) -> WithScratch:
    """Compile ``filter_draws(request, plan, results)``, or load it from disk.

    It takes a `Request`, a `pfdist.kernels.prefixes.Plan` and `Results`, which it fills.
    `noise_kinds` are those of the initial state and of the process, and `components` the numbers
    of components of x, of the y of each sensor, and of z. A guided filter adds the kinds of the
    proposal's variates. `parameters` names those of the filter's model, and of the truth.
    `is_angle` says which components of z are angles, and `carries` whether the filter may carry
    weights from one measurement to the next. With several sensors it neither carries nor is guided.
    """
    filter_draw = _filter_draw(formulas, noise_kinds, components, resampling, is_angle, carries)
    named, named_truth = map(naming, parameters)
    noise_rows = max(1, *map(len, noise_kinds))
    states, rows = components[0], components[2] + sum(is_angle)

    @njit(nogil=True, error_model="numpy", _nrt=False, no_cfunc_wrapper=True)
    def filter_draws(request, plan, results, scratch):
        models = _Models(named(request.parameters), named_truth(request.true_parameters))
        sized = with_sizes(scratch, states, rows, noise_rows, request.particles)
        mse = results.mse
        # Sets are innermost and in the plan's order: a set resumes from a cloud that an earlier set
        # saved for the same draw and filter. The next draw or filter overwrites all saved clouds.
        for d in range(mse.shape[0]):
            for k in range(request.streams.size):
                for s in range(mse.shape[1]):
                    results.at[0], results.at[1] = d, s
                    at = _At(request.streams[k], k, request.first_draw + d, d, s)
                    filtered = filter_draw(at, request, models, plan, results, sized)
                    mse_of_filter, is_degenerate = filtered
                    mse[d, s] = mse_of_filter if k == 0 else mse[d, s] + mse_of_filter
                    results.degenerate[d, s] |= is_degenerate

    compiled = cached_on_disk(
        filter_draws,
        formulas.all,
        *(noise_kinds, components, parameters, resampling, is_angle, carries),
    )

    def with_scratch(request, plan, results):
        # All draws, filters and sets of this call share one scratch, and each call makes its own:
        # threads filter at the same time. Python frees it even if a formula raises.
        first_means = (results.mse.shape[1] if len(request.streams) > 1 else 0, request.y.shape[1])
        scratch = filter_scratch(
            (states, rows), noise_rows, request.particles, plan.clouds, first_means
        )
        compiled(request, plan, results, scratch)

    return WithScratch(compiled, with_scratch)


def _filter_draw(
    formulas: FilterFormulas,
    noise_kinds: tuple[tuple[str, ...], ...],
    components: tuple[int, tuple[int, ...], int],
    resampling: str,
    is_angle: tuple[bool, ...],
    carries: bool,
) -> Callable[..., tuple[float, bool]]:
    """Compile the filter of one draw with one set of times: its MSE, and whether it is degenerate.

    It resumes from the cloud that an earlier set saved, and saves the clouds that later sets need.
    """
    begin, propagate, *fillers = cloud_steps(formulas, noise_kinds[:2], components[0], carries)
    measure, resample_cloud = measuring(
        fillers, components[1], resampling, propagate if formulas.proposal else None
    )
    begin_weighted, begin_log_weights, resample = weighting(
        begin, resample_cloud, bool(formulas.proposal), carries
    )
    step = step_of(propagate, begin_log_weights, formulas, noise_kinds, components)
    fill_terms, fill_squares, mean_of, mean_of_squares = moments(
        formulas.quantity_of_interest, components[0], is_angle
    )
    read_z, error_of = reader(components[2], "d, t, c"), formula(formulas.error, "error")
    record, error_by_variance = recorders(is_angle)
    put_truth, rank_truth = _truth_steps(formulas.quantity_of_interest, components, resampling)

    @melted
    def filter_draw(at, request, models, plan, results, scratch):
        d, s, p, truth = at.d, at.s, models.p, models.truth
        cloud, weight, terms = scratch.cloud, scratch.weight, scratch.terms
        weights, saved, first_means = request.weights, scratch.saved, scratch.first_means
        measured, begins, ends, sources, first_stops, stops, slots = plan
        only_by_error = weights[1:] == (0.0, 0.0) and results.estimate.size == 0
        k, behind = first_stops[s], first_stops[s + 1]  # of its next stop, and of all its stops
        goes_on = slots[behind - 1] >= 0 or results.cloud.size > 0  # its last cloud counts
        here, stop, source = np.int64(0), begins[s], sources[s] if begins[s] > 0 else np.int64(-1)
        is_degenerate = source >= 0 and saved.degenerate[source]
        error, row, total = begin_weighted(at, request, p, scratch, source)
        # At each instant: propagate, weight, estimate, resample. The estimate comes before
        # resampling, which adds noise. The loop pauses at each instant whose cloud a later set
        # needs: cloud[here] is then resampled, but not yet propagated to that instant.
        while k < behind and error < np.inf:
            first, stop, k = stop, stops[k], k + 1
            for t in range(first, stop):
                instant, weighs = request.start + t, False
                if t > 0:
                    step(scratch, here, row, request, p, at, t, measured[s, t])
                    here = 1 - here
                put_truth(cloud, here, request.x, d, t)
                if measured[s, t]:
                    here, row, total, weighs, fails = measure(
                        scratch, here, row, total, request, p, at, t, measured[s, t]
                    )
                    is_degenerate |= fails
                rank_truth(scratch, here, request, p, total, results.ranks, d, t, measured[s, t])
                fill_terms(cloud, here, instant, p, weight, row, terms)
                mean = mean_of(terms, total)
                if not only_by_error:
                    fill_squares(cloud, here, instant, p, weight, row, mean, terms)
                    variances = mean_of_squares(terms, total)
                    record(results, d, t, mean, variances)
                    variance = error_by_variance(
                        weights, first_means, at.filter_number, s, t, mean, variances
                    )
                    weighed_variance = _weighed(variance, request.instant_weights[t])
                    error += weighed_variance
                    _add(results.errors, s, t, weighed_variance)
                z = read_z(request.z, d, t)
                squared = _weighed(
                    error_of(z, mean, instant, truth) if weights.squared_error != 0.0 else 0.0,
                    request.instant_weights[t] * weights.squared_error,
                )
                error += squared
                _add(results.errors, s, t, squared)
                if not error < np.inf:
                    return _mean(np.inf, 1, saved, slots[k - 1 : behind], is_degenerate)
                if weighs and (goes_on or t + 1 < ends[s]):
                    here, row, total = resample(scratch, here, request, total, at, t)
            # Inside the loop over t this costs 3 %.
            _save(cloud, here, weight, row, saved, slots[k - 1], error, is_degenerate)
        _keep(cloud, here, weight, row, results, d)
        return _mean(error, measured.shape[1], saved, slots[k:behind], is_degenerate)

    return filter_draw


def _truth_steps(
    quantity_of_interest: Callable[..., Any],
    components: tuple[int, tuple[int, ...], int],
    resampling: str,
) -> tuple[Callable[..., None], Callable[..., None]]:
    """Compile what a scheme with the truth among the particles does; others do nothing.

    - ``put_truth`` gives particle 0 the true state of a draw at t;
    - ``rank_truth`` fills `Results.ranks` of a measured instant, if they are wanted.
    """
    if not ALL_SCHEMES[resampling].holds_truth:
        return _put_nothing, _rank_nothing
    states, _, quantities = components
    quantity = formula(quantity_of_interest, "quantity_of_interest")
    read_truth, write_x = reader(states, "d, t, c"), writer(states, "half, c, i")
    read_x, write_z = reader(states, "half, c, i"), writer(quantities, "c, i")

    @melted
    def put_truth(cloud, here, x, d, t):
        write_x(cloud, here, 0, read_truth(x, d, t))

    @melted
    def rank_truth(scratch, here, request, p, total, ranks, d, t, measured):
        if measured and ranks.size > 0:
            weight, z, instant = scratch.weight, scratch.terms, request.start + t
            for i in range(request.particles):
                write_z(z, i, quantity(read_x(scratch.cloud, here, i), instant, p))
            for c in range(ranks.shape[3]):
                below = equal = 0.0
                for i in range(request.particles):
                    if z[c, i] < z[c, 0]:
                        below += weight[WEIGHTED, i]
                    elif z[c, i] == z[c, 0]:
                        equal += weight[WEIGHTED, i]
                ranks[0, d, t, c], ranks[1, d, t, c] = below / total, equal / total

    return put_truth, rank_truth


@melted
def _put_nothing(cloud, here, x, d, t):
    """Leave all particles as they are: stands for `put_truth` in schemes without the truth."""


@melted
def _rank_nothing(scratch, here, request, p, total, ranks, d, t, measured):
    """Do nothing, in schemes without the truth."""


@melted
def _weighed(error, weight):
    """The weighted error; an instant of weight 0 does not count, even if its error is infinite."""
    return weight * error if weight != 0.0 else 0.0


@melted
def _add(errors, s, t, error):
    """Add an error to the sum over the draws, if sums are wanted."""
    if errors.size > 0:
        errors[s, t] += error


@melted
def _save(cloud, here, weight, row, saved, slot, error, is_degenerate):
    """Save the cloud with its weights, and the sum of errors, if a later set resumes from here."""
    if slot >= 0:
        saved.errors[slot], saved.degenerate[slot] = error, is_degenerate
        copy_cloud(cloud, here, saved.clouds, slot)
        for i in range(weight.shape[1]):
            saved.weights[slot, i] = weight[row, i]


@melted
def _keep(cloud, here, weight, row, results, d):
    """Copy the particles of a draw and their weights into the results, if they are wanted."""
    if results.cloud.size > 0:
        for i in range(results.cloud.shape[2]):
            results.weight[d, i] = weight[row, i]
            for component in range(results.cloud.shape[1]):
                results.cloud[d, component, i] = cloud[here, component, i]


@melted
def _mean(error, instants, saved, slots, is_degenerate):
    """The sum of errors over the number of instants.

    An infinite sum also ends the sets that would resume from this one.
    """
    if not error < np.inf:
        for slot in slots:
            if slot >= 0:
                saved.errors[slot], saved.degenerate[slot] = np.inf, is_degenerate
    return error / instants, is_degenerate
