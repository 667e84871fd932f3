"""The exact filter of a model without process noise, whose first state has two normal variates.

The state is a function of these two variates, so their posterior distribution is all there is to
know. It is kept at the points of a square, with the normal density as first weights. Integrals are
sums over equidistant points: of smooth functions that vanish at all ends, so that the error falls
faster than any power of the step.

Davis, Rabinowitz, "Methods of numerical integration", 1984, section 2.9.
"""

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from pfdist import StateSpaceModel
from pfdist.filters.draws import Draws

Array = NDArray[np.float64]
_BEYOND = 6.5  # standard deviations: one variate in 10^10 lies outside


def quadrature_filter(
    model: StateSpaceModel, draws: Draws, measurement_times: Collection[int], points: int = 151
) -> tuple[Array, Array]:
    """Mean (D, T+1) and variance (D, T+1) of z(t) given the measurements up to t.

    The process noise of the model must have no effect: its formulas get zeros.
    """
    if model.initial_noise != ("normal", "normal"):
        raise ValueError("the first state must have two normal variates")
    line = np.linspace(-_BEYOND, _BEYOND, points)
    w = tuple(grid.ravel() for grid in np.meshgrid(line, line))
    no_noise = (0.0,) * len(model.process_noise)
    means, variances = np.empty((2, len(draws.x), draws.x.shape[1]))
    log_weights = np.tile(-0.5 * (w[0] ** 2 + w[1] ** 2), (len(draws.x), 1))
    x = tuple(np.broadcast_to(component, w[0].shape) for component in model.initial(w, model.p))
    for t in range(draws.x.shape[1]):
        if t in measurement_times:
            for d, y in enumerate(draws.y[:, t]):
                log_weights[d] += model.log_likelihood(tuple(y), x, t, model.p)
        weights = np.exp(log_weights - log_weights.max(axis=1, keepdims=True))
        weights /= weights.sum(axis=1, keepdims=True)
        (z,) = model.quantity_of_interest(x, t, model.p)
        means[:, t] = weights @ z
        variances[:, t] = weights @ z**2 - means[:, t] ** 2
        if t + 1 < draws.x.shape[1]:
            x = model.transition(x, t, no_noise, model.p)
    return means, variances
