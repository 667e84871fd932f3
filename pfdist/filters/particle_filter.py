"""The intermittent particle filter (paper, section 2.1).

Sampling importance resampling: particles are propagated by the model, and weighted and resampled
only at the measurement times. `pfdist.kernels.fused_filter` compiles it. `pfdist.filters.plain`
holds the same filter in plain NumPy, for reading.

References
----------
Arulampalam, Maskell, Gordon, Clapp, "A tutorial on particle filters", 2002, algorithm 4.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pfdist.common.streams import stream_key
from pfdist.errors import ModelError
from pfdist.filters.draws import Draws
from pfdist.kernels.estimators import ESTIMATORS, SQUARED_ERROR
from pfdist.kernels.formulas import formulas_of
from pfdist.kernels.fused_filter import Request, Results, fused_filter
from pfdist.kernels.libm import libm_functions, makes_arrays
from pfdist.kernels.prefixes import plan
from pfdist.kernels.schemes import SCHEMES
from pfdist.kernels.scratch import WithScratch
from pfdist.models import StateSpaceModel, squared_error
from pfdist.times.measurement_times import Times, validated

KERNEL_VERSION = 4
"""Counts the changes after which the same keys give other figures; part of a run's identity."""

RESAMPLING = tuple(SCHEMES)
DTYPES = ("float64", "float32")


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
    resampling : {"multinomial", "stratified", "systematic", "residual", "sorted_systematic"}
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
    kept = np.full((2, *draws.z.shape) if trajectories else (2, 0, 0, 0), np.nan)
    sets, by = [measurement_times], SQUARED_ERROR.name
    mse = _filter(model, draws, sets, particles, stream, resampling, dtype, by, kept)[:, 0]
    kept[np.isnan(kept)] = np.nan  # which NaN an operation gives depends on the processor
    return Filtered(mse, *kept) if trajectories else Filtered(mse)


def filter_sets(
    model: StateSpaceModel,
    draws: Draws,
    sets: Sequence[Times],
    particles: int,
    stream: int,
    resampling: str = "multinomial",
    dtype: str = "float64",
    ends: Sequence[int] | None = None,
    estimator: str = SQUARED_ERROR.name,
) -> NDArray[np.float64]:
    """Filter draws with several sets of measurement times, all under the same noise.

    What two sets share from t = 0 on is done once: so it takes less time than one by one, and
    gives the same bits. Other parameters and errors as of `filter_draws`.

    Parameters
    ----------
    sets : sequence of tuples of int, (S,)
    ends : sequence of int, (S,), optional
        The last instant that is wanted of each set: its errors up to there are added up. T for
        all, unless it is given.
    estimator : {"squared_error", "filter_variance", "two_filters"}
        What stands for the error of an instant; see `pfdist.filters.one_by_one`.

    Returns
    -------
    array of float64, (D, S)
        Sum of the errors up to each set's end, over T + 1: what `filter_draws` gives as mse where
        the end is T.
    """
    no = np.empty((2, 0, 0, 0))
    return _filter(model, draws, sets, particles, stream, resampling, dtype, estimator, no, ends)


def filter_streams(stream: int, estimator: str) -> list[int]:
    """Keys of the noise of each filter that an estimator takes; the first is the given one."""
    return [stream, stream_key(stream, "second filter")][: ESTIMATORS[estimator].filters]


def _filter(
    model: StateSpaceModel,
    draws: Draws,
    sets: Sequence[Times],
    particles: int,
    stream: int,
    resampling: str,
    dtype: str,
    estimator: str,
    moments: NDArray[np.float64],
    ends: Sequence[int] | None = None,
) -> NDArray[np.float64]:
    """Fill estimate and variance, unless they are empty, and give the mse, (D, S)."""
    check_filter(model, draws.model, particles, resampling, dtype, estimator)
    count, instants, _ = draws.z.shape
    last = [instants - 1] * len(sets) if ends is None else ends
    checked = [validated(times, end) for times, end in zip(sets, last, strict=True)]
    planned, place = plan(tuple(checked), instants, tuple(end + 1 for end in last))
    mse, truth = np.empty((count, len(planned.measured))), draws.model
    streams = np.array(filter_streams(stream, estimator), np.uint64)
    with formulas_of(model.name, model.formulas | {"error": truth.error}):
        request = Request(
            streams, draws.index.start, draws.y, draws.z, particles,
            list(ESTIMATORS).index(estimator), np.array(model.p), np.array(truth.p),
        )  # fmt: skip
        _compiled(model, truth, resampling, dtype)(request, planned, Results(mse, *moments))
    return mse[:, place]


