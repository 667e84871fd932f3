"""A filter of one system that stops at a measurement and goes on from there.

It gives the same bits as a filter with the same keys that receives all measurements at once.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pfdist.common.formatted_times import formatted_time
from pfdist.errors import MeasurementsError
from pfdist.filters.cloud import Cloud, Gaussian
from pfdist.filters.draws import Draws
from pfdist.filters.engines import COMPILED, ENGINES
from pfdist.filters.work import Estimation
from pfdist.models import StateSpaceModel, squared_error
from pfdist.models.parameters import CLOCK, check_lengths
from pfdist.times.measurement_times import Times


def formatted_instant(model: StateSpaceModel, t: int) -> str:
    """The time of an instant as text: p.time[t] of a model on a clock, else the number t."""
    on_clock = all(name in model.parameters for name in CLOCK)
    times = model.parameters["time"] if on_clock else ()
    return formatted_time(times[t]) if isinstance(times, tuple) and t < len(times) else str(t)


Array = NDArray[np.float64]


@dataclass(frozen=True)
class OneFilter:
    """A filter's knowledge of one system at an instant.

    The error is the squared error: without a truth, a model's own error might fail.
    """

    model: StateSpaceModel  # the filter's model
    # The prior in them is the distribution of x(t). Without a prior, the filter starts from
    # `initial`.
    settings: Estimation
    stream: int  # key of the filter's noise, 64 bits
    draw: int = 0  # index of the draw in the stream
    engine: str = COMPILED.name  # "compiled", "numpy" or "kalman"
    measured: bool = False  # whether the instant t was measured

    def __post_init__(self) -> None:
        if self.model.error is not squared_error:
            object.__setattr__(self, "model", replace(self.model, error=squared_error))

    @property
    def t(self) -> int:
        """The instant: 0, or the instant of the prior."""
        return 0 if self.settings.prior is None else self.settings.prior.t

    def at(self, t: int, y: Array | None = None) -> tuple["OneFilter", Array, Array]:
        """The filter at t, and weighted mean and variance of z, (K, q), at K instants up to t.

        The K instants are those from this filter's to t. t must not be before this filter's
        instant, and must be after it if both are measured. y, (m,), is the measurement at t, if it
        is measured. All components of a sensor are NaN if it did not measure.

        Raises `MeasurementsError` if no particle explains the measurement, or if a state is not
        finite. Raises `ModelError` if a formula failed.
        """
        check_lengths(self.model.parameters, t + 1)
        measurements, quantities = self.model.components[1:]
        measured_y = np.zeros((1, t + 1 - self.t, measurements))
        if y is not None:
            measured_y[0, -1] = y
        draws = Draws(
            self.model,
            range(self.draw, self.draw + 1),
            np.empty((1, 0, 0)),
            measured_y,
            np.zeros((*measured_y.shape[:2], quantities)),  # no truth is known
            self.t,
        )
        times = () if y is None else made(self.model, t, y)
        filtered = ENGINES[self.engine].filters.filter_checked_draws(
            self.model, draws, times, self.stream, self.settings, trajectories=True
        )
        if filtered.degenerate[0]:
            raise MeasurementsError(
                f"no particle of {self.settings.particles} explains the measurement at t = "
                f"{formatted_instant(self.model, t)}: "
                "more particles help, or the model is wrong about this system"
            )
        if np.isinf(filtered.mse[0]):
            raise MeasurementsError(
                f"the states of the filter's particles must stay finite, got an infinite one up "
                f"to t = {formatted_instant(self.model, t)} (model {self.model.name})"
            )
        (last,) = filtered.last
        weight = None if filtered.weight is None else filtered.weight[0]
        prior = last if isinstance(last, Gaussian) else Cloud(t, last, weight)
        measured = y is not None or (self.measured and t == self.t)
        after = replace(self, settings=replace(self.settings, prior=prior), measured=measured)
        return after, filtered.estimate[0], filtered.variance[0]


def made(model: StateSpaceModel, t: int, y: Array) -> Times:
    """The possible measurements that y(t), (m,), has: those of sensors with a component.

    Without sensors this is t.
    """
    if not model.sensors:
        return (t,)
    parts = enumerate(model.parts)
    return tuple(t * len(model.parts) + k for k, part in parts if not np.isnan(y[part.y]).all())
