"""The intermittent particle filter, fused and compiled (paper, section 2.1).

Sampling importance resampling: particles are propagated by the model, and weighted and resampled
only at the measurement times. `pfdist.plain` holds the same filter in plain NumPy, for reading.

References
----------
Arulampalam, Maskell, Gordon, Clapp, "A tutorial on particle filters", 2002, algorithm 4.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from pfdist.draws import Draws
from pfdist.errors import ModelError
from pfdist.kernels.components import naming, reader, tuple_of, writer
from pfdist.kernels.disk_cache import kept_on_disk
from pfdist.kernels.formulas import formula, formulas_of
from pfdist.kernels.noise import FILTER_INITIAL, FILTER_PROCESS, filler, padded
from pfdist.kernels.resampling import RESAMPLE, SPARE
from pfdist.kernels.weights import IMPOSSIBLE, cumulate, weigh, width
from pfdist.measurement_times import Times, validated
from pfdist.models import StateSpaceModel

KERNEL_VERSION = 2
"""Counts the changes after which the same keys give other figures; part of a run's identity."""

RESAMPLING = tuple(RESAMPLE)
DTYPES = ("float64", "float32")

ALIKE, WEIGHED = (
    np.uintp(0),
    np.uintp(1),
)  # the rows of weights: where nothing is measured, and where something is


@dataclass(frozen=True)
class Filtered:
    """What the filter makes of some draws.

    Parameters
    ----------
    mse : array of float64, (D,)
        Mean over t = 0..T of the error of the estimate of z(t), its squared Euclidean norm or what
        the true model says. NaN marks a degenerate draw, inf one whose particles left the finite
        numbers.
    estimate, variance : array of float64, (D, T+1, q), or None
        Weighted mean and variance of the particles' z(t), if they were asked for. NaN from the
        measurement on at which a draw became degenerate, and after the instant at which one
        became infinite.
    """

    mse: NDArray[np.float64]
    estimate: NDArray[np.float64] | None = None
    variance: NDArray[np.float64] | None = None


def filter_draws(
    model: StateSpaceModel,
    draws: Draws,
    measurement_times: Times,
    particles: int,
    stream: int,
    resampling: str = "multinomial",
    trajectories: bool = False,
    dtype: str = "float64",
) -> Filtered:
    """Filter draws with one set of measurement times.

    Parameters
    ----------
    model : StateSpaceModel
        The filter's model, which need not be the draws'.
    draws : Draws
        The truth and its measurements, D draws.
    measurement_times : tuple of int
        The set M, in 0..T.
    particles : int
        P.
    stream : int
        Key of the filter's noise, 64 bits.
    resampling : {"multinomial", "stratified", "systematic", "residual"}
    trajectories : bool
        Whether estimate and variance are wanted.
    dtype : {"float64", "float32"}
        What the particles' states are kept in; formulas compute in float64.

    Returns
    -------
    Filtered

    Raises
    ------
    MeasurementTimesError
        The measurement times do not lie in 0..T, or one stands twice.
    ModelError
        A formula cannot be compiled, or failed.
    """
    check_filter(model, draws.model, particles, resampling, dtype)
    count, instants, quantities = draws.z.shape
    measured = np.zeros(instants, np.bool_)
    measured[list(validated(measurement_times, instants - 1))] = True
    mse = np.empty(count)
    kept = (count, instants, quantities) if trajectories else (0, instants, quantities)
    estimate, variance = np.full(kept, np.nan), np.full(kept, np.nan)
    truth = draws.model
    with formulas_of(model.name):
        _compiled(model, truth, resampling, dtype)(
            np.uint64(stream), draws.index.start, draws.y, draws.z, measured, particles,
            np.array(model.p), np.array(truth.p), mse, estimate, variance,
        )  # fmt: skip
    return Filtered(mse, estimate, variance) if trajectories else Filtered(mse)


