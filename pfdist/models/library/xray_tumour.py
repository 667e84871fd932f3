"""A tumour that moves with breathing, seen in X-ray projection: the example of the paper.

x is the tumour's displacement from rest in mm, lateral, longitudinal (along the body) and vertical,
and its velocity in mm/s. y is its position on a flat detector in mm. z is the displacement. Each
direction is a stationary damped oscillator with the period of the breath, driven by white noise.
The step of `step` seconds is exact for this oscillator. The three directions are independent, which
is only roughly true for a real breath.

A point source and the detector turn with a gantry about the longitudinal axis. At angle 0 the
source is above. The tumour rests at the isocentre, `source_axis` mm from the source; the detector
is `source_detector` mm from the source. An image hardly shows the depth, except for a small
magnification, so the filter learns the depth as the gantry turns. Sizes and rates are round
numbers: 4 s for a breath, most of the motion along the body, a turn in a minute.

References
----------
Aspeel, Gouverneur, Jungers, Macq, "Optimal measurement budget allocation for particle filtering",
ICIP 2020, section 2: x in R^6, y in R^2, z in R^3. Poulsen, Cho, Keall, "A method to estimate mean
position, motion magnitude, motion correlation, and trajectory of a tumor from cone-beam CT
projections for image-guided radiotherapy", International Journal of Radiation Oncology, Biology,
Physics 72, 2008: the geometry, and a Gaussian position.
"""

import math

import numpy as np

from pfdist.models.base import StateSpaceModel
from pfdist.models.parameters import NOT_NEGATIVE, POSITIVE


def initial(w, p):
    pace = 2 * math.pi / p.period
    return (
        p.lateral_sd * w[0],
        p.longitudinal_sd * w[1],
        p.vertical_sd * w[2],
        p.lateral_sd * pace * w[3],
        p.longitudinal_sd * pace * w[4],
        p.vertical_sd * pace * w[5],
    )


def moved(position, velocity, sd, w0, w1, p):
    """Position and velocity in one direction after one step.

    The noise keeps the variances at sd^2 and (pace sd)^2.
    """
    pace = 2 * math.pi / p.period
    decay = p.damping * pace
    pace_damped = pace * np.sqrt(1 - p.damping**2)
    shrink = np.exp(-decay * p.step)
    cosine = shrink * np.cos(pace_damped * p.step)
    sine = shrink * np.sin(pace_damped * p.step) / pace_damped
    xx, xv = cosine + decay * sine, sine
    vx, vv = -(pace**2) * sine, cosine - decay * sine
    # Covariance of the noise of a step, divided by sd^2, and its Cholesky factor.
    var_x = 1 - xx**2 - (pace * xv) ** 2
    cov = -xx * vx - pace**2 * xv * vv
    var_v = pace**2 - vx**2 - (pace * vv) ** 2
    noise_x = sd * np.sqrt(var_x)
    noise_vx, noise_v = sd * cov / np.sqrt(var_x), sd * np.sqrt(var_v - cov**2 / var_x)
    return (
        xx * position + xv * velocity + noise_x * w0,
        vx * position + vv * velocity + noise_vx * w0 + noise_v * w1,
    )


def transition(x, t, w, p):
    lateral = moved(x[0], x[3], p.lateral_sd, w[0], w[3], p)
    longitudinal = moved(x[1], x[4], p.longitudinal_sd, w[1], w[4], p)
    vertical = moved(x[2], x[5], p.vertical_sd, w[2], w[5], p)
    return (lateral[0], longitudinal[0], vertical[0], lateral[1], longitudinal[1], vertical[1])


def projection(x, t, p):
    angle = p.first_angle + p.rotation * p.step * t
    across = x[0] * np.cos(angle) - x[2] * np.sin(angle)
    towards_source = x[0] * np.sin(angle) + x[2] * np.cos(angle)
    magnification = p.source_detector / (p.source_axis - towards_source)
    return magnification * across, magnification * x[1]


def measurement(x, t, v, p):
    across, along = projection(x, t, p)
    return (across + p.measurement_sd * v[0], along + p.measurement_sd * v[1])


def log_likelihood(y, x, t, p):
    across, along = projection(x, t, p)
    return -0.5 * ((y[0] - across) ** 2 + (y[1] - along) ** 2) / p.measurement_sd**2


def quantity_of_interest(x, t, p):
    return (x[0], x[1], x[2])


model = StateSpaceModel(
    name="xray_tumour",
    initial=initial,
    transition=transition,
    measurement=measurement,
    log_likelihood=log_likelihood,
    quantity_of_interest=quantity_of_interest,
    initial_noise=("normal",) * 6,
    process_noise=("normal",) * 6,
    measurement_noise=("normal", "normal"),
    parameters={
        "period": 4.0,
        "damping": 0.05,
        "lateral_sd": 2.0,
        "longitudinal_sd": 5.0,
        "vertical_sd": 3.0,
        "step": 0.25,
        "first_angle": 0.0,
        "rotation": 2 * math.pi / 60,
        "source_axis": 1000.0,
        "source_detector": 1500.0,
        "measurement_sd": 2.0,
    },
    parameter_ranges={
        "period": POSITIVE,
        "damping": (1e-3, 0.999),
        "lateral_sd": NOT_NEGATIVE,
        "longitudinal_sd": NOT_NEGATIVE,
        "vertical_sd": NOT_NEGATIVE,
        "step": POSITIVE,
        "source_axis": POSITIVE,
        "source_detector": POSITIVE,
        "measurement_sd": POSITIVE,
    },
    x_names=(
        "lateral [mm]",
        "longitudinal [mm]",
        "vertical [mm]",
        "lateral velocity [mm/s]",
        "longitudinal velocity [mm/s]",
        "vertical velocity [mm/s]",
    ),
    y_names=("across the detector [mm]", "along the detector [mm]"),
    z_names=("lateral [mm]", "longitudinal [mm]", "vertical [mm]"),
)
