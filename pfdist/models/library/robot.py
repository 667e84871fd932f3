"""A robot with unknown heading, which measures the angles between its nose and two beacons.

x is the robot's position in m, east and north, and its heading in radians, counterclockwise from
east. A step is a second. The robot drives straight ahead except for one bend. Its wheels slip in
the bend, so its heading soon becomes uncertain there; elsewhere the heading drifts slowly. At first
its position is known roughly, and its heading is unknown. A measurement gives the angle of each
beacon, seen from the robot and counted from its nose. Its error has a von Mises distribution, the
counterpart of the normal distribution on a circle. So the likelihood needs no rule for angles near
half a turn.

The quantity of interest is the heading. It is circular: two headings that differ by a full turn are
the same. So the estimate is the mean direction of the particles, and the error is 1 - cos of the
difference. A completely unknown heading has the error 1.

References
----------
Thrun, Burgard, Fox, "Probabilistic robotics", 2005, chapters 5 and 6 (motion with errors, bearings
of landmarks). Mardia, Jupp, "Directional statistics", 2000, section 3.5.4 (von Mises).
"""

import math

import numpy as np

from pfdist.densities.draws import von_mises_draw
from pfdist.densities.log_densities import von_mises_logpdf
from pfdist.elementwise import where
from pfdist.models.base import StateSpaceModel
from pfdist.models.parameters import NOT_NEGATIVE

BEACONS = ((0.0, 12.0), (15.0, -5.0))  # m, east and north


def initial(w, p):
    return (p.position_sd * w[0], p.position_sd * w[1], 2 * math.pi * w[2])


def transition(x, t, w, p):
    east, north, heading = x
    distance = p.speed + p.speed_sd * w[0]
    rate = where((t >= p.bend) & (t < p.bend_end), p.turn_rate, 0.0)
    turned = rate + (p.drift_sd + p.slip * rate) * w[1]
    middle = heading + turned / 2
    return (east + distance * np.cos(middle), north + distance * np.sin(middle), heading + turned)


def angles(x):  # of the beacons, from the nose
    (east, north), (second_east, second_north) = BEACONS
    return (
        np.arctan2(north - x[1], east - x[0]) - x[2],
        np.arctan2(second_north - x[1], second_east - x[0]) - x[2],
    )


def measurement(x, t, v, p):
    first, second = angles(x)
    return (
        wrapped(von_mises_draw(v[0], first, p.concentration)),
        wrapped(von_mises_draw(v[1], second, p.concentration)),
    )


def wrapped(angle):  # to (-pi, pi]
    return angle - 2 * math.pi * np.ceil((angle - math.pi) / (2 * math.pi))


def log_likelihood(y, x, t, p):
    first, second = angles(x)
    return von_mises_logpdf(y[0], first, p.concentration) + von_mises_logpdf(
        y[1], second, p.concentration
    )


def quantity_of_interest(x, t, p):
    return (x[2],)


model = StateSpaceModel(
    name="robot",
    initial=initial,
    transition=transition,
    measurement=measurement,
    log_likelihood=log_likelihood,
    quantity_of_interest=quantity_of_interest,
    initial_noise=("normal", "normal", "uniform"),
    process_noise=("normal", "normal"),
    measurement_noise=("uniform", "uniform"),
    parameters={
        "position_sd": 3.0,
        "speed": 0.5,
        "speed_sd": 0.05,
        "bend": 14.0,
        "bend_end": 22.0,
        "turn_rate": 0.2,
        "slip": 1.0,
        "drift_sd": 0.02,
        "concentration": 30.0,
    },
    parameter_ranges={
        "position_sd": NOT_NEGATIVE,
        "speed_sd": NOT_NEGATIVE,
        "turn_rate": NOT_NEGATIVE,
        "slip": NOT_NEGATIVE,
        "drift_sd": NOT_NEGATIVE,
        "concentration": NOT_NEGATIVE,
    },
    x_names=("east [m]", "north [m]", "heading [rad]"),
    y_names=("first beacon [rad]", "second beacon [rad]"),
    z_names=("heading [rad]",),
    circular=("heading",),
)
