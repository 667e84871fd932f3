"""Lorenz's model of convection, the first strange attractor, as a stochastic differential equation.

Between two instants, `step` units of time apart, the state takes ten Euler-Maruyama steps: x <- x +
h f(x) + diffusion sqrt(h) w. With h = 0.01 no component of 20,000 draws of 300 instants exceeds 55;
with h = 0.02 no component exceeds 65. Larger steps are not accepted. The model is this discrete
chain. It differs from the solution of the equation by terms of first order in h.

Only the first component is measured; the quantity of interest is the whole state. The start, and
the variance 2 of the first state and of the measurements, are those of Evensen and van Leeuwen, who
measure all three components. The noise models neglected effects, as in Miller et al.

Chaos amplifies differences in the last digit, such as those between compiled and plain formulas:
they reach 6e-11 after 30 instants, 0.006 after 200, and the size of the attractor after 300.

References
----------
Lorenz, "Deterministic nonperiodic flow", Journal of the Atmospheric Sciences 20, 1963. Miller,
Carter, Blue, "Data assimilation into nonlinear stochastic models", Tellus A 51, 1999. Evensen, van
Leeuwen, "An ensemble Kalman smoother for nonlinear dynamics", Monthly Weather Review 128, 2000.
"""

import math

from pfdist.models.base import StateSpaceModel
from pfdist.models.continuous import sde
from pfdist.models.parameters import NOT_NEGATIVE, POSITIVE

START = (1.508870, -1.531271, 25.46091)


def initial(w, p):
    return (
        START[0] + p.initial_sd * w[0],
        START[1] + p.initial_sd * w[1],
        START[2] + p.initial_sd * w[2],
    )


def drift(x, t, p):
    a, b, c = x
    return (p.sigma * (b - a), a * (p.rho - c) - b, a * b - p.beta * c)


def diffusion(x, t, p):
    return (p.diffusion,) * 3


transition = sde(drift, diffusion, noises=3, substeps=10, dt="step")


def measurement(x, t, v, p):
    return (x[0] + p.measurement_sd * v[0],)


def log_likelihood(y, x, t, p):
    return -0.5 * ((y[0] - x[0]) / p.measurement_sd) ** 2


def quantity_of_interest(x, t, p):
    return x


model = StateSpaceModel(
    name="lorenz63",
    initial=initial,
    transition=transition,
    measurement=measurement,
    log_likelihood=log_likelihood,
    quantity_of_interest=quantity_of_interest,
    initial_noise=("normal",) * 3,
    process_noise=transition.process_noise,
    measurement_noise=("normal",),
    parameters={
        "sigma": 10.0,
        "rho": 28.0,
        "beta": 8 / 3,
        "step": 0.1,
        "diffusion": 1.0,
        "initial_sd": math.sqrt(2),
        "measurement_sd": math.sqrt(2),
    },
    parameter_ranges={
        "step": (0.0, 0.2),
        "diffusion": NOT_NEGATIVE,
        "initial_sd": NOT_NEGATIVE,
        "measurement_sd": POSITIVE,
    },
    x_names=("convection", "horizontal difference", "vertical difference"),
    y_names=("measured convection",),
    z_names=("convection", "horizontal difference", "vertical difference"),
)