def check_filter(
    model: StateSpaceModel, truth: StateSpaceModel, particles: int, resampling: str, dtype: str
) -> None:
    """Raise an error if there is no such filter, or it does not fit the truth's draws.

    Raises
    ------
    ModelError
        The filter's model measures, or is asked for, something of another size.
    ValueError
        A setting is not one of those allowed.
    """
    for component, true, believed in zip("xyz", truth.components, model.components, strict=True):
        if true != believed and component != "x":
            raise ModelError(
                f"model.filter must have as many components of {component} as the model "
                f"{truth.name}, {true}, got {believed}"
            )
    for name, got, allowed in (("resampling", resampling, RESAMPLING), ("dtype", dtype, DTYPES)):
        if got not in allowed:
            raise ValueError(f"{name} must be one of {', '.join(allowed)}, got {got!r}")
    if particles < 1:
        raise ValueError(f"particles must be at least 1, got {particles}")


def _compiled(
    model: StateSpaceModel, truth: StateSpaceModel, resampling: str, dtype: str
) -> Callable[..., None]:
    formulas = (model.initial, model.transition, model.log_likelihood, model.quantity_of_interest)
    return _compile(
        (*formulas, truth.error),
        (model.initial_noise, model.process_noise),
        model.components,
        (tuple(model.parameters), tuple(truth.parameters)),
        resampling,
        dtype,
    )


@lru_cache(maxsize=32)
def _compile(
    functions: tuple[Callable[..., Any], ...],
    noise_kinds: tuple[tuple[str, ...], ...],
    components: tuple[int, int, int],
    parameters: tuple[tuple[str, ...], ...],
    resampling: str,
    dtype: str,
) -> Callable[..., None]:
    """Fuse the formulas of a model and a resampling scheme into one compiled filter.

    Inside, arrays are named and their rows and draws numbered: a part of an array that goes from
    hand to hand, or two that change names, cost an atomic count each, 0.3 ns a particle in all.
    """
    start, propagate, explain = _cloud_steps(functions[:3], noise_kinds, components)
    average, spread = _moments(functions[3], components)
    fill_w0, fill_w = map(filler, noise_kinds)
    noise_rows = max(1, *map(len, noise_kinds))
    states, _, quantities = components
    read_z, write_z = reader(quantities, "d, t, c"), writer(quantities, "d, t, c")
    error_of = formula(functions[4])
    named, named_truth = map(naming, parameters)
    resample = RESAMPLE[resampling]
    kind = np.dtype(dtype).type

    @njit(nogil=True, error_model="numpy")
    def filter_draws(  # type: ignore[no-untyped-def]
        stream, first, y, z, measured, particles, parameters, truths, mse, estimate, variance
    ):
        p, truth = named(parameters), named_truth(truths)
        size = width(particles)
        cloud = np.empty((2, states, size), kind)
        noise = np.empty((noise_rows, padded(particles + SPARE)), np.float32)
        log_weight, weight = np.empty(size), np.zeros((2, size), np.float32)
        weight[ALIKE, :particles] = 1.0
        cumulative, sums = np.empty(size), np.empty(noise.shape[1])
        points, shares = np.empty(noise.shape[1], np.uint32), np.empty(noise.shape[1], np.uint32)
        ancestor = np.zeros(noise.shape[1], np.uint32)
        for d in range(mse.size):
            draw, total_error, here = first + d, 0.0, np.int64(0)
            fill_w0(noise, particles, stream, draw, np.int64(0), FILTER_INITIAL)
            start(noise, p, cloud)
            for t in range(measured.size):
                if t > 0:
                    fill_w(noise, particles, stream, draw, t - 1, FILTER_PROCESS)
                    propagate(cloud, here, t - 1, noise, p)
                    here = 1 - here
                by, total = ALIKE, float(particles)
                if measured[t]:
                    explain(cloud, here, particles, y, d, t, p, log_weight)
                    weigh(log_weight, weight, WEIGHED)
                    by, total = WEIGHED, cumulate(weight, WEIGHED, size, cumulative)
                if total == 0.0:  # degenerate
                    total_error = np.nan
                    break
                mean = average(cloud, here, t, p, weight, by, total)
                if estimate.size:
                    write_z(estimate, d, t, mean)
                    write_z(variance, d, t, spread(cloud, here, t, p, weight, by, total, mean))
                total_error += error_of(read_z(z, d, t), mean, t, truth)
                if not total_error < np.inf:
                    total_error = np.inf
                    break
                if measured[t]:
                    resample(
                        cumulative, particles, stream, draw, t, noise,
                        sums, points, shares, ancestor,
                    )  # fmt: skip
                    _take(cloud, here, particles, ancestor)
                    here = 1 - here
            mse[d] = total_error / measured.size

    return kept_on_disk(
        filter_draws, functions, noise_kinds, components, parameters, resampling, dtype
    )


