"""Models of sharp sensors, whose guided filters are compared with exact filters."""

import numpy as np

from pfdist import StateSpaceModel, linear_gaussian
from pfdist.densities import normal_logpdf

SHARP = 0.001


def sharp_walk(dimensions: int, sensor: float = SHARP) -> StateSpaceModel:
    """A random walk in some dimensions, each seen by a sensor of 0.001 of the prior's deviation."""

    def times(factor):
        return (factor * np.eye(dimensions)).tolist()

    return linear_gaussian(
        f"walk in {dimensions}",
        initial_noise=times(1.0),
        transition=times(1.0),
        process_noise=times(0.5),
        measurement=times(1.0),
        measurement_noise=times(sensor),
        quantity_of_interest=times(1.0),
    )


# --- echoes ---------------------------------------------------------------------------------------

KEPT, PUSH, SENSOR, CLUTTER, WIDE = 0.5, np.sqrt(0.75), 0.01, 0.01, 3.0


def _move(x, t, w, p):
    return (
        KEPT * x[0] + PUSH * w[0],
        KEPT * x[1] + PUSH * w[1],
        KEPT * x[2] + PUSH * w[2],
        KEPT * x[3] + PUSH * w[3],
    )


def _echo(x, t, v, p):
    is_clutter = v[4] < CLUTTER
    return (
        np.where(is_clutter, WIDE * v[0], x[0] + SENSOR * v[0]),
        np.where(is_clutter, WIDE * v[1], x[1] + SENSOR * v[1]),
        np.where(is_clutter, WIDE * v[2], x[2] + SENSOR * v[2]),
        np.where(is_clutter, WIDE * v[3], x[3] + SENSOR * v[3]),
    )


def _normal_4(y, mean, sd):
    return (
        normal_logpdf(y[0], mean[0], sd)
        + normal_logpdf(y[1], mean[1], sd)
        + normal_logpdf(y[2], mean[2], sd)
        + normal_logpdf(y[3], mean[3], sd)
    )


def _either(a, b):
    highest = np.maximum(a, b)
    return highest + np.log(np.exp(a - highest) + np.exp(b - highest))


def _log_clutter(y):
    return np.log(CLUTTER) + _normal_4(y, (0.0, 0.0, 0.0, 0.0), WIDE)


def _log_likelihood(y, x, t, p):
    return _either(np.log(1 - CLUTTER) + _normal_4(y, x, SENSOR), _log_clutter(y))


def _initial(w, p):
    return (w[0], w[1], w[2], w[3])


echoes = StateSpaceModel(
    name="echoes",
    initial=_initial,
    transition=_move,
    measurement=_echo,
    log_likelihood=_log_likelihood,
    quantity_of_interest=lambda x, t, p: (x[0], x[1], x[2], x[3]),
    initial_noise=("normal",) * 4,
    process_noise=("normal",) * 4,
    measurement_noise=("normal",) * 4 + ("uniform",),
    normalised=True,
)
"""Four coordinates that return to 0, seen by sharp sensors; one echo in a hundred is clutter."""
