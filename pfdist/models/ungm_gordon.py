"""The univariate nonlinear growth model with the variances of the first particle filter.

The state is pushed much harder than in ``ungm``, and a measurement is as good at all times: process
variance 10, measurement variance 1. The filter starts from N(0, 2); so does the truth here, where
Gordon et al. started it at 0.1.

References
----------
Gordon, Salmond, Smith, "Novel approach to nonlinear/non-Gaussian Bayesian state estimation", IEE
Proceedings F 140, 1993.
"""

import dataclasses
import math

from pfdist.models.ungm import model as ungm


def measurement(x, t, v, p):
    return (x[0] ** 2 / 20 + p.measurement_sd * v[0],)


def log_likelihood(y, x, t, p):
    return -0.5 * ((y[0] - x[0] ** 2 / 20) / p.measurement_sd) ** 2


model = dataclasses.replace(
    ungm,
    name="ungm_gordon",
    measurement=measurement,
    log_likelihood=log_likelihood,
    parameters={
        "initial_sd": math.sqrt(2),
        "process_sd": math.sqrt(10),
        "measurement_sd": 1.0,
    },
)
