"""A satellite in a plane: a model whose formulas are methods, and the same written out."""

from typing import Any

import numpy as np

from pfdist import StateSpaceModel


class Satellite:
    """Motion around a body, by steps of Runge and Kutta."""

    def __init__(self, pull: float = 1.0, dt: float = 0.3, steps: int = 1) -> None:
        self.pull, self.h, self.steps = pull, dt / steps, steps

    def rate(self, s: Any) -> Any:
        """Derivative of the state by time."""
        r, v = s[:2], s[2:]
        return np.concatenate([v, -self.pull * r / np.linalg.norm(r) ** 3])

    def transition(self, x: Any, t: Any, w: Any, p: Any) -> Any:
        """The state after a step, as an array."""
        s, h = np.array(x), self.h
        for _ in range(self.steps):
            k1 = self.rate(s)
            k2 = self.rate(s + h / 2 * k1)
            k3 = self.rate(s + h / 2 * k2)
            k4 = self.rate(s + h * k3)
            s = s + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return s + p.sd * np.array([0, 0, w[0], w[1]])

    def transition_by_hand(self, x: Any, t: Any, w: Any, p: Any) -> Any:
        """The same, a component at a time."""

        def rate(s: Any) -> Any:
            square = s[0] ** 2 + s[1] ** 2
            pull = -self.pull / (square * np.sqrt(square))
            return s[2], s[3], pull * s[0], pull * s[1]

        def moved(s: Any, h: Any, k: Any) -> Any:
            return tuple(a + h * b for a, b in zip(s, k, strict=True))

        s, h = x, self.h
        for _ in range(self.steps):
            k1 = rate(s)
            k2 = rate(moved(s, h / 2, k1))
            k3 = rate(moved(s, h / 2, k2))
            k4 = rate(moved(s, h, k3))
            for k, share in ((k1, 1), (k2, 2), (k3, 2), (k4, 1)):
                s = moved(s, h / 6 * share, k)
        return s[0], s[1], s[2] + p.sd * w[0], s[3] + p.sd * w[1]

    def measurement(self, x: Any, t: Any, v: Any, p: Any) -> Any:
        """The measured distance."""
        return (np.linalg.norm(np.array(x[:2])) + 0.05 * v[0],)

    def log_likelihood(self, y: Any, x: Any, t: Any, p: Any) -> Any:
        """Log-density of a distance."""
        return -0.5 * ((y[0] - np.linalg.norm(np.array(x[:2]))) / 0.05) ** 2


def model_of(satellite: Satellite) -> StateSpaceModel:
    """The model of a satellite near a circular orbit."""
    return StateSpaceModel(
        name="satellite",
        initial=lambda w, p: (1 + 0.1 * w[0], 0.1 * w[1], 0.0, 1 + 0.02 * w[2]),
        transition=satellite.transition,
        measurement=satellite.measurement,
        log_likelihood=satellite.log_likelihood,
        quantity_of_interest=lambda x, t, p: x[:2],
        initial_noise=("normal",) * 3,
        process_noise=("normal",) * 2,
        measurement_noise=("normal",),
        parameters={"sd": 0.01},
    )
