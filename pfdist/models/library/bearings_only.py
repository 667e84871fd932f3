"""Bearings-only tracking of a ship, from angles that a turning observer measures.

x is the target's position in km, east and north, and its velocity in km a minute. A step is a
minute, and angles are in radians, clockwise from north. While the observer keeps its course, it
can hardly distinguish a near and slow target from a far and fast target. So the observer turns.

The state equation is that of Gordon et al. The scenario (T = 30) is the moderately nonlinear
scenario of Leong et al., with three changes. The observer turns at once, not in four minutes. The
first range, speed and course are uniform, not normal, with the same standard deviations, so no
range is negative. The random acceleration has a standard deviation of 0.006 km/min^2, not 0.0014,
because otherwise the particles of a bootstrap filter soon have few different velocities. The filter
still needs 2,000 particles or more.

References
----------
Gordon, Salmond, Smith, "Novel approach to nonlinear/non-Gaussian Bayesian state estimation", IEE
Proceedings F 140, 1993. Leong, Arulampalam, Lamahewa, Abhayapala, "Gaussian-sum cubature Kalman
filter with improved robustness for bearings-only tracking", IEEE Signal Processing Letters, 2014.
"""

import math

import numpy as np

from pfdist.models.base import StateSpaceModel
from pfdist.models.parameters import NOT_NEGATIVE, POSITIVE

KNOT = 1.852 / 60  # km a minute
FIRST_BEARING = math.radians(80)


def uniform(mean, sd, share):  # the quantile of a uniform distribution at a share in 0..1
    return mean + math.sqrt(12) * sd * (share - 0.5)


def initial(w, p):
    distance = uniform(p.range_mean, p.range_sd, w[0])
    bearing = FIRST_BEARING + p.bearing_sd * w[1]
    speed = uniform(p.speed_mean, p.speed_sd, w[2])
    course = FIRST_BEARING + math.pi * (w[3] + 0.5)  # towards the observer, up to a right angle off
    return (
        distance * np.sin(bearing),
        distance * np.cos(bearing),
        speed * np.sin(course),
        speed * np.cos(course),
    )


def transition(x, t, w, p):
    east, north = p.acceleration_sd * w[0], p.acceleration_sd * w[1]
    return (x[0] + x[2] + east / 2, x[1] + x[3] + north / 2, x[2] + east, x[3] + north)


def observer(t, p):  # position, which is the origin at t = 0
    before, after = np.minimum(t, p.turn), np.maximum(t - p.turn, 0.0)
    east = before * np.sin(p.first_course) + after * np.sin(p.second_course)
    north = before * np.cos(p.first_course) + after * np.cos(p.second_course)
    return p.observer_speed * east, p.observer_speed * north


def bearing_of(x, t, p):
    east, north = observer(t, p)
    return np.arctan2(x[0] - east, x[1] - north)


def wrapped(angle):  # to (-pi, pi]
    return angle - 2 * math.pi * np.ceil((angle - math.pi) / (2 * math.pi))


def measurement(x, t, v, p):
    return (wrapped(bearing_of(x, t, p) + p.bearing_sd * v[0]),)


def log_likelihood(y, x, t, p):
    return -0.5 * (wrapped(y[0] - bearing_of(x, t, p)) / p.bearing_sd) ** 2


def quantity_of_interest(x, t, p):
    return (x[0], x[1])


model = StateSpaceModel(
    name="bearings_only",
    initial=initial,
    transition=transition,
    measurement=measurement,
    log_likelihood=log_likelihood,
    quantity_of_interest=quantity_of_interest,
    initial_noise=("uniform", "normal", "uniform", "uniform"),
    process_noise=("normal", "normal"),
    measurement_noise=("normal",),
    parameters={
        "range_mean": 5.0,
        "range_sd": 2.0,
        "speed_mean": 4 * KNOT,
        "speed_sd": 2 * KNOT,
        "acceleration_sd": 0.006,
        "bearing_sd": math.radians(1.5),
        "observer_speed": 5 * KNOT,
        "first_course": math.radians(140),
        "second_course": math.radians(20),
        "turn": 15.0,
    },
    parameter_ranges={
        "range_mean": NOT_NEGATIVE,
        "range_sd": NOT_NEGATIVE,
        "speed_mean": NOT_NEGATIVE,
        "speed_sd": NOT_NEGATIVE,
        "acceleration_sd": NOT_NEGATIVE,
        "bearing_sd": POSITIVE,
        "observer_speed": NOT_NEGATIVE,
        "turn": NOT_NEGATIVE,
    },
    x_names=("east [km]", "north [km]", "velocity east [km/min]", "velocity north [km/min]"),
    y_names=("bearing [rad]",),
    z_names=("east [km]", "north [km]"),
)