def _cloud_steps(
    functions: tuple[Callable[..., Any], ...],
    noise_kinds: tuple[tuple[str, ...], ...],
    components: tuple[int, int, int],
) -> tuple[Callable[..., None], ...]:
    """Compile what a model does to a cloud: start, propagate, explain y.

    The cloud is (2, states, particles): what is computed from one half goes to the other.
    """
    initial, transition, log_likelihood = map(formula, functions)
    read_w0, read_w = (reader(len(kinds), "c, i") for kinds in noise_kinds)
    states, measurements, _ = components
    read_x, write_x = reader(states, "half, c, i"), writer(states, "half, c, i")
    read_y = reader(measurements, "d, t, c")

    @njit(forceinline=True, nogil=True, error_model="numpy")
    def start(noise, p, cloud):  # type: ignore[no-untyped-def]
        for i in range(cloud.shape[2]):
            write_x(cloud, 0, i, initial(read_w0(noise, i), p))

    @njit(forceinline=True, nogil=True, error_model="numpy")
    def propagate(cloud, here, t, noise, p):  # type: ignore[no-untyped-def]
        for i in range(cloud.shape[2]):
            x = transition(read_x(cloud, here, i), t, read_w(noise, i), p)
            write_x(cloud, 1 - here, i, x)

    @njit(forceinline=True, nogil=True, error_model="numpy")
    def explain(cloud, here, particles, y, d, t, p, out):  # type: ignore[no-untyped-def]
        measured = read_y(y, d, t)
        for i in range(out.size):
            value = log_likelihood(measured, read_x(cloud, here, i), t, p)
            out[i] = value if abs(value) < np.inf else IMPOSSIBLE
        for i in range(particles, out.size):
            out[i] = IMPOSSIBLE

    return start, propagate, explain


def _moments(
    quantity_of_interest: Callable[..., Any], components: tuple[int, int, int]
) -> tuple[Callable[..., Any], ...]:
    """Compile the weighted mean and variance of z; a particle of weight 0 does not count.

    Sums that may be added in any order become vectors.
    """
    states, _, quantities = components
    quantity, read_x = formula(quantity_of_interest), reader(states, "half, c, i")
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
    def average(cloud, here, t, p, weight, row, total):  # type: ignore[no-untyped-def]
        sums = nothing
        for i in range(cloud.shape[2]):
            z = quantity(read_x(cloud, here, i), t, p)
            sums = add(sums, weight[row, i], z)
        return divided(sums, total)

    @njit(forceinline=True, nogil=True, error_model="numpy")
    def spread(cloud, here, t, p, weight, row, total, mean):  # type: ignore[no-untyped-def]
        sums = nothing
        for i in range(cloud.shape[2]):
            z = quantity(read_x(cloud, here, i), t, p)
            sums = add(sums, weight[row, i], squares(z, mean))
        return divided(sums, total)

    return average, spread


@njit(forceinline=True, nogil=True)
def _take(cloud, here, particles, ancestor):  # type: ignore[no-untyped-def]
    """Copy each particle's ancestor to the other half; what lies behind the last is any one."""
    for i in range(particles, cloud.shape[2]):
        ancestor[i] = 0
    for component in range(cloud.shape[1]):
        for i in range(cloud.shape[2]):
            cloud[1 - here, component, i] = cloud[here, component, ancestor[i]]
