"""Systems of unknown constants, with or without process noise; for filters that move particles."""

from typing import Any

import numpy as np

from pfdist import StateSpaceModel, densities, linear_gaussian
from pfdist.filters.proposals import MOVING
from pfdist.filters.work import Estimation

HOURS = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 12.0, 16.0, 20.0, 24.0)


def moving(particles: int, **settings: Any) -> Estimation:
    """A filter that moves so many particles."""
    return Estimation(particles, proposal=MOVING.name, **{"resampling": "systematic"} | settings)


def level_and_slope(process: float, sensor: float) -> StateSpaceModel:
    """A level that grows by an unknown slope, with process noise, and is measured."""
    return linear_gaussian(
        "level and slope",
        initial_noise=[[1.0, 0.0], [0.0, 0.3]],
        transition=[[1.0, 1.0], [0.0, 1.0]],
        process_noise=[[process], [0.0]],
        measurement=[[1.0, 0.0]],
        measurement_noise=[[sensor]],
        quantity_of_interest=[[1.0, 0.0], [0.0, 1.0]],
    )


def constants(number: int, sensor: float) -> StateSpaceModel:
    """Unknown constants, and at each instant a measurement of another sum of them."""
    factors = np.random.default_rng(3).normal(size=(21, number))
    if number == 1:
        factors[:] = 1.0

    def predicted(x: Any, t: Any, p: Any) -> Any:
        return sum(getattr(p, f"factor_{c}")[t] * x[c] for c in range(number))

    return StateSpaceModel(
        name="constants",
        initial=lambda w, p: tuple(w),
        transition=lambda x, t, w, p: x,
        measurement=lambda x, t, v, p: (predicted(x, t, p) + sensor * v[0],),
        log_likelihood=lambda y, x, t, p: densities.normal_logpdf(y[0], predicted(x, t, p), sensor),
        quantity_of_interest=lambda x, t, p: tuple(x),
        initial_noise=("normal",) * number,
        process_noise=(),
        measurement_noise=("normal",),
        parameters={f"factor_{c}": tuple(factors[:, c].tolist()) for c in range(number)},
        normalised=True,
    )


def drug(error: float) -> StateSpaceModel:
    """The concentration of a drug that was swallowed, by three unknown constants.

    A reading is off by a share of the concentration, and .01.
    """

    def concentration(x: Any, t: Any, p: Any) -> Any:
        absorption, clearance, volume = (np.exp(value) for value in x)
        rate = clearance / volume
        curve = np.exp(-rate * p.time[t]) - np.exp(-absorption * p.time[t])
        return 100.0 / volume * absorption / (absorption - rate) * curve

    def deviation(x: Any, t: Any, p: Any) -> Any:
        return error * concentration(x, t, p) + 0.01

    return StateSpaceModel(
        name="drug",
        initial=lambda w, p: tuple(
            np.log(typical) + 0.3 * noise
            for typical, noise in zip((1.2, 3.0, 30.0), w, strict=True)
        ),
        transition=lambda x, t, w, p: x,
        measurement=lambda x, t, v, p: (concentration(x, t, p) + deviation(x, t, p) * v[0],),
        log_likelihood=lambda y, x, t, p: densities.normal_logpdf(
            y[0], concentration(x, t, p), deviation(x, t, p)
        ),
        quantity_of_interest=lambda x, t, p: (concentration(x, t, p),),
        initial_noise=("normal",) * 3,
        process_noise=(),
        measurement_noise=("normal",),
        normalised=True,
    )
