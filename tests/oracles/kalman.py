"""Kalman filter with intermittent measurements: the exact filter of a linear-Gaussian model."""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from pfdist import StateSpaceModel, linear_gaussian

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LinearGaussian:
    """x(t+1) = A x + B w, y = C x + D v, z = H x, x(0) = B0 w0; w, v, w0 standard normal."""

    a: Array
    b: Array
    c: Array
    d: Array
    h: Array
    b0: Array

    def as_model(self) -> StateSpaceModel:
        """The same as a model of pfdist."""
        return linear_gaussian(
            "linear_gaussian",
            initial_noise=self.b0.tolist(),
            transition=self.a.tolist(),
            process_noise=self.b.tolist(),
            measurement=self.c.tolist(),
            measurement_noise=self.d.tolist(),
            quantity_of_interest=self.h.tolist(),
        )


def kalman_filter(
    model: LinearGaussian, y: Array, measurement_times: Collection[int]
) -> tuple[Array, Array]:
    """Mean (T+1, q) and variance (T+1, q) of z(t) given the measurements up to t."""
    mean, covariance = np.zeros(len(model.a)), model.b0 @ model.b0.T
    means, variances = [], []
    for t in range(len(y)):
        if t in measurement_times:
            innovation = model.c @ covariance @ model.c.T + model.d @ model.d.T
            gain = covariance @ model.c.T @ np.linalg.inv(innovation)
            mean = mean + gain @ (y[t] - model.c @ mean)
            covariance = covariance - gain @ model.c @ covariance
        means.append(model.h @ mean)
        variances.append(np.diag(model.h @ covariance @ model.h.T))
        mean = model.a @ mean
        covariance = model.a @ covariance @ model.a.T + model.b @ model.b.T
    return np.array(means), np.array(variances)


def riccati_cost(model: LinearGaussian, horizon: int, measurement_times: Collection[int]) -> float:
    """The exact expected MSE: the variances do not depend on what is measured."""
    nothing = np.zeros((horizon + 1, len(model.c)))
    return float(np.mean(np.sum(kalman_filter(model, nothing, measurement_times)[1], axis=1)))


def believed_errors(
    truth: LinearGaussian,
    believed: LinearGaussian,
    horizon: int,
    measurement_times: Collection[int],
) -> Array:
    """Exact expected error (T+1,) of the Kalman filter of one model on draws of another.

    The second moments of the state and of the filter's mean are propagated together. Both models
    have states of the same size.
    """
    n = len(truth.a)
    moments, covariance = np.zeros((2 * n, 2 * n)), believed.b0 @ believed.b0.T
    moments[:n, :n] = truth.b0 @ truth.b0.T
    step, errors = np.block([[truth.a, 0 * truth.a], [0 * truth.a, believed.a]]), []
    wanted = np.hstack([truth.h, -believed.h])
    for t in range(horizon + 1):
        if t in measurement_times:
            innovation = believed.c @ covariance @ believed.c.T + believed.d @ believed.d.T
            gain = covariance @ believed.c.T @ np.linalg.inv(innovation)
            update = np.eye(2 * n)
            update[n:, :n], update[n:, n:] = gain @ truth.c, np.eye(n) - gain @ believed.c
            moments = update @ moments @ update.T
            moments[n:, n:] += gain @ truth.d @ truth.d.T @ gain.T
            covariance = covariance - gain @ believed.c @ covariance
        errors.append(np.trace(wanted @ moments @ wanted.T))
        moments = step @ moments @ step.T
        moments[:n, :n] += truth.b @ truth.b.T
        covariance = believed.a @ covariance @ believed.a.T + believed.b @ believed.b.T
    return np.array(errors)


def prefix_costs(system: LinearGaussian, horizon: int) -> Callable[[tuple[int, ...], int], float]:
    """Exact cost of a prefix: the variances up to its end, over T + 1; what is shared is kept."""

    @cache
    def after(times: tuple[int, ...], t: int) -> tuple[Array, float]:
        """Covariance once what is measured at t is known, and the sum of the variances so far."""
        covariance, total = system.b0 @ system.b0.T, 0.0
        if t > 0:
            covariance, total = after(tuple(time for time in times if time < t), t - 1)
            covariance = system.a @ covariance @ system.a.T + system.b @ system.b.T
        if times[-1:] == (t,):
            seen = system.c @ covariance
            innovation = seen @ system.c.T + system.d @ system.d.T
            covariance = covariance - seen.T @ np.linalg.solve(innovation, seen)
        return covariance, total + float(np.trace(system.h @ covariance @ system.h.T))

    def cost(times: tuple[int, ...], end: int) -> float:
        return after(tuple(time for time in times if time <= end), end)[1] / (horizon + 1)

    return cost


# Position and velocity with one process noise, position measured, position and their sum wanted:
# n = 2, two initial noises, one process noise, m = 1, q = 2.
TRACKING = LinearGaussian(
    a=np.array([[1.0, 0.5], [-0.1, 0.9]]),
    b=np.array([[0.3], [0.5]]),
    c=np.array([[1.0, 0.0]]),
    d=np.array([[0.8]]),
    h=np.array([[1.0, 0.0], [1.0, 1.0]]),
    b0=np.array([[1.0, 0.0], [0.0, 2.0]]),
)

# A scalar random walk that forgets: n = m = q = 1.
SCALAR = LinearGaussian(
    a=np.array([[0.9]]),
    b=np.array([[1.0]]),
    c=np.array([[1.0]]),
    d=np.array([[0.5]]),
    h=np.array([[1.0]]),
    b0=np.array([[3.0]]),
)

# Three states, two measured with different noise, one wanted: n = 3, m = 2, q = 1.
THREE = LinearGaussian(
    a=np.array([[0.9, 0.2, 0.0], [0.0, 0.8, 0.3], [0.1, 0.0, 0.7]]),
    b=np.array([[0.5, 0.0], [0.0, 0.4], [0.3, 0.3]]),
    c=np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.0]]),
    d=np.array([[0.7, 0.0], [0.0, 1.2]]),
    h=np.array([[1.0, -1.0, 0.5]]),
    b0=np.array([[1.0, 0.0, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 1.5]]),
)
