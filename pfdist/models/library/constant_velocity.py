"""Range and bearing of a passing ship: nearly constant velocity in the plane.

x is the ship's position in km, east and north of the sensor, and its velocity in km a minute. A
step is a minute, and angles are clockwise from north. The acceleration is white noise in continuous
time. In a step the velocity gains sqrt(q) times N(0, 1), and the position gains half of that and
sqrt(q/12) times another N(0, 1). So their covariance is q [[1, 1/2], [1/2, 1/3]].

The error across the line of sight is the range times the error of the bearing, so a measurement is
more informative when the ship is near. The scenario (T = 40) was made up for pfdist.

References
----------
Bar-Shalom, Li, Kirubarajan, "Estimation with Applications to Tracking and Navigation", 2001: the
white noise acceleration model, discretised.
"""

import math

import numpy as np

from pfdist.models.base import StateSpaceModel
from pfdist.models.library.bearings_only import wrapped
from pfdist.models.parameters import NOT_NEGATIVE, POSITIVE


def initial(w, p):
    return (
        p.east + p.position_sd * w[0],
        p.north + p.position_sd * w[1],
        p.velocity_east + p.velocity_sd * w[2],
        p.velocity_north + p.velocity_sd * w[3],
    )


def transition(x, t, w, p):
    east, north = p.acceleration_sd * w[0], p.acceleration_sd * w[1]
    apart = p.acceleration_sd / math.sqrt(12)
    return (
        x[0] + x[2] + east / 2 + apart * w[2],
        x[1] + x[3] + north / 2 + apart * w[3],
        x[2] + east,
        x[3] + north,
    )


def range_and_bearing(x):
    return np.hypot(x[0], x[1]), np.arctan2(x[0], x[1])


def measurement(x, t, v, p):
    distance, bearing = range_and_bearing(x)
    return (distance + p.range_sd * v[0], wrapped(bearing + p.bearing_sd * v[1]))


def log_likelihood(y, x, t, p):
    distance, bearing = range_and_bearing(x)
    across = wrapped(y[1] - bearing) / p.bearing_sd
    return -0.5 * (((y[0] - distance) / p.range_sd) ** 2 + across**2)


def quantity_of_interest(x, t, p):
    return (x[0], x[1])


model = StateSpaceModel(
    name="constant_velocity",
    initial=initial,
    transition=transition,
    measurement=measurement,
    log_likelihood=log_likelihood,
    quantity_of_interest=quantity_of_interest,
    initial_noise=("normal",) * 4,
    process_noise=("normal",) * 4,
    measurement_noise=("normal", "normal"),
    parameters={
        "east": -10.0,
        "north": 2.0,
        "velocity_east": 0.4,  # 13 knots
        "velocity_north": 0.0,
        "position_sd": 0.3,
        "velocity_sd": 0.05,
        "acceleration_sd": 0.03,  # sqrt(q)
        "range_sd": 0.5,
        "bearing_sd": math.radians(4),
    },
    parameter_ranges={
        "position_sd": NOT_NEGATIVE,
        "velocity_sd": NOT_NEGATIVE,
        "acceleration_sd": NOT_NEGATIVE,
        "range_sd": POSITIVE,
        "bearing_sd": POSITIVE,
    },
    x_names=("east [km]", "north [km]", "velocity east [km/min]", "velocity north [km/min]"),
    y_names=("range [km]", "bearing [rad]"),
    z_names=("east [km]", "north [km]"),
)
