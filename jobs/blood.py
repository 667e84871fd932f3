"""Blood glucose on a day with three meals. Nobody knows beforehand how much will be eaten."""

import numpy as np

from pfdist import StateSpaceModel


def transition(x, t, w, p):
    gut, glucose = x  # what is left of the meals, and the glucose in the blood; mmol/L
    if p.time[t] in (7.0, 12.5, 19.0):  # a meal
        gut = gut + 8.0 * np.exp(0.5 * w[0])
    absorbed = gut * (1 - np.exp(-p.dt[t] / 0.7))
    removed = (glucose - 5.5) * (1 - np.exp(-p.dt[t] / 2.0))
    noise = np.exp(0.05 * np.sqrt(p.dt[t]) * w[1])
    return (gut - absorbed, (glucose + absorbed - removed) * noise)


model = StateSpaceModel(
    name="blood glucose",
    initial=lambda w, p: (0.0, 6.0 * np.exp(0.1 * w[0])),
    transition=transition,
    measurement=lambda x, t, v, p: (np.log(x[1]) + 0.08 * v[0],),  # the meter is 8 % off
    log_likelihood=lambda y, x, t, p: -0.5 * ((y[0] - np.log(x[1])) / 0.08) ** 2,
    quantity_of_interest=lambda x, t, p: (x[1],),
    initial_noise=("normal",),
    process_noise=("normal", "normal"),
    measurement_noise=("normal",),
    z_names=("glucose [mmol/L]",),
)
