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
from pfdist.kernels.components import formula, formulas_of, reader, writer
from pfdist.kernels.noise import FILTER_INITIAL, FILTER_PROCESS, filler, padded
from pfdist.kernels.resampling import RESAMPLE, WIDE
from pfdist.kernels.weights import cumulate, weigh, weighted_mean, weighted_variance
from pfdist.measurement_times import Times, validated
from pfdist.models import StateSpaceModel

KERNEL_VERSION = 1
"""Counts the changes after which the same keys give other figures; part of a run's identity."""

RESAMPLING = tuple(RESAMPLE)


@dataclass(frozen=True)
class Filtered:
    """What the filter makes of some draws.

    Parameters
    ----------
    mse : array of float64, (D,)
        Mean over t = 0..T of the squared Euclidean error of the estimate of z(t). NaN marks a
        degenerate draw, inf one whose particles left the finite numbers.
    estimate, variance : array of float64, (D, T+1, q), or None
        Weighted mean and variance of the particles' z(t), if they were asked for. NaN from the
        measurement on at which a draw became degenerate.
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
) -> Filtered:
    """Filter draws with one set of measurement times.

    Parameters
    ----------
    model : StateSpaceModel
        The filter's model.
    draws : Draws
        The truth and its measurements, D draws.
    measurement_times : tuple of int
        The set M, in 0..T.
    particles : int
        P.
    stream : int
        Key of the filter's noise, 64 bits.
    resampling : {"multinomial", "systematic"}
    trajectories : bool
        Whether estimate and variance are wanted.

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
    count, instants, quantities = draws.z.shape
    measured = np.zeros(instants, np.bool_)
    measured[list(validated(measurement_times, instants - 1))] = True
    mse = np.empty(count)
    kept = (count, instants, quantities) if trajectories else (0, instants, quantities)
    estimate, variance = np.full(kept, np.nan), np.full(kept, np.nan)
    with formulas_of(model.name):
        _compiled(model, resampling)(
            np.uint64(stream), draws.index.start, draws.y, draws.z, measured, particles, model.p,
            mse, estimate, variance,
        )  # fmt: skip
    return Filtered(mse, estimate, variance) if trajectories else Filtered(mse)


def _compiled(model: StateSpaceModel, resampling: str) -> Callable[..., None]:
    return _compile(
        (model.initial, model.transition, model.log_likelihood, model.quantity_of_interest),
        (model.initial_noise, model.process_noise),
        model.components,
        resampling,
    )


@lru_cache(maxsize=32)
def _compile(  # noqa: C901  one loop, told in its order
    functions: tuple[Callable[..., Any], ...],
    noise_kinds: tuple[tuple[str, ...], ...],
    components: tuple[int, int, int],
    resampling: str,
) -> Callable[..., None]:
    """Fuse the formulas of a model and a resampling scheme into one compiled filter."""
    start, propagate, explain, interest = _cloud_steps(functions, noise_kinds, components)
    fill_w0, fill_w = map(filler, noise_kinds)
    noise_rows = max(1, *map(len, noise_kinds))
    states, _, quantities = components
    resample = RESAMPLE[resampling]

    @njit(nogil=True, error_model="numpy")
    def filter_kernel(stream, first, y, z, measured, particles, p, mse, estimate, variance):  # type: ignore[no-untyped-def]
        x, other = np.empty((states, particles)), np.empty((states, particles))
        values = np.empty((quantities, particles))
        noise = np.empty((noise_rows, padded(particles)), np.float32)
        log_weight, weight = np.empty(particles), np.empty(particles)
        cumulative, points = np.empty(particles), np.empty(padded(particles))
        ends = np.empty(particles, np.int64)
        guide, ancestor = np.empty(particles + WIDE, np.int64), np.empty(particles + WIDE, np.int64)
        for d in range(mse.size):
            draw, error = first + d, 0.0
            fill_w0(noise, stream, draw, 0, FILTER_INITIAL)
            start(noise, p, x)
            for t in range(measured.size):
                if t > 0:
                    fill_w(noise, stream, draw, t - 1, FILTER_PROCESS)
                    propagate(x, t - 1, noise, p, other)
                    x, other = other, x
                weight[:] = 1.0
                total = float(particles)
                if measured[t]:
                    explain(x, y[d, t : t + 1].T, t, p, log_weight)
                    weigh(log_weight, weight)
                    total = cumulate(weight, cumulative)
                if total == 0.0:  # degenerate
                    error = np.nan
                    break
                interest(x, t, p, values)
                for k in range(quantities):
                    mean = weighted_mean(values[k], weight, total)
                    error += (z[d, t, k] - mean) ** 2
                    if estimate.size:
                        estimate[d, t, k] = mean
                        variance[d, t, k] = weighted_variance(values[k], weight, total, mean)
                if not error < np.inf:
                    error = np.inf
                    break
                if measured[t]:
                    resample(cumulative, stream, draw, t, points, ends, guide, ancestor)
                    _take(x, ancestor, other)
                    x, other = other, x
            mse[d] = error / measured.size

    return filter_kernel  # type: ignore[no-any-return]


def _cloud_steps(
    functions: tuple[Callable[..., Any], ...],
    noise_kinds: tuple[tuple[str, ...], ...],
    components: tuple[int, int, int],
) -> tuple[Callable[..., None], ...]:
    """Compile what a model does to a cloud: start, propagate, explain y, and give z."""
    initial, transition, log_likelihood, quantity = map(formula, functions)
    read_w0, read_w = (reader(len(kinds)) for kinds in noise_kinds)
    states, measurements, quantities = components
    read_x, read_y = reader(states), reader(measurements)
    write_x, write_z = writer(states), writer(quantities)

    @njit(nogil=True, error_model="numpy")
    def start(noise, p, out):  # type: ignore[no-untyped-def]
        for i in range(out.shape[1]):
            write_x(out, i, initial(read_w0(noise, i), p))

    @njit(nogil=True, error_model="numpy")
    def propagate(x, t, noise, p, out):  # type: ignore[no-untyped-def]
        for i in range(x.shape[1]):
            write_x(out, i, transition(read_x(x, i), t, read_w(noise, i), p))

    @njit(nogil=True, error_model="numpy")
    def explain(x, y, t, p, out):  # type: ignore[no-untyped-def]
        measured = read_y(y, 0)
        for i in range(x.shape[1]):
            out[i] = log_likelihood(measured, read_x(x, i), t, p)

    @njit(nogil=True, error_model="numpy")
    def interest(x, t, p, out):  # type: ignore[no-untyped-def]
        for i in range(x.shape[1]):
            write_z(out, i, quantity(read_x(x, i), t, p))

    return start, propagate, explain, interest


@njit(nogil=True)
def _take(x, ancestor, out):  # type: ignore[no-untyped-def]
    for component in range(x.shape[0]):
        for i in range(x.shape[1]):
            out[component, i] = x[component, ancestor[i]]
