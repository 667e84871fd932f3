"""A random walk that is restless now early and now late, and its exact errors by hand.

x(t+1) = x(t) + q(t) w(t), where q(t) is `early` before t = 6 and `late` from then on; y = x + v,
and x(0) = 2 w0.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pfdist import StateSpaceModel

HORIZON, CHANGE = 12, 6
PRIOR = 4.0  # variance of x(0)

WALK = StateSpaceModel(
    name="restless walk",
    initial=lambda w, p: (2.0 * w[0],),
    transition=lambda x, t, w, p: (x[0] + np.where(t < 6, p.early, p.late) * w[0],),
    measurement=lambda x, t, v, p: (x[0] + v[0],),
    log_likelihood=lambda y, x, t, p: -0.5 * (y[0] - x[0]) ** 2,
    quantity_of_interest=lambda x, t, p: (x[0],),
    initial_noise=("normal",),
    process_noise=("normal",),
    measurement_noise=("normal",),
    parameters={"early": 0.8, "late": 0.8},
    linear_gaussian=True,
)
SCENARIOS = [{"early": 1.4, "late": 0.3}, {"early": 0.8, "late": 0.8}, {"early": 0.3, "late": 1.5}]
WEIGHTS = [1.0, 1.0, 2.0]
NOMINAL = {"early": 0.8, "late": 0.8}


def expected_mse(
    times: Sequence[int], truth: dict[str, float], believed: dict[str, float]
) -> float:
    """The expected MSE of the Kalman filter of one walk for draws of another.

    The gain follows from the variance that the filter believes. The error then is (1 - gain) of
    the error before, plus gain times the noise of the measurement.
    """
    error = variance = PRIOR
    total = 0.0
    for t in range(HORIZON + 1):
        if t in times:
            gain = variance / (variance + 1.0)
            variance = (1.0 - gain) * variance
            error = (1.0 - gain) ** 2 * error + gain**2
        total += error
        name = "early" if t < CHANGE else "late"
        error, variance = error + truth[name] ** 2, variance + believed[name] ** 2
    return total / (HORIZON + 1)


def costs(sets: Sequence[Sequence[int]], *, told: bool) -> NDArray[np.float64]:
    """The expected MSE of each set in each scenario, (S, C)."""
    return np.array(
        [
            [expected_mse(times, each, each if told else NOMINAL) for each in SCENARIOS]
            for times in sets
        ]
    )


def combined(of_scenarios: NDArray[np.float64], criterion: str) -> NDArray[np.float64]:
    """The cost of each set, (S,), by the criterion of a job."""
    if criterion == "worst":
        return of_scenarios.max(axis=1)
    return np.average(of_scenarios, axis=1, weights=WEIGHTS)
