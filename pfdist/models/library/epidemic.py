"""An epidemic that is monitored by the number of positive tests in random samples.

The susceptible and the infectious are shares of a large population (SIR model). Each day every
infectious person infects others at a transmission rate that wanders: its logarithm returns to its
mean in some weeks (Ornstein-Uhlenbeck process), because people and seasons change. Between two
instants there are SUBSTEPS short times. In a short time the hazards of infection and recovery are
constant, so both shares stay within 0 and 1 for any time between two instants.

A measurement tests TESTS persons who are drawn at random. A test of an infectious person is
positive with the probability `sensitivity`, that of another person with 1 - `specificity`. The
measurement is the number of positive tests. It is simulated test for test, with a uniform variate
for each, so it is exactly binomial, and the log-likelihood is exactly that of a binomial count. The
count is not approximated by a normal distribution. The quantity of interest is the prevalence, in
per cent of the population.

The unit of time is a day. The infectious period and the reproduction number are about those of a
pandemic influenza or of SARS-CoV-2. The model reads ``p.dt``, so a job needs a clock.

References
----------
Kermack, McKendrick, "A contribution to the mathematical theory of epidemics", Proceedings of the
Royal Society A 115, 1927. Dureau, Kalogeropoulos, Baguelin, "Capturing the time-varying drivers of
an epidemic using stochastic dynamical systems", Biostatistics 14, 2013. Rogan, Gladen, "Estimating
prevalence from the results of a screening test", American Journal of Epidemiology 107, 1978.
"""

import numpy as np

from pfdist.elementwise import where
from pfdist.models.base import StateSpaceModel
from pfdist.models.parameters import NOT_NEGATIVE, POSITIVE

SUBSTEPS = 4  # between two instants
TESTS = 200  # persons in a sample


def _mean_log_rate(p):
    return np.log(p.reproduction_number / p.infectious_days)


def initial(w, p):
    infectious = np.minimum(p.first_infectious * np.exp(p.first_infectious_sd * w[0]), 1.0)
    return (1 - infectious, infectious, _mean_log_rate(p) + p.transmission_sd * w[1])


def transition(x, t, w, p):
    susceptible, infectious, log_rate = x
    h = p.dt[t] / SUBSTEPS
    rate = np.exp(log_rate)
    recovering = -np.expm1(-h / p.infectious_days)  # the share that recovers in a short time
    for _ in range(SUBSTEPS):
        infected = -susceptible * np.expm1(-h * rate * infectious)
        susceptible = susceptible - infected
        infectious = infectious + infected - recovering * infectious
    kept = np.exp(-p.dt[t] / p.return_days)
    mean = _mean_log_rate(p)
    pushed = p.transmission_sd * np.sqrt(1 - kept**2) * w[0]
    return (susceptible, infectious, mean + kept * (log_rate - mean) + pushed)


def _chance(x, p):  # of a positive test
    return p.sensitivity * x[1] + (1 - p.specificity) * (1 - x[1])


def measurement(x, t, v, p):
    chance, positive = _chance(x, p), 0.0
    for variate in v:
        positive = positive + where(variate < chance, 1.0, 0.0)
    return (positive,)


def log_likelihood(y, x, t, p):
    chance = _chance(x, p)
    return y[0] * np.log(chance) + (TESTS - y[0]) * np.log1p(-chance)


def quantity_of_interest(x, t, p):
    return (100 * x[1],)


LIKELY = (0.5, 1 - 1e-9)  # a sure test would give impossible counts a log-likelihood of -inf

model = StateSpaceModel(
    name="epidemic",
    initial=initial,
    transition=transition,
    measurement=measurement,
    log_likelihood=log_likelihood,
    quantity_of_interest=quantity_of_interest,
    initial_noise=("normal", "normal"),
    process_noise=("normal",),
    measurement_noise=("uniform",) * TESTS,
    parameters={
        "reproduction_number": 2.2,
        "infectious_days": 6.0,
        "return_days": 20.0,
        "transmission_sd": 0.25,
        "first_infectious": 0.001,
        "first_infectious_sd": 0.5,
        "sensitivity": 0.85,
        "specificity": 0.99,
    },
    parameter_ranges={
        "reproduction_number": POSITIVE,
        "infectious_days": POSITIVE,
        "return_days": POSITIVE,
        "transmission_sd": NOT_NEGATIVE,
        "first_infectious": (0.0, 1.0),
        "first_infectious_sd": NOT_NEGATIVE,
        "sensitivity": LIKELY,
        "specificity": LIKELY,
    },
    x_names=("susceptible", "infectious", "log transmission rate"),
    y_names=("positive tests",),
    z_names=("prevalence [%]",),
)
