"""A swallowed drug. Nobody knows its absorption, clearance and volume; they do not change."""

import numpy as np

from pfdist import StateSpaceModel, densities

TYPICAL = (1.2, 3.0, 30.0)  # absorption [1/h], clearance [L/h], volume [L]; each may be 30 % off


def concentration(x, t, p):  # of a dose of 100 mg
    absorption, clearance, volume = (np.exp(value) for value in x)
    rate = clearance / volume
    curve = np.exp(-rate * p.time[t]) - np.exp(-absorption * p.time[t])
    return 100.0 / volume * absorption / (absorption - rate) * curve


def deviation(x, t, p):  # of the assay: 10 %, and 0.01 mg/L
    return 0.1 * concentration(x, t, p) + 0.01


model = StateSpaceModel(
    name="drug",
    initial=lambda w, p: tuple(np.log(value) + 0.3 * w[k] for k, value in enumerate(TYPICAL)),
    transition=lambda x, t, w, p: x,
    measurement=lambda x, t, v, p: (concentration(x, t, p) + deviation(x, t, p) * v[0],),
    log_likelihood=lambda y, x, t, p: densities.normal_logpdf(
        y[0], concentration(x, t, p), deviation(x, t, p)
    ),
    quantity_of_interest=lambda x, t, p: x,
    initial_noise=("normal",) * 3,
    process_noise=(),
    measurement_noise=("normal",),
    normalised=True,
    x_names=("log absorption", "log clearance", "log volume"),
    y_names=("concentration [mg/L]",),
    z_names=("log absorption", "log clearance", "log volume"),
)
