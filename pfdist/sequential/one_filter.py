"""A filter of one system that stops at a measurement and goes on from there.

It gives the bits of the filter that is given all measurements at once and has the same keys.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pfdist.errors import MeasurementsError
from pfdist.evaluation.engines import COMPILED, ENGINES
from pfdist.filters.cloud import Cloud, Gaussian
from pfdist.filters.draws import Draws
from pfdist.filters.settings import FilterSettings
from pfdist.models import StateSpaceModel, squared_error
from pfdist.models.parameters import check_lengths
from pfdist.sequential.told_instant import told_instant

Array = NDArray[np.float64]


@dataclass(frozen=True)
class OneFilter:
    """A filter's knowledge of one system at an instant. Use `begin` to make the first.

    Parameters
    ----------
    model : StateSpaceModel
        The filter's model, with the squared error.
    settings : FilterSettings
        With the prior: what is known of x(t). Without a prior, the filter starts from `initial`.
    stream : int
        Key of the filter's noise, 64 bits.
    draw : int
        Index of the draw in the stream.
    engine : {"compiled", "numpy", "kalman"}
    measured : bool
        Whether the instant t was measured.
    """

    model: StateSpaceModel
    settings: FilterSettings
    stream: int
    draw: int = 0
    engine: str = COMPILED.name
    measured: bool = False

    @property
    def t(self) -> int:
        """The instant: 0, or the instant of the prior."""
        return 0 if self.settings.prior is None else self.settings.prior.t

    def at(self, t: int, y: Array | None = None) -> tuple["OneFilter", Array, Array]:
        """Move the filter to an instant, which is measured if y is given.

        Parameters
        ----------
        t : int
            The instant, not before that of this filter; after it if both are measured.
        y : array of float64, (m,), optional
            The measurement at t.

        Returns
        -------
        OneFilter
            The filter at t.
        estimate, variance : arrays of float64, (K, q)
            Weighted mean and variance of z at the K instants from this filter's to t.

        Raises
        ------
        MeasurementsError
            No particle explains the measurement, or a state is not finite.
        ModelError
            A formula failed.
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
        times = () if y is None else (t,)
        filtered = ENGINES[self.engine].filter_checked_draws(
            self.model, draws, times, self.stream, self.settings, trajectories=True
        )
        if np.isnan(filtered.mse[0]):
            raise MeasurementsError(
                f"no particle of {self.settings.particles} explains the measurement at t = "
                f"{told_instant(self.model, t)}: "
                "more particles help, or the model is wrong about this system"
            )
        if np.isinf(filtered.mse[0]):
            raise MeasurementsError(
                f"the states of the filter's particles must stay finite, got an infinite one up "
                f"to t = {told_instant(self.model, t)} (model {self.model.name})"
            )
        (last,) = filtered.last
        prior = last if isinstance(last, Gaussian) else Cloud(t, last)
        measured = y is not None or (self.measured and t == self.t)
        after = replace(self, settings=replace(self.settings, prior=prior), measured=measured)
        return after, filtered.estimate[0], filtered.variance[0]


def begin(
    model: StateSpaceModel,
    settings: FilterSettings,
    stream: int,
    draw: int = 0,
    engine: str = COMPILED.name,
) -> OneFilter:
    """Give the filter before anything is measured; see `OneFilter`."""
    if model.error is not squared_error:  # without a truth, a model's own error might fail
        model = replace(model, error=squared_error)
    return OneFilter(model, settings, stream, draw, engine)
