"""Linear-Gaussian systems with three sensors, and the best set of all, by a Kalman filter."""

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from pfdist import Sensor, StateSpaceModel

Array = NDArray[np.float64]
HORIZON = 12
NAMES = ("near", "far", "both")


@dataclass(frozen=True)
class ThreeSensors:
    """x(t+1) = A x + b w with two components, y = c x + sd v of each sensor, z = the first of x."""

    turn: float
    decay: float
    process_sd: float
    rows: tuple[tuple[float, float], ...]
    sds: tuple[float, ...]

    @property
    def a(self) -> Array:
        cosine, sine = np.cos(self.turn), np.sin(self.turn)
        return self.decay * np.array([[cosine, sine], [-sine, cosine]])

    def as_model(self) -> StateSpaceModel:
        """The same as a model of pfdist."""
        (a, b), (c, d) = self.a.tolist()
        process_sd = self.process_sd
        return StateSpaceModel(
            name="three_sensors",
            initial=lambda w, p: (2.0 * w[0], 1.0 * w[1]),
            transition=lambda x, t, w, p: (
                a * x[0] + b * x[1] + process_sd * w[0],
                c * x[0] + d * x[1] + 0.5 * process_sd * w[1],
            ),
            quantity_of_interest=lambda x, t, p: (x[0],),
            initial_noise=("normal", "normal"),
            process_noise=("normal", "normal"),
            sensors=dict(zip(NAMES, map(_sensor, self.rows, self.sds), strict=True)),
            linear_gaussian=True,
        )

    def expected_mse(self, times: tuple[int, ...]) -> float:
        """The expected MSE of possible measurements t * 3 + sensor."""
        variance, errors = np.diag([4.0, 1.0]), 0.0
        for t in range(HORIZON + 1):
            for sensor in range(3):
                if t * 3 + sensor in times:
                    variance = self._measured(variance[None], sensor)[0]
            errors += variance[0, 0]
            variance = self._propagated(variance[None])[0]
        return float(errors / (HORIZON + 1))

    def means(self, measured: dict[int, float]) -> list[float]:
        """The mean of z(t) given measurements y by their number, at each instant."""
        variance, mean, means = np.diag([4.0, 1.0]), np.zeros(2), []
        for t in range(HORIZON + 1):
            for sensor in range(3):
                if (y := measured.get(3 * t + sensor)) is not None:
                    row = np.array(self.rows[sensor])
                    gain = variance @ row / (row @ variance @ row + self.sds[sensor] ** 2)
                    mean = mean + gain * (y - row @ mean)
                    variance = self._measured(variance[None], sensor)[0]
            means.append(float(mean[0]))
            mean, variance = self.a @ mean, self._propagated(variance[None])[0]
        return means

    def best(self, measurements: int) -> tuple[float, tuple[int, ...]]:
        """The least expected MSE of all sets of so many measurements, and its set."""
        # All beginnings of sets are filtered side by side: variance, sum of errors, and the number
        # of measurements so far, with the set as bits of an integer.
        variances, errors = np.diag([4.0, 1.0])[None], np.zeros(1)
        counts, sets = np.zeros(1, np.int64), np.zeros(1, np.int64)
        for t in range(HORIZON + 1):
            parts = []
            for chosen in product((0, 1), repeat=3):
                more = counts + sum(chosen)
                fits = (more <= measurements) & (more + 3 * (HORIZON - t) >= measurements)
                after = variances[fits]
                for sensor in np.flatnonzero(chosen):
                    after = self._measured(after, int(sensor))
                bits = sum(bit << (3 * t + sensor) for sensor, bit in enumerate(chosen))
                parts.append((after, errors[fits] + after[:, 0, 0], more[fits], sets[fits] | bits))
            variances, errors, counts, sets = (
                np.concatenate(each) for each in zip(*parts, strict=True)
            )
            variances = self._propagated(variances)
        best = int(np.argmin(errors))
        times = tuple(m for m in range(3 * (HORIZON + 1)) if int(sets[best]) >> m & 1)
        return float(errors[best] / (HORIZON + 1)), times

    def _measured(self, variance: Array, sensor: int) -> Array:
        row = np.array(self.rows[sensor])
        seen = variance @ row
        total = seen @ row + self.sds[sensor] ** 2
        return variance - seen[:, :, None] * seen[:, None, :] / total[:, None, None]

    def _propagated(self, variance: Array) -> Array:
        noise = np.diag([self.process_sd**2, 0.25 * self.process_sd**2])
        return self.a @ variance @ self.a.T + noise


def _sensor(row: tuple[float, float], sd: float) -> Sensor:
    first, second = row
    return Sensor(
        measurement=lambda x, t, v, p: (first * x[0] + second * x[1] + sd * v[0],),
        log_likelihood=lambda y, x, t, p: -0.5 * ((y[0] - first * x[0] - second * x[1]) / sd) ** 2,
        measurement_noise=("normal",),
    )


SYSTEMS = (
    ThreeSensors(0.9, 1.0, 0.4, ((1.0, 0.0), (0.0, 1.0), (0.7, -0.7)), (0.6, 0.1, 0.2)),
    ThreeSensors(1.1, 1.0, 0.3, ((1.0, 0.0), (0.0, 1.0), (1.0, 1.0)), (1.0, 0.5, 1.2)),
    ThreeSensors(0.6, 0.9, 0.6, ((1.0, 0.2), (0.3, 1.0), (0.5, -0.5)), (1.5, 0.2, 0.4)),
    ThreeSensors(0.7, 1.02, 0.2, ((1.0, 0.0), (0.0, 1.0), (0.7, 0.7)), (0.3, 0.3, 0.2)),
)
