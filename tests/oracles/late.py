"""Linear systems whose sensors are late, and their expected MSE by Kalman's recursion."""

import numpy as np

from pfdist import Sensor, StateSpaceModel

LATE = {"bedside": {"price": 1}, "lab": {"price": 3, "delay": 2}}


def of_delays(early: tuple[int, ...], late: tuple[int, ...], horizon: int) -> float:
    """The expected MSE with a meter at `early`, and a laboratory whose values arrive at `late`."""
    step, noise = np.eye(3, k=-1), np.zeros((3, 3))
    step[0, 0], noise[0, 0] = 0.95, 0.36
    covariance, total = np.full((3, 3), 4.0), 0.0
    for t in range(horizon + 1):
        covariance = step @ covariance @ step.T + noise if t else covariance
        for times, state, variance in ((early, 0, 1.0), (late, 2, 0.04)):
            if t in times:
                gain = covariance[:, state] / (covariance[state, state] + variance)
                covariance = covariance - np.outer(gain, covariance[state])
        total += covariance[0, 0]
    return total / (horizon + 1)


def meter_and_laboratory() -> StateSpaceModel:
    def sensor(sd: float) -> Sensor:
        return Sensor(
            lambda x, t, v, p: (x[0] + sd * v[0],),
            lambda y, x, t, p: -0.5 * ((y[0] - x[0]) / sd) ** 2,
            ("normal",),
        )

    return StateSpaceModel(
        name="meter and laboratory",
        initial=lambda w, p: (2.0 * w[0],),
        transition=lambda x, t, w, p: (0.95 * x[0] + 0.6 * w[0],),
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("normal",),
        process_noise=("normal",),
        linear_gaussian=True,
        sensors={"bedside": sensor(1.0), "lab": sensor(0.2)},
    )


def late_walk() -> StateSpaceModel:
    """A walk whose sensor is twice as good at some instants."""
    return StateSpaceModel(
        name="late walk",
        initial=lambda w, p: (2.0 * w[0],),
        transition=lambda x, t, w, p: (0.95 * x[0] + 0.6 * w[0],),
        measurement=lambda x, t, v, p: ((1.0 + (3 * t) % 5) * x[0] + v[0],),
        log_likelihood=lambda y, x, t, p: -0.5 * (y[0] - (1.0 + (3 * t) % 5) * x[0]) ** 2,
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("normal",),
        process_noise=("normal",),
        measurement_noise=("normal",),
        linear_gaussian=True,
    )


def of_late_walk(made: tuple[int, ...], delay: int, horizon: int) -> float:
    """The expected MSE by conditioning on the measurements that have arrived."""
    variance = np.full(horizon + 1, 4.0)
    for t in range(horizon):
        variance[t + 1] = 0.95**2 * variance[t] + 0.36
    s, t = np.meshgrid(np.arange(horizon + 1), np.arange(horizon + 1))
    joint, total = variance[np.minimum(s, t)] * 0.95 ** abs(s - t), 0.0
    for now in range(horizon + 1):
        known = [each for each in made if each + delay <= now]
        gains = np.array([1.0 + (3 * each) % 5 for each in known])
        seen = np.outer(gains, gains) * joint[np.ix_(known, known)] + np.eye(len(known))
        both = gains * joint[now, known]
        total += joint[now, now] - both @ np.linalg.solve(seen, both)
    return float(total) / (horizon + 1)
