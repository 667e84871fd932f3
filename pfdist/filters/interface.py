"""The result that all filters give, and the function that checks their arguments."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pfdist.filters.draws import Draws
from pfdist.filters.settings import FilterSettings, check_filter
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
    """

    mse: NDArray[np.float64]
    estimate: NDArray[np.float64] | None = None
    variance: NDArray[np.float64] | None = None


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

        Returns
        -------
        Filtered

        Raises
        ------
        MeasurementTimesError
            The measurement times do not lie in 0..T, or a time is given twice.
        ModelError
            A formula cannot be compiled, or failed.
        ValueError
            A setting has a value that is not allowed.
        """
        check_filter(model, draws.model, particles, resampling, dtype)
        times = validated(measurement_times, draws.z.shape[1] - 1)
        settings = FilterSettings(particles, resampling, dtype)
        return filter_checked_draws(model, draws, times, stream, settings, trajectories)

    return filter_draws
