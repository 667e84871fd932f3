"""The weighting of scenarios whose lower bound is the largest.

The error of a set in its worst scenario is at least any weighted mean of its errors. So the least
mean of all sets is a lower bound of the worst scenario, for every weighting. The best weights solve
a concave problem by cutting planes: each round finds the best set for the weights at hand, and then
the weights for which the best of all sets so far has the largest error.

The least largest error can lie above the largest bound: sets cannot be mixed (a duality gap).

Source: Kelley, "The cutting-plane method for solving convex programs", SIAM Journal 8, 1960.
"""

import numpy as np
from numpy.typing import NDArray

from pfdist.bounds.programme import Programme
from pfdist.bounds.relaxation import Relaxation

_ROUNDS = 100  # at most
_DIGITS = 6  # of a share; those of the solver may end otherwise elsewhere, and every share is valid
_SETTLED = 1e-4  # relative distance of the bound from the largest that the planes allow

Array = NDArray[np.float64]


def best_shares(relaxation: Relaxation, errors: Array, spent: int) -> tuple[float, ...]:
    """The shares of C scenarios for which the least relaxed expected MSE of a sum is largest.

    `errors` (C, E) are the expected errors of all windows in each scenario.
    """
    from scipy.optimize import linprog  # noqa: PLC0415  it loads only where the worst case decides

    scenarios = len(errors)
    alone = [Programme(relaxation, row, spent) for row in errors]
    shares, planes = np.full(scenarios, 1.0 / scenarios), list[list[float]]()
    best, largest = shares, -np.inf
    # Unknowns: the shares, and the value of the lowest plane, which is maximised.
    objective = np.array([0.0] * scenarios + [-1.0])
    total, bounds = [[1.0] * scenarios + [0.0]], [(0.0, 1.0)] * scenarios + [(None, None)]
    for _ in range(_ROUNDS):
        mean = np.sum(shares[:, None] * errors, axis=0)  # BLAS would round by the processor
        path = Programme(relaxation, mean, spent).path(spent)
        costs = [programme.of_set(path) for programme in alone]
        value = float(np.sum(shares * costs))
        if value > largest:
            best, largest = shares, value
        planes.append([*(-cost for cost in costs), 1.0])
        found = linprog(objective, planes, np.zeros(len(planes)), total, [1.0], bounds)
        if found.x is None or found.x[-1] <= largest * (1 + _SETTLED):
            break
        shares = np.round(np.clip(found.x[:-1], 0.0, None), _DIGITS)
        shares = shares / shares.sum()
    return tuple(best.tolist())
