"""Stochastic volatility of a price: x is the log variance of the daily return.

z is the volatility exp(x/2), the standard deviation of the return, in the unit of y. The parameters
are about those of daily pound/dollar returns in per cent.

References
----------
Taylor, "Financial returns modelled by the product of two stochastic processes", 1982. Kim,
Shephard, Chib, "Stochastic volatility: likelihood inference and comparison with ARCH models",
Review of Economic Studies 65, 1998.
"""

import numpy as np

from pfdist.models.base import StateSpaceModel
from pfdist.models.parameters import NOT_NEGATIVE


def initial(w, p):  # stationary
    return (p.mu + p.sigma / np.sqrt(1 - p.phi**2) * w[0],)


def transition(x, t, w, p):
    return (p.mu + p.phi * (x[0] - p.mu) + p.sigma * w[0],)


def measurement(x, t, v, p):
    return (np.exp(x[0] / 2) * v[0],)


def log_likelihood(y, x, t, p):
    return -0.5 * (x[0] + y[0] ** 2 * np.exp(-x[0]))


def quantity_of_interest(x, t, p):
    return (np.exp(x[0] / 2),)


model = StateSpaceModel(
    name="stochastic_volatility",
    initial=initial,
    transition=transition,
    measurement=measurement,
    log_likelihood=log_likelihood,
    quantity_of_interest=quantity_of_interest,
    initial_noise=("normal",),
    process_noise=("normal",),
    measurement_noise=("normal",),
    parameters={"mu": -0.87, "phi": 0.98, "sigma": 0.16},
    parameter_ranges={"phi": (-0.999999, 0.999999), "sigma": NOT_NEGATIVE},
    x_names=("log variance",),
    y_names=("daily return [%]",),
    z_names=("volatility [%]",),
)
