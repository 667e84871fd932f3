"""A model with draws and log densities of `pfdist.densities`: counts at a rate, and a direction."""

import numpy as np

from pfdist import StateSpaceModel, densities


def _rate(x, p):
    return p.rate * np.exp(densities.erf(x[0]))


def measurement(x, t, v, p):
    return (
        densities.poisson_draw(v[0], _rate(x, p)),
        densities.von_mises_draw(v[1], x[1], p.concentration),
    )


def log_likelihood(y, x, t, p):
    return densities.poisson_logpmf(y[0], _rate(x, p)) + densities.von_mises_logpdf(
        y[1], x[1], p.concentration
    )


model = StateSpaceModel(
    name="drawn",
    initial=lambda w, p: (w[0], densities.gamma_draw(w[1], 2.0, 0.5)),
    transition=lambda x, t, w, p: (
        0.9 * x[0] + densities.student_t_draw(w[0], w[1], 3.0, 0.0, 0.2),
        x[1] + densities.laplace_draw(w[2], 0.0, 0.1),
    ),
    measurement=measurement,
    log_likelihood=log_likelihood,
    quantity_of_interest=lambda x, t, p: (x[0], x[1]),
    initial_noise=("normal", "centred"),
    process_noise=("centred", "uniform", "centred"),
    measurement_noise=("centred", "centred"),
    parameters={"rate": 5.0, "concentration": 4.0},
)
