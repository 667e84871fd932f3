"""The result that all filters give, and the function that checks the arguments of a filter."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.errors import MeasurementTimesError
from pfdist.filters.cloud import Gaussian, Prior
from pfdist.filters.draws import Draws
from pfdist.filters.settings import FilterSettings, check_filter, check_start
from pfdist.kernels.schemes import ALWAYS
from pfdist.models import StateSpaceModel
from pfdist.times.measurement_times import Times, validated


@dataclass(frozen=True)
class Filtered:
    """The filter's result for D draws."""

    # (D,): mean over t = 0..T of the error of the estimate of z(t). The true model defines the
    # error. NaN marks a degenerate draw, inf a draw whose particles are no longer finite.
    mse: NDArray[np.float64]
    # (D, T+1, q): weighted mean and variance of the particles' z(t), if trajectories were wanted.
    # They are NaN from the measurement at which a draw became degenerate, and after the instant at
    # which it became infinite.
    estimate: NDArray[np.float64] | None = None
    variance: NDArray[np.float64] | None = None
    # (D,): each draw's distribution of the last state, if trajectories were wanted: particles
    # (n, P), resampled if the filter measured then, or a normal distribution. The particles are NaN
    # if the draw is degenerate or infinite.
    last: Sequence[NDArray[np.float64] | Gaussian] | None = None
    # (D, P): weights of the last particles, if trajectories were wanted and the filter carries them
    weight: NDArray[np.float64] | None = None


def checking(filter_checked_draws: Callable[..., Filtered]) -> Callable[..., Filtered]:
    """The function that checks its arguments, and then filters draws by the given function.

    `filter_checked_draws` has the arguments of
    `pfdist.filters.particle_filter.filter_checked_draws`.
    """

    def filter_draws(
        model: StateSpaceModel,
        draws: Draws,
        measurement_times: Times,
        particles: int,
        stream: int,
        resampling: str = "multinomial",
        trajectories: bool = False,
        prior: Prior | None = None,
        threshold: float = ALWAYS,
    ) -> Filtered:
        """Filter D draws with one set of measurement times, under the noise of the 64-bit key.

        `model` is the filter's model, which need not be the draws'. `trajectories` asks for
        estimate and variance. `threshold` is that of `pfdist.kernels.schemes.threshold_of`. The
        Kalman filter ignores the particles, and only it starts from a normal distribution. If the
        draws started from the cloud `prior`, no filter starts with the state of its own draw's
        truth.

        Wrong times, models, priors and settings raise a MeasurementTimesError, ModelError,
        PriorError or ArgumentError.
        """
        check_filter(model, draws.model, particles, resampling, threshold=threshold)
        check_start(model, draws, prior)
        last, sensors = draws.instants[-1], len(model.parts)
        times = validated_from(draws.start, measurement_times, last, sensors)
        settings = FilterSettings(particles, resampling, prior=prior, threshold=threshold)
        return filter_checked_draws(model, draws, times, stream, settings, trajectories)

    return filter_draws


def validated_from(
    start: int, measurement_times: Iterable[int], end: int, sensors: int = 1
) -> Times:
    """A set of measurement times, sorted; with several sensors a set of possible measurements.

    A `MeasurementTimesError` says that a time is not an integer, lies outside start..end, or is
    given twice.
    """
    first, last = start * sensors, (end + 1) * sensors - 1
    times = validated(measurement_times, last)
    if times and times[0] < first:
        raise MeasurementTimesError(
            f"measurement_times must lie in {first}..{last}, got {times[0]}"
        )
    return times


def weighed(errors: NDArray[np.float64], weights: Any) -> NDArray[np.float64]:
    """Weighted errors, (..., T+1); at weight 0 even an infinite error does not count."""
    weighted: NDArray[np.float64] = np.zeros_like(errors)
    np.multiply(errors, weights, out=weighted, where=np.not_equal(weights, 0.0))
    return weighted
