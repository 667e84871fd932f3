"""A random walk that a cheap and a sharp sensor watch: its variances do not depend on y.

So a rule is a fixed set, which follows from the exact variances. At an instant one sensor may
measure.
"""

from itertools import product

import numpy as np

from pfdist import Sensor, StateSpaceModel

HORIZON, BUDGET = 12, 8
SENSORS = {"cheap": (1.0, 1.2), "sharp": (2.0, 0.2)}  # price and standard deviation
INITIAL_VARIANCE = 4.0


def _sensor(sd: float) -> Sensor:
    return Sensor(
        measurement=lambda x, t, v, p: (x[0] + sd * v[0],),
        log_likelihood=lambda y, x, t, p: -0.5 * ((y[0] - x[0]) / sd) ** 2,
        measurement_noise=("normal",),
    )


WALK = StateSpaceModel(
    name="watched",
    initial=lambda w, p: (np.sqrt(INITIAL_VARIANCE) * w[0],),
    transition=lambda x, t, w, p: (x[0] + w[0],),
    quantity_of_interest=lambda x, t, p: x,
    initial_noise=("normal",),
    process_noise=("normal",),
    sensors={name: _sensor(sd) for name, (_, sd) in SENSORS.items()},
    linear_gaussian=True,
)


def after(variance: float, sensor: int) -> float:
    _, sd = [*SENSORS.values()][sensor]
    return 1.0 / (1.0 / variance + 1.0 / sd**2)


def of_thresholds(thresholds: tuple[float, ...]) -> tuple[float, float, tuple[int, ...], float]:
    """Expected MSE, price and points of a rule, and how near a deviation comes to a threshold."""
    variance, error, price, points, near = INITIAL_VARIANCE, 0.0, 0.0, (), np.inf
    for t in range(HORIZON + 1):
        deviation = np.sqrt(variance)
        near = min(near, *(abs(deviation / threshold - 1.0) for threshold in thresholds))
        exceeded = [(c, sensor) for sensor, c in enumerate(thresholds) if deviation > c]
        if exceeded:
            _, sensor = max(exceeded)
            variance, points = after(variance, sensor), (*points, 2 * t + sensor)
            price += [*SENSORS.values()][sensor][0]
        error, variance = error + variance, variance + 1.0
    return error / (HORIZON + 1), price, points, near


def best_thresholds(budget: float, only: int | None = None) -> tuple[float, tuple[float, ...]]:
    """The least expected MSE of pairs of thresholds that keep the budget, or of a single sensor."""
    grid = (*np.geomspace(0.2, 8.0, 120).tolist(), np.inf)
    grids = [grid if only in (None, sensor) else (np.inf,) for sensor in range(2)]
    found = ((*of_thresholds(pair)[:2], pair) for pair in product(*grids))
    return min((error, pair) for error, price, pair in found if price <= budget)


def best_set(budget: float) -> float:
    """The least expected MSE of all sets that the budget pays for."""

    def least(t: int, variance: float, left: float) -> float:
        if t > HORIZON:
            return 0.0
        error = variance + least(t + 1, variance + 1.0, left)
        for sensor, (price, _) in enumerate(SENSORS.values()):
            if price <= left:
                own = after(variance, sensor)
                error = min(error, own + least(t + 1, own + 1.0, left - price))
        return error

    return least(0, INITIAL_VARIANCE, budget) / (HORIZON + 1)
