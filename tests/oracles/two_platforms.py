"""A target that two platforms see by its bearing: one turns, the other stands still."""

import math
from dataclasses import replace

import numpy as np

from pfdist import Sensor, StateSpaceModel
from pfdist.models.library.bearings_only import bearing_of, model, wrapped

EAST, NORTH = 6.0, 3.0  # km: the platform that stands still
STILL_SD = math.radians(8.0)
PARAMETERS = {"bearing_sd": math.radians(6.0), "range_sd": 1.0, "acceleration_sd": 0.03}


def _still(x, t, p):
    return np.arctan2(x[0] - EAST, x[1] - NORTH)


def two_platforms() -> StateSpaceModel:
    """The model of bearings that ships, with a second and less exact platform."""
    return replace(
        model,
        name="two_platforms",
        measurement=StateSpaceModel.__dataclass_fields__["measurement"].default,
        log_likelihood=StateSpaceModel.__dataclass_fields__["log_likelihood"].default,
        measurement_noise=(),
        y_names=(),
        parameters={**model.parameters, **PARAMETERS},
        sensors={
            "moving": Sensor(
                lambda x, t, v, p: (wrapped(bearing_of(x, t, p) + p.bearing_sd * v[0]),),
                lambda y, x, t, p: -0.5 * (wrapped(y[0] - bearing_of(x, t, p)) / p.bearing_sd) ** 2,
                ("normal",),
            ),
            "still": Sensor(
                lambda x, t, v, p: (wrapped(_still(x, t, p) + STILL_SD * v[0]),),
                lambda y, x, t, p: -0.5 * (wrapped(y[0] - _still(x, t, p)) / STILL_SD) ** 2,
                ("normal",),
            ),
        },
    )