def check_fits(model: StateSpaceModel, truth: StateSpaceModel) -> None:
    """Raise an error if a filter's model does not fit the truth's draws.

    Raises
    ------
    ModelError
        It measures, or is asked for, something of another size.
    """
    for component, true, believed in zip("xyz", truth.components, model.components, strict=True):
        if true != believed and component != "x":
            raise ModelError(
                f"model.filter must have as many components of {component} as the model "
                f"{truth.name}, {true}, got {believed}"
            )


def check_filter(
    model: StateSpaceModel,
    truth: StateSpaceModel,
    particles: int,
    resampling: str,
    dtype: str,
    estimator: str = SQUARED_ERROR.name,
) -> None:
    """Raise an error if there is no such filter, or it does not fit the truth's draws.

    Raises
    ------
    ModelError
        As of `check_fits`, or a setting does not fit the model.
    ValueError
        A setting is not one of those allowed.
    """
    check_fits(model, truth)
    for name, got, allowed in (
        ("resampling", resampling, RESAMPLING),
        ("dtype", dtype, DTYPES),
        ("estimator", estimator, ESTIMATORS),
    ):
        if got not in allowed:
            raise ValueError(f"{name} must be one of {', '.join(allowed)}, got {got!r}")
    if SCHEMES[resampling].sorts and model.components[0] != 1:
        raise ModelError(
            f"resampling = {resampling!r} needs a model with a scalar state, got {model.name} with "
            f"{model.components[0]} components of x"
        )
    if not ESTIMATORS[estimator].for_any_filter:
        _check_estimator(model, truth, estimator)
    if particles < 1:
        raise ValueError(f"particles must be at least 1, got {particles}")


def _check_estimator(model: StateSpaceModel, truth: StateSpaceModel, estimator: str) -> None:
    """Raise an error unless the particles' variance is what their mean errs by on average."""
    allowed = SQUARED_ERROR.name
    if model != truth:
        raise ModelError(
            f"evaluation.estimator = {estimator!r} needs a filter that knows the truth, got one "
            f"with another model or other parameters (model.filter); allowed: {allowed!r}"
        )
    if truth.error is not squared_error:
        raise ModelError(
            f"evaluation.estimator = {estimator!r} needs an error that is the squared Euclidean "
            f"norm, got model {truth.name}, which has one of its own; allowed: {allowed!r}"
        )


def libm_of_filter(
    model: StateSpaceModel, truth: StateSpaceModel, resampling: str, dtype: str
) -> tuple[str, ...]:
    """Functions of the C library that the compiled filter calls; see `libm_functions`.

    The filter was called before.
    """
    return libm_functions(_compiled(model, truth, resampling, dtype).compiled)


def filter_makes_arrays(
    model: StateSpaceModel, truth: StateSpaceModel, resampling: str, dtype: str
) -> bool:
    """Whether the compiled filter, which was called before, makes arrays for each particle."""
    return makes_arrays(_compiled(model, truth, resampling, dtype).compiled)


def _compiled(
    model: StateSpaceModel, truth: StateSpaceModel, resampling: str, dtype: str
) -> WithScratch:
    formulas = (model.initial, model.transition, model.log_likelihood, model.quantity_of_interest)
    return fused_filter(
        (*formulas, truth.error),
        (model.initial_noise, model.process_noise),
        model.components,
        (tuple(model.parameters), tuple(truth.parameters)),
        resampling,
        dtype,
    )
