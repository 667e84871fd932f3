"""A tumour's breathing motion along one axis, in X-ray images: the authors' follow-up paper.

The motion is a sine. Its amplitude, frequency and offset are unknown and drift inside a box. A step
is 0.25 s. The paper takes T = 30, N = 11 and 1,000 particles. The filter of the paper lets the
frequency drift, with ``frequency_sd = 0.005``; the parameters in this file are those of the truth.

References
----------
Aspeel, Gouverneur, Jungers, Macq, "Optimal intermittent particle filter", IEEE Transactions on
Signal Processing, 2022 (arXiv 2204.06265).
"""

import numpy as np

from pfdist.elementwise import clip
from pfdist.models.base import StateSpaceModel
from pfdist.models.parameters import NOT_NEGATIVE, POSITIVE

AMPLITUDE = (8.8, 24.0)
FREQUENCY = (0.52, 0.84)  # radians a step
OFFSET = (-5.8, 5.8)


def between(limits, share):
    return limits[0] + share * (limits[1] - limits[0])


def initial(w, p):
    return (between(AMPLITUDE, w[0]), between(FREQUENCY, w[1]), between(OFFSET, w[2]))


def transition(x, t, w, p):
    return (
        clip(x[0] + p.amplitude_sd * w[0], AMPLITUDE[0], AMPLITUDE[1]),
        clip(x[1] + p.frequency_sd * w[1], FREQUENCY[0], FREQUENCY[1]),
        clip(x[2] + p.offset_sd * w[2], OFFSET[0], OFFSET[1]),
    )


def position(x, t):
    return x[0] * np.sin(x[1] * t) + x[2]


def measurement(x, t, v, p):
    return (position(x, t) + p.measurement_sd * v[0],)


def log_likelihood(y, x, t, p):
    return -0.5 * ((y[0] - position(x, t)) / p.measurement_sd) ** 2


def quantity_of_interest(x, t, p):
    return (position(x, t),)


model = StateSpaceModel(
    name="tumour",
    initial=initial,
    transition=transition,
    measurement=measurement,
    log_likelihood=log_likelihood,
    quantity_of_interest=quantity_of_interest,
    initial_noise=("uniform", "uniform", "uniform"),
    process_noise=("normal", "normal", "normal"),
    measurement_noise=("normal",),
    parameters={
        "amplitude_sd": 1.0,
        "frequency_sd": 0.0,
        "offset_sd": 1.0,
        "measurement_sd": 1.0,
    },
    parameter_ranges={
        "amplitude_sd": NOT_NEGATIVE,
        "frequency_sd": NOT_NEGATIVE,
        "offset_sd": NOT_NEGATIVE,
        "measurement_sd": POSITIVE,
    },
    x_names=("amplitude [mm]", "frequency [rad]", "offset [mm]"),
    y_names=("measured position [mm]",),
    z_names=("position [mm]",),
)
