"""Systems of unknown constants, with or without process noise; for filters that move particles."""

from typing import Any

import numpy as np

from pfdist import StateSpaceModel, densities, linear_gaussian, ode
from pfdist.filters.work import Estimation

HOURS = (0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 12.0, 16.0, 20.0, 24.0)


def moving(particles: int, **settings: Any) -> Estimation:
    """A filter that moves so many particles."""
    return Estimation(particles, proposal="moving", **{"resampling": "systematic"} | settings)


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


GLUCOSE_MINUTES = (0.0, 2.0, 4.0, 8.0, 14.0, 22.0, 30.0, 50.0, 80.0, 120.0, 180.0)


def minimal_model() -> StateSpaceModel:
    """Glucose and insulin after an injection of glucose (Bergman 1979): three unknown rates."""

    def slopes(x: Any, t: Any, p: Any) -> Any:
        glucose, remote, insulin = x[:3]
        sensitivity, effectiveness, clearance = (np.exp(value) for value in x[3:])
        secretion = 0.004 * np.maximum(glucose - 90.0, 0.0) * t
        return (
            -(effectiveness + remote) * glucose + effectiveness * 90.0,
            -0.03 * (remote - sensitivity * (insulin - 8.0)),
            -clearance * (insulin - 8.0) + secretion,
            0.0,
            0.0,
            0.0,
        )

    return StateSpaceModel(
        name="minimal model",
        initial=lambda w, p: (
            90.0 + 280.0 * np.exp(0.1 * w[0]), 0.0, 8.0 + 350.0 * np.exp(0.3 * w[1]),
            np.log(5e-4) + 0.5 * w[2], np.log(0.025) + 0.3 * w[3], np.log(0.25) + 0.3 * w[4],
        ),
        transition=ode(slopes, largest_step=2.0),
        measurement=lambda x, t, v, p: (x[0] * np.exp(0.02 * v[0]), x[2] * np.exp(0.1 * v[1])),
        log_likelihood=lambda y, x, t, p: (
            densities.lognormal_logpdf(y[0], np.log(x[0]), 0.02)
            + densities.lognormal_logpdf(y[1], np.log(x[2]), 0.1)
        ),
        quantity_of_interest=lambda x, t, p: (x[3],),
        initial_noise=("normal",) * 5,
        process_noise=(),
        measurement_noise=("normal", "normal"),
        normalised=True,
    )  # fmt: skip


def epidemic() -> StateSpaceModel:
    """An epidemic with unknown rates of infection and of recovery, and Poisson counts."""

    def expected(x: Any) -> Any:
        return 2000.0 * x[1] + 1.0

    def slopes(x: Any, t: Any, p: Any) -> Any:
        infected, recovered = np.exp(x[2]) * x[0] * x[1], np.exp(x[3]) * x[1]
        return -infected, infected - recovered, 0.0, 0.0

    return StateSpaceModel(
        name="epidemic of two rates",
        initial=lambda w, p: (
            0.99, 0.01, np.log(0.4) + 0.2 * w[0], np.log(0.15) + 0.2 * w[1],
        ),
        transition=ode(slopes),
        measurement=lambda x, t, v, p: (densities.poisson_draw(v[0], expected(x)),),
        log_likelihood=lambda y, x, t, p: densities.poisson_logpmf(y[0], expected(x)),
        quantity_of_interest=lambda x, t, p: (x[2],),
        initial_noise=("normal", "normal"),
        process_noise=(),
        measurement_noise=("uniform",),
        normalised=True,
    )  # fmt: skip


def response(name: str, curve: Any, deviation: Any, constants: int) -> StateSpaceModel:
    """A curve of unknown constants, each a standard normal number in x; readings are off."""

    def predicted(x: Any, t: Any, p: Any) -> Any:
        return curve(x, p.time[t])

    return StateSpaceModel(
        name=name,
        initial=lambda w, p: tuple(w),
        transition=lambda x, t, w, p: x,
        measurement=lambda x, t, v, p: (predicted(x, t, p) + deviation(predicted(x, t, p)) * v[0],),
        log_likelihood=lambda y, x, t, p: densities.normal_logpdf(
            y[0], predicted(x, t, p), deviation(predicted(x, t, p))
        ),
        quantity_of_interest=lambda x, t, p: (predicted(x, t, p),),
        initial_noise=("normal",) * constants,
        process_noise=(),
        measurement_noise=("normal",),
        normalised=True,
    )


def emax() -> StateSpaceModel:
    """A response that rises to a plateau (Hill): four unknown constants."""

    def curve(x: Any, t: Any) -> Any:
        begin, most, half, power = (
            typical * np.exp(0.3 * value)
            for typical, value in zip((10.0, 60.0, 8.0, 2.5), x, strict=True)
        )
        risen = (t + 1e-9) ** power
        return begin + most * risen / (half**power + risen)

    return response("emax", curve, lambda c: 1.0 + 0.0 * c, 4)


def logistic() -> StateSpaceModel:
    """Logistic growth by an unknown rate, to an unknown size, from an unknown one."""

    def curve(x: Any, t: Any) -> Any:
        rate, size, first = (
            0.5 * np.exp(0.25 * x[0]), 100.0 * np.exp(0.25 * x[1]), 3.0 * np.exp(0.4 * x[2]),
        )  # fmt: skip
        return size / (1.0 + (size / first - 1.0) * np.exp(-rate * t))

    return response("logistic", curve, lambda c: 0.05 * c + 0.5, 3)


MINUTES = (2.0, 4.0, 6.0, 10.0, 15.0, 20.0, 22.0, 25.0, 30.0, 40.0, 60.0, 90.0, 120.0, 180.0)


def remifentanil() -> StateSpaceModel:
    """The log concentration of an opioid, infused for 20 minutes: six unknown constants.

    The compartments, their fitted parameters and the widths are those of docs/real-data.md.
    """
    typical, widths = (5.0, 11.6, 12.6, 2.6, 2.4, 0.086), (0.256, 0.284, 0.602, 0.139, 0.349, 0.394)

    def curve(x: Any, t: Any) -> Any:
        v1, v2, v3, cl, q2, q3 = (
            each * np.exp(width * value)
            for each, width, value in zip(typical, widths, x, strict=True)
        )
        out, back_2, back_3 = (cl + q2 + q3) / v1, q2 / v2, q3 / v3
        # The rates of three modes are the roots of s^3 - a s^2 + b s - c, by Viete's formula.
        a, c = out + back_2 + back_3, cl / v1 * back_2 * back_3
        b = (out - q3 / v1) * back_3 + (out - q2 / v1) * back_2 + back_2 * back_3
        width = np.sqrt(a**2 / 9 - b / 3)
        angle = np.arccos(((a / 3) ** 3 - a * b / 6 + c / 2) / width**3) / 3
        s = [a / 3 + 2 * width * np.cos(angle + 2 * np.pi * k / 3) for k in range(3)]
        concentration = 0.0
        for k in range(3):
            gain = (back_2 - s[k]) * (back_3 - s[k]) / ((s[k - 1] - s[k]) * (s[k - 2] - s[k])) / v1
            left = np.exp(-s[k] * np.maximum(t - 20.0, 0.0)) - np.exp(-s[k] * t)
            concentration = concentration + 100.0 * gain / s[k] * left
        return np.log(concentration)

    return response("remifentanil", curve, lambda c: 0.167 + 0.0 * c, 6)
