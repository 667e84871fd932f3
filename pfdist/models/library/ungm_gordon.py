"""The univariate nonlinear growth model with the variances of Gordon, Salmond and Smith.

The process variance is 10, ten times that of ``ungm``. The measurement variance is 1 at all times,
so no time is better than another. The filter starts from N(0, 2), and so does the truth; Gordon et
al. started the truth at 0.1.

References
----------
Gordon, Salmond, Smith, "Novel approach to nonlinear/non-Gaussian Bayesian state estimation", IEE
Proceedings F 140, 1993.
"""

import dataclasses
import math

from pfdist.models.library.ungm import model as ungm


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
