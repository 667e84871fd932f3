"""An hourly turbidity that changes more by day than by night, and its exact errors by hand."""

import numpy as np
import pandas as pd

from pfdist import StateSpaceModel
from pfdist.filters.simulation import simulate

HORIZON = 47
JOB = """
seed = 7
[model]
name = "lake.py:model"
[problem]
horizon = 47
measurement_budget = 4
[filter]
engine = "kalman"
[comparison]
reference = "regular"
draws = 60
[execution]
pool = "serial"
"""


def lake(**parameters: float) -> StateSpaceModel:
    """An autoregression whose noise depends on the hour."""
    return StateSpaceModel(
        name="lake",
        initial=lambda w, p: (p.sd / np.sqrt(1 - p.a**2) * w[0],),
        transition=lambda x, t, w, p: (
            p.a * x[0] + p.sd * (1 + 0.8 * np.sin(2 * np.pi * t / 48)) * w[0],
        ),
        measurement=lambda x, t, v, p: (x[0] + p.noise * v[0],),
        log_likelihood=lambda y, x, t, p: (
            -0.5 * ((y[0] - x[0]) / p.noise) ** 2 - np.log(p.noise) - 0.5 * np.log(2 * np.pi)
        ),
        quantity_of_interest=lambda x, t, p: (x[0],),
        initial_noise=("normal",),
        process_noise=("normal",),
        measurement_noise=("normal",),
        parameters={"a": 0.95, "sd": 0.3, "noise": 0.1} | parameters,
        linear_gaussian=True,
        normalised=True,
        y_names=("turbidity [NTU]",),
        z_names=("turbidity [NTU]",),
    )


model = lake()


def days(number: int, seed: int = 5, horizon: int = HORIZON) -> pd.DataFrame:
    """Hourly measurements of simulated days."""
    y = simulate(model, horizon, range(number), seed).y[:, :, 0]
    day, t = np.divmod(np.arange(y.size), horizon + 1)
    return pd.DataFrame({"day": [f"d{each}" for each in day], "t": t, "y0": y.ravel()})


def estimates(y, times, a: float = 0.95, sd: float = 0.3, noise: float = 0.1):
    """Kalman's mean and variance of x at each instant, both (T+1,).

    The measurements y are (T+1,), or (T+1, R) with several rows of a time.
    """
    mean, variance, means, variances = 0.0, sd**2 / (1 - a**2), [], []
    for t in range(len(y)):
        for value in np.atleast_1d(y[t]):
            if t in times and not np.isnan(value):
                gain = variance / (variance + noise**2)
                mean, variance = mean + gain * (value - mean), (1 - gain) * variance
        means.append(mean)
        variances.append(variance)
        step = sd * (1 + 0.8 * np.sin(2 * np.pi * t / 48))
        mean, variance = a * mean, a**2 * variance + step**2
    return np.array(means), np.array(variances)
