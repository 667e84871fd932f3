"""The result that all filters give, and the function that checks their arguments."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.errors import MeasurementTimesError
from pfdist.filters.cloud import Gaussian, Prior
from pfdist.filters.draws import Draws
from pfdist.filters.settings import FilterSettings, check_filter, check_start
from pfdist.models import StateSpaceModel
from pfdist.times.measurement_times import Times, validated


@dataclass(frozen=True)
class Filtered:
    """The filter's result for D draws.

    Parameters
    ----------
    mse : array of float64, (D,)
        Mean over t = 0..T of the error of the estimate of z(t). The true model defines the error;
        by default it is the squared Euclidean norm. NaN marks a degenerate draw. inf marks a draw
        whose particles are no longer finite.
    estimate, variance : array of float64, (D, T+1, q), or None
        Weighted mean and variance of the particles' z(t), if they were asked for. They are NaN
        from the measurement at which a draw became degenerate, and after the instant at which it
        became infinite.
    last : sequence of arrays of float64 or Gaussian, (D,), or None
        The filter's distribution of each draw's last state, if trajectories were asked for: its
        particles (n, P), resampled if it measured then, or its normal distribution. The particles
        are NaN if the draw is degenerate or infinite.
    """

    mse: NDArray[np.float64]
    estimate: NDArray[np.float64] | None = None
    variance: NDArray[np.float64] | None = None
    last: Sequence[NDArray[np.float64] | Gaussian] | None = None


def checking(filter_checked_draws: Callable[..., Filtered]) -> Callable[..., Filtered]:
    """Make the function that checks its arguments and filters draws.

    Parameters
    ----------
    filter_checked_draws : callable
        With the contract of `pfdist.filters.particle_filter.filter_checked_draws`.
    """

    def filter_draws(
        model: StateSpaceModel,
        draws: Draws,
        measurement_times: Times,
        particles: int,
        stream: int,
        resampling: str = "multinomial",
        trajectories: bool = False,
        dtype: str = "float64",
        prior: Prior | None = None,
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
            P; the Kalman filter ignores it.
        stream : int
            Key of the filter's noise, 64 bits.
        resampling : {"multinomial", "stratified", "systematic", "residual", "sorted_systematic"}
        trajectories : bool
            Whether estimate and variance are wanted.
        dtype : {"float64", "float32"}
            The dtype of the particles' states; formulas compute in float64.
        prior : Cloud or Gaussian, optional
            Distribution of the state at the first instant of the draws, instead of `initial`. If
            the draws started from this cloud, no filter starts with the state of its draw's truth.
            A normal distribution is for the Kalman filter alone.

        Returns
        -------
        Filtered

        Raises
        ------
        MeasurementTimesError
            The measurement times are no instants of the draws, or a time is given twice.
        ModelError
            A formula cannot be compiled, or failed.
        PriorError
            The prior does not fit the model or the draws.
        ValueError
            A setting has a value that is not allowed.
        """
        check_filter(model, draws.model, particles, resampling, dtype)
        check_start(model, draws, prior)
        times = validated_from(draws.start, measurement_times, draws.instants[-1])
        settings = FilterSettings(particles, resampling, dtype, prior=prior)
        return filter_checked_draws(model, draws, times, stream, settings, trajectories)

    return filter_draws


def validated_from(start: int, measurement_times: Iterable[int], end: int) -> Times:
    """Give a set of measurement times sorted, after checking that it lies in start..end.

    Raises
    ------
    MeasurementTimesError
        A time is not an integer, lies outside start..end, or is given twice.
    """
    times = validated(measurement_times, end)
    if times and times[0] < start:
        raise MeasurementTimesError(f"measurement_times must lie in {start}..{end}, got {times[0]}")
    return times


def weighed(errors: NDArray[np.float64], weights: Any) -> NDArray[np.float64]:
    """Weigh errors; an instant of weight 0 does not count, even if its error is infinite.

    Parameters
    ----------
    errors : array of float64, (..., T+1)
    weights : array of float64, (T+1,), or float
    """
    weighted: NDArray[np.float64] = np.zeros_like(errors)
    np.multiply(errors, weights, out=weighted, where=np.not_equal(weights, 0.0))
    return weighted
