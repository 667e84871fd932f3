"""The penalty of measurements in plain NumPy: the filter runs again up to each instant."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pfdist import StateSpaceModel
from pfdist.common.measurement_times import Times
from pfdist.filters import plain
from pfdist.filters.draws import Draws
from pfdist.filters.work import Estimation
from pfdist.kernels.ancestors import weights_of
from pfdist.kernels.replicates import REPLICATES
from pfdist.kernels.variates import TRUTH_MEASUREMENT, variates

_SEEN = 16  # the noise of so many particles is drawn together


def penalties(
    model: StateSpaceModel, draws: Draws, times: Times, stream: int, settings: Estimation
) -> NDArray[np.float64]:
    """Variance of z after each measurement, less the mean after its replicates, (D, T+1).

    No instant has two measurements. It is 0 at instants without a measurement.
    """
    number, fixed = REPLICATES, replace(settings, penalty=None)
    kinds, index = (*model.noise_of_measurements, "uniform"), np.array(draws.index)
    found = np.zeros(draws.z.shape[:2])
    for place, point in enumerate(times):
        t, way = model.points.instant(point), model.ways[model.points.way(point)]
        given = model, draws.upto(t), times[:place], stream, fixed
        *noise, uniform = (
            variates(kind, _SEEN, stream, index, t, TRUTH_MEASUREMENT, c)
            for c, kind in enumerate(kinds)
        )
        for d, x in enumerate(plain.filter_checked_draws(*given).cloud):
            shares = (np.arange(number) + uniform[d, 0]) / number
            chosen = (shares * settings.particles).astype(int)
            v = tuple(each[d, 1 : number + 1] for each in noise[way.v])
            made = way.model.measurement(tuple(x[:, chosen]), t, v, model.p)
            replicates = np.stack([np.broadcast_to(each, number) for each in made], axis=1)
            ys = np.vstack([draws.y[d, t, way.y], replicates])
            after = [_variance(model, way.model, x, y, t) for y in ys]
            found[d, t] = after[0] - np.mean(after[1:])
    return found


def _variance(
    model: StateSpaceModel, sensor: StateSpaceModel, x: NDArray[np.float64], y: NDArray[np.float64],
    t: int,
) -> float:  # fmt: skip
    """The variance of z, summed over its components; 1 - R for an angle."""
    log = sensor.log_likelihood(tuple(y), tuple(x), t, model.p)
    weight = weights_of(np.broadcast_to(log, (1, x.shape[1])))[0]
    share = weight / weight.sum()
    z = model.quantity_of_interest(tuple(x), t, model.p)
    pairs = zip(z, model.is_angle, strict=True)
    return sum(
        1 - abs(np.sum(share * np.exp(1j * each)))
        if is_angle
        else np.sum(share * each**2) - np.sum(share * each) ** 2
        for each, is_angle in pairs
    )
