"""Point-mass filter: the exact filter of a scalar model with additive Gaussian process noise.

The density of x(t) is kept at equidistant points, which cover the draws and their surroundings.
Integrals are sums over the points: of smooth functions that vanish at both ends, so that the error
falls faster than any power of the step, once this is smaller than the deviation of the process
noise over the steepest slope of the transition.

Bucy, Senne, "Digital synthesis of non-linear filters", Automatica 7, 1971. Kitagawa, "Non-Gaussian
state-space modeling of nonstationary time series", Journal of the American Statistical Association
82, 1987.
"""

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from pfdist import StateSpaceModel
from pfdist.filters.draws import Draws

Array = NDArray[np.float64]
WRONG = "the grid filter is for one state and additive Gaussian noise of a constant deviation"


def grid_filter(
    model: StateSpaceModel, draws: Draws, measurement_times: Collection[int], points: int = 1000
) -> tuple[Array, Array]:
    """Mean (D, T+1) and variance (D, T+1) of z(t) given the measurements up to t.

    The draws, some dozens at least, also say how wide the grids are.
    """
    if not (model.components[0] == 1 and model.initial_noise == model.process_noise == ("normal",)):
        raise ValueError(WRONG)
    p, instants = model.p, draws.x.shape[1]
    means, variances = np.empty((2, len(draws.x), instants))
    centre, sd = _mean_and_deviation(lambda w: model.initial((w,), p)[0])
    x = _grid(draws, 0, sd, points)
    weights = np.tile(_normal(x, centre, sd), (len(draws.x), 1))
    for t in range(instants):
        if t in measurement_times:
            log_likelihood = model.log_likelihood((draws.y[:, t],), (x,), t, p)
            weights *= np.exp(log_likelihood - log_likelihood.max(axis=1, keepdims=True))
        weights /= weights.sum(axis=1, keepdims=True)
        (z,) = model.quantity_of_interest((x,), t, p)
        means[:, t] = weights @ z
        variances[:, t] = weights @ z**2 - means[:, t] ** 2
        if t + 1 < instants:
            pushed, sd = _mean_and_deviation(
                lambda w, x=x, t=t: model.transition((x,), t, (w,), p)[0]
            )
            x = _grid(draws, t + 1, sd, points)
            weights = weights @ _normal(x, pushed[:, None], sd)
    return means, variances


def grid_smoother(
    model: StateSpaceModel, draws: Draws, measurement_times: Collection[int], points: int = 1000
) -> Array:
    """Mean (D, T+1) of z(t) given all measurements; arguments as for `grid_filter`.

    The likelihood of later measurements goes back, and the density of the earlier ones forward.
    """
    p, instants = model.p, draws.x.shape[1]
    means, likelihoods = np.empty((len(draws.x), instants)), list[Array]()
    grids, steps, densities = list[Array](), list[Array](), list[Array]()
    pushed, sd = _mean_and_deviation(lambda w: model.initial((w,), p)[0])
    for t in range(instants):
        grids.append(_grid(draws, t, sd, points))
        steps.append(_normal(grids[t], pushed if t == 0 else pushed[:, None], sd))
        weights = densities[-1] @ steps[t] if t else np.tile(steps[0], (len(draws.x), 1))
        likelihoods.append(np.ones_like(weights))
        if t in measurement_times:
            log_likelihood = model.log_likelihood((draws.y[:, t],), (grids[t],), t, p)
            likelihoods[t] = np.exp(log_likelihood - log_likelihood.max(axis=1, keepdims=True))
        weights = weights * likelihoods[t]
        densities.append(weights / weights.sum(axis=1, keepdims=True))
        if t + 1 < instants:
            pushed, sd = _mean_and_deviation(
                lambda w, t=t: model.transition((grids[t],), t, (w,), p)[0]
            )
    later = np.ones_like(densities[0])
    for t in range(instants - 1, -1, -1):
        both = densities[t] * later
        (z,) = model.quantity_of_interest((grids[t],), t, p)
        means[:, t] = both @ z / both.sum(axis=1)
        if t:
            later = (later * likelihoods[t]) @ steps[t].T
            later /= later.max(axis=1, keepdims=True)
    return means


def _mean_and_deviation(formula) -> tuple[Array, float]:
    """Give the mean and the factor of the noise of a formula that is affine in its noise."""
    mean, plus_one, minus_one = formula(0.0), formula(1.0), formula(-1.0)
    sd = np.ravel(plus_one - mean)[0]
    if not (sd > 0 and np.allclose(plus_one - mean, sd) and np.allclose(mean - minus_one, sd)):
        raise ValueError(WRONG)
    return mean, sd


def _grid(draws: Draws, t: int, sd: float, points: int) -> Array:
    low, high = draws.x[:, t].min(), draws.x[:, t].max()
    beyond = (high - low) / 4 + 6 * sd  # or the tails of a draw at the end are cut off
    return np.linspace(low - beyond, high + beyond, points)


def _normal(x: Array, mean: Array, sd: float) -> Array:
    """The density up to a constant: weights are normalised."""
    return np.exp(-0.5 * ((x - mean) / sd) ** 2)
