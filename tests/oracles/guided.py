"""Models with proposals, whose filters are compared with exact and with bootstrap filters."""

from dataclasses import replace

import numpy as np

from pfdist import StateSpaceModel, linear_gaussian, load_model
from pfdist.densities import normal_logpdf

SHARP = 0.001


def sharp_walk(dimensions: int, guided: bool = True, sensor: float = SHARP) -> StateSpaceModel:
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
        guided=guided,
    )


# --- the growth model -----------------------------------------------------------------------------


def _approximated(x, y, t, p):
    """Mean, deviation and log weight of w near both roots of y = x^2 / 20, and the deviation."""
    sd = p.measurement_sd * (np.sin(0.25 * (t + 1)) + 2)
    predicted = x[0] / 2 + 25 * x[0] / (1 + x[0] ** 2) + 8 * np.cos(1.2 * t)
    root = np.sqrt(np.maximum(20 * y[0], 0.0))
    variance = 100 * sd**2 / (root**2 + 5 * sd)  # of x(t+1) near a root, by the measurement
    total, process = variance + p.process_sd**2, p.process_sd**2
    deviation = np.sqrt(variance / total)
    above = p.process_sd * (root - predicted) / total
    below = p.process_sd * (-root - predicted) / total
    share = 1 / (1 + np.exp(np.clip(-2 * root * predicted / total, -700.0, 700.0)))
    return above, below, deviation, share, process


def _proposal(x, y, t, u, p):
    above, below, deviation, share, _ = _approximated(x, y, t, p)
    return (np.where(u[1] < share, above, below) + deviation * u[0],)


def _proposal_log_density(w, x, y, t, p):
    above, below, deviation, share, _ = _approximated(x, y, t, p)
    a, b = -0.5 * ((w[0] - above) / deviation) ** 2, -0.5 * ((w[0] - below) / deviation) ** 2
    highest = np.maximum(a, b)
    mixed = share * np.exp(a - highest) + (1 - share) * np.exp(b - highest)
    return highest + np.log(mixed) - np.log(deviation) - 0.5 * np.log(2 * np.pi)


growth = replace(
    load_model("ungm"),
    name="guided growth",
    proposal=_proposal,
    proposal_log_density=_proposal_log_density,
    proposal_noise=("normal", "uniform"),
)
"""UNGM with a mixture of two normal proposals: y = x^2 / 20 has two roots."""


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


VARIANCE = PUSH**2 + SENSOR**2  # of y(t+1) given x(t), without clutter


def _log_target(x, y):
    """The log of the density of y(t+1) given x(t) together with the probability of no clutter."""
    mean = (KEPT * x[0], KEPT * x[1], KEPT * x[2], KEPT * x[3])
    return np.log(1 - CLUTTER) + _normal_4(y, mean, np.sqrt(VARIANCE))


def _guide(x, y, t, u, p):
    no_clutter = _log_target(x, y)
    is_target = np.log(u[4]) < no_clutter - _either(no_clutter, _log_clutter(y))
    gain, sd = PUSH / VARIANCE, SENSOR / np.sqrt(VARIANCE)
    return (
        np.where(is_target, gain * (y[0] - KEPT * x[0]) + sd * u[0], u[0]),
        np.where(is_target, gain * (y[1] - KEPT * x[1]) + sd * u[1], u[1]),
        np.where(is_target, gain * (y[2] - KEPT * x[2]) + sd * u[2], u[2]),
        np.where(is_target, gain * (y[3] - KEPT * x[3]) + sd * u[3], u[3]),
    )


def _guide_log_density(w, x, y, t, p):
    no_clutter, clutter = _log_target(x, y), _log_clutter(y)
    gain, sd = PUSH / VARIANCE, SENSOR / np.sqrt(VARIANCE)
    mean = (
        gain * (y[0] - KEPT * x[0]),
        gain * (y[1] - KEPT * x[1]),
        gain * (y[2] - KEPT * x[2]),
        gain * (y[3] - KEPT * x[3]),
    )
    drawn = _either(
        no_clutter + _normal_4(w, mean, sd), clutter + _normal_4(w, (0.0, 0.0, 0.0, 0.0), 1.0)
    )
    return drawn - _either(no_clutter, clutter)


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
    proposal=_guide,
    proposal_log_density=_guide_log_density,
    proposal_noise=("normal",) * 4 + ("uniform",),
)
"""Four coordinates that return to 0, seen by sharp sensors; one echo in a hundred is clutter."""


def bootstrap(model: StateSpaceModel) -> StateSpaceModel:
    """The model without its proposal."""
    return replace(model, proposal=None, proposal_log_density=None, proposal_noise=())
