"""Predators and prey: a stochastic Lotka-Volterra system in its diffusion approximation.

There are three kinds of events: a prey is born, at the rate birth * prey; a prey is eaten and a
predator is born, at predation * prey * predator; a predator dies, at death * predator. In a short
time the number of events of each kind is about normal, and its mean and variance are the rate times
this time (chemical Langevin equation). Between two instants, `step` units of time apart, there are
ten such short times (Euler-Maruyama). The approximation fails for small populations, so no
population falls below one.

Only the prey is counted. The measurement is the logarithm of the count, with normal noise. The
quantity of interest consists of the logarithms of both populations, so a relative error counts the
same for small and large populations. The rates and the first populations are those of Boys et al.
Here each first population is known to a tenth.

References
----------
Boys, Wilkinson, Kirkwood, "Bayesian inference for a discretely observed stochastic kinetic model",
Statistics and Computing 18, 2008. Golightly, Wilkinson, "Bayesian parameter inference for
stochastic biochemical network models using particle Markov chain Monte Carlo", Interface Focus 1,
2011.
"""

import numpy as np

from pfdist.models.base import StateSpaceModel
from pfdist.models.continuous import sde
from pfdist.models.parameters import NOT_NEGATIVE, POSITIVE

PREY, PREDATORS = 71.0, 79.0  # at first
FEWEST = 1.0


def initial(w, p):
    return (
        np.maximum(PREY * np.exp(p.initial_sd * w[0]), FEWEST),
        np.maximum(PREDATORS * np.exp(p.initial_sd * w[1]), FEWEST),
    )


def rates(x, p):
    prey, predators = x
    return (p.birth * prey, p.predation * prey * predators, p.death * predators)


def drift(x, t, p):
    born, eaten, died = rates(x, p)
    return (born - eaten, eaten - died)


def diffusion(x, t, p):  # the normal in place of a Poisson number of each kind of event
    born, eaten, died = np.sqrt(rates(x, p))
    return ((born, -eaten, 0.0), (0.0, eaten, -died))


def keep(x, p):
    return (np.maximum(x[0], FEWEST), np.maximum(x[1], FEWEST))


transition = sde(drift, diffusion, noises=3, substeps=10, dt="step", keep=keep)


def measurement(x, t, v, p):
    return (np.log(x[0]) + p.measurement_sd * v[0],)


def log_likelihood(y, x, t, p):
    return -0.5 * ((y[0] - np.log(x[0])) / p.measurement_sd) ** 2


def quantity_of_interest(x, t, p):
    return (np.log(x[0]), np.log(x[1]))


model = StateSpaceModel(
    name="lotka_volterra",
    initial=initial,
    transition=transition,
    measurement=measurement,
    log_likelihood=log_likelihood,
    quantity_of_interest=quantity_of_interest,
    initial_noise=("normal", "normal"),
    process_noise=transition.process_noise,
    measurement_noise=("normal",),
    parameters={
        "birth": 0.5,
        "predation": 0.0025,
        "death": 0.3,
        "step": 1.0,
        "initial_sd": 0.1,
        "measurement_sd": 0.1,
    },
    parameter_ranges={
        "birth": NOT_NEGATIVE,
        "predation": NOT_NEGATIVE,
        "death": NOT_NEGATIVE,
        "step": NOT_NEGATIVE,
        "initial_sd": NOT_NEGATIVE,
        "measurement_sd": POSITIVE,
    },
    x_names=("prey", "predators"),
    y_names=("log prey counted",),
    z_names=("log prey", "log predators"),
)
