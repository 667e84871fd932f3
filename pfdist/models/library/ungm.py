"""The univariate nonlinear growth model, with the paper's variances (equations 9 to 12).

y = x^2/20 hides the sign of x, so the particles often form two clusters, around x and -x.
The measurement noise varies with t, which makes some times better than others.

References
----------
Aspeel, Gouverneur, Jungers, Macq, "Optimal measurement budget allocation for particle
filtering", ICIP 2020. Kitagawa, "Monte Carlo filter and smoother for non-Gaussian nonlinear
state space models", 1996.
"""

import numpy as np

from pfdist.models.base import StateSpaceModel
from pfdist.models.parameters import NOT_NEGATIVE, POSITIVE


def initial(w, p):
    return (p.initial_sd * w[0],)


def transition(x, t, w, p):
    return (x[0] / 2 + 25 * x[0] / (1 + x[0] ** 2) + 8 * np.cos(1.2 * t) + p.process_sd * w[0],)


def measurement(x, t, v, p):
    return (x[0] ** 2 / 20 + p.measurement_sd * (np.sin(0.25 * t) + 2) * v[0],)


def log_likelihood(y, x, t, p):
    sd = p.measurement_sd * (np.sin(0.25 * t) + 2)
    return -0.5 * ((y[0] - x[0] ** 2 / 20) / sd) ** 2


def quantity_of_interest(x, t, p):
    return (x[0],)


model = StateSpaceModel(
    name="ungm",
    initial=initial,
    transition=transition,
    measurement=measurement,
    log_likelihood=log_likelihood,
    quantity_of_interest=quantity_of_interest,
    initial_noise=("normal",),
    process_noise=("normal",),
    measurement_noise=("normal",),
    parameters={"initial_sd": 5.0, "process_sd": 1.0, "measurement_sd": 1.0},
    parameter_ranges={
        "initial_sd": NOT_NEGATIVE,
        "process_sd": NOT_NEGATIVE,
        "measurement_sd": POSITIVE,
    },
    x_names=("state",),
    y_names=("measurement",),
    z_names=("state",),
)
