"""Two modes that switch: exact errors of fixed times and of times chosen one after another.

x(t) is 0 or 1 and switches with a known probability, y = x + sd v, and z = x. A filter's knowledge
is the probability q of mode 1, and its error is q (1 - q). So the errors of all plans are found by
dynamic programming on a grid of q, with Gauss-Hermite quadrature over y (Astrom, "Optimal control
of Markov processes with incomplete state information", 1965).
"""

from functools import cache
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from pfdist import StateSpaceModel, where

Array = NDArray[np.float64]
Times = tuple[int, ...]

_GRID = np.linspace(0.0, 1.0, 2001)
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(60)


def model(switch: float, sd: float, start: float = 0.5) -> StateSpaceModel:
    """The system as a model; `start` is the probability of mode 1 at t = 0."""
    return StateSpaceModel(
        name="modes",
        initial=lambda w, p: (where(w[0] < p.start, 1.0, 0.0),),
        transition=lambda x, t, w, p: (where(w[0] < p.switch, 1.0 - x[0], x[0]),),
        measurement=lambda x, t, v, p: (x[0] + p.sd * v[0],),
        log_likelihood=lambda y, x, t, p: -0.5 * ((y[0] - x[0]) / p.sd) ** 2,
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("uniform",),
        process_noise=("uniform",),
        measurement_noise=("normal",),
        parameters={"switch": switch, "sd": sd, "start": start},
    )


class Modes:
    """Exact expected errors of the system, at t = 0..T, with N measurements."""

    def __init__(self, switch: float, sd: float, horizon: int, start: float = 0.5) -> None:
        self.switch, self.sd, self.horizon, self.start = switch, sd, horizon, start
        self._fixed = cache(self._of_fixed)

    def best_fixed(self, measurements: int) -> tuple[Times, float]:
        """The best fixed times, and their expected MSE."""
        costs = {
            times: self.fixed(times)
            for times in combinations(range(self.horizon + 1), measurements)
        }
        best = min(costs, key=lambda times: costs[times])
        return best, costs[best]

    def fixed(self, times: Times) -> float:
        """The expected MSE of fixed times."""
        return self._at_start(self._fixed(0, times)) / (self.horizon + 1)

    def replanned(self, measurements: int) -> float:
        """The expected MSE if, after each measurement, the best fixed times for the rest follow."""
        plan, _ = self.best_fixed(measurements)
        return self._at_start(self._until(0, plan[0], measurements)) / (self.horizon + 1)

    def _at_start(self, errors: Array) -> float:
        return float(np.interp(self.start, _GRID, errors))

    def _of_fixed(self, t: int, times: Times) -> Array:
        """The sum of errors from t on for each q at t, before t is measured; times from t on."""
        if t > self.horizon:
            return np.zeros_like(_GRID)
        if times and times[0] == t:
            return self._measured(self._variance_and(self._fixed(t + 1, times[1:])))
        return self._variance_and(self._fixed(t + 1, times))

    def _until(self, t: int, measure: int, left: int) -> Array:
        """The same if the time `measure` is next and the rest of `left` is then planned anew."""
        if t < measure:
            return self._variance_and(self._until(t + 1, measure, left))
        after = self._replan(t + 1, left - 1)
        return self._measured(self._variance_and(after, predict=False))

    def _replan(self, t: int, left: int) -> Array:
        """The sum of errors from t on for each q at t - 1, after t - 1 was measured."""
        if t > self.horizon or not left:
            return self._predicted(self._fixed(t, ()))
        plans = list(combinations(range(t, self.horizon + 1), min(left, self.horizon + 1 - t)))
        costs = np.stack([self._predicted(self._fixed(t, plan)) for plan in plans])
        first = np.array([plan[0] for plan in plans])[costs.argmin(axis=0)]
        errors = np.empty_like(_GRID)
        for time in np.unique(first):
            chosen = first == time
            errors[chosen] = self._predicted(self._until(t, int(time), left))[chosen]
        return errors

    def _variance_and(self, later: Array, *, predict: bool = True) -> Array:
        return _GRID * (1 - _GRID) + (self._predicted(later) if predict else later)

    def _predicted(self, errors: Array) -> Array:
        """Errors for each q at t - 1, from errors for each q at t."""
        return np.interp(_GRID * (1 - self.switch) + (1 - _GRID) * self.switch, _GRID, errors)

    def _measured(self, errors: Array) -> Array:
        """The mean over y of errors after a measurement, for each q before it."""
        mean = np.zeros_like(_GRID)
        for mode, share in ((0.0, 1 - _GRID), (1.0, _GRID)):
            for node, weight in zip(_NODES, _WEIGHTS, strict=True):
                y = mode + self.sd * node
                after = self._after(_GRID, y)
                mean += share * weight * np.interp(after, _GRID, errors)
        return mean / _WEIGHTS.sum()

    def _after(self, q: Array, y: Array | float) -> Array:
        """The probability of mode 1 after a measurement (Bayes)."""
        after: Array = expit(logit(q) + (y - 0.5) / self.sd**2)
        return after

    def error_of_draws(self, y: Array, times: list[Times]) -> Array:
        """The mean over t of q (1 - q) of each draw, (D,), given its y, (D, T+1), and its times."""
        q, total = np.full(len(y), self.start), np.zeros(len(y))
        measured = np.array([[t in each for t in range(self.horizon + 1)] for each in times])
        for t in range(self.horizon + 1):
            q = np.where(measured[:, t], self._after(q, y[:, t]), q)
            total += q * (1 - q)
            q = q * (1 - self.switch) + (1 - q) * self.switch
        return total / (self.horizon + 1)
