"""A drug in the blood after an injection: two compartments, with variation between patients.

The dose enters the central compartment (the blood) at time 0. The drug is eliminated from there,
and is exchanged between it and the peripheral compartment (the tissue). All rates are proportional
to amounts, so the amounts after any time follow in closed form from the exponential of a 2x2
matrix: first a fast fall while the drug spreads, then a slow one. Clearance and central volume
differ between patients by log-normal factors and stay the same in a patient. A small log-normal
noise of both amounts, which grows with the square root of time, models what two compartments
neglect.

The measurement is the logarithm of the concentration in the blood, with normal noise. The quantity
of interest is the logarithm without noise, so a relative error counts the same for high and low
concentrations. An MSE of 0.01 is an error of about 10 %.

Units: mg, L, h. The parameters are about those of vancomycin in adults, and lie within the ranges
that Aljutayli et al. report: half of the drug spreads in 1.1 h, and half of it is gone 13 h later.
The model reads ``p.dt``, so a job needs a clock.

References
----------
Gibaldi, Perrier, "Pharmacokinetics", 2nd edition, 1982, chapter 2. Gabrielsson, Weiner,
"Pharmacokinetic and pharmacodynamic data analysis", 5th edition, 2016. Aljutayli, Marsot, Nekka,
"An update on population pharmacokinetic analyses of vancomycin, part I: in adults", Clinical
Pharmacokinetics 59, 2020. Tornoe et al., "Stochastic differential equations in NONMEM",
Pharmaceutical Research 22, 2005 (noise of the amounts).
"""

import numpy as np

from pfdist.models.base import StateSpaceModel
from pfdist.models.parameters import NOT_NEGATIVE, POSITIVE


def initial(w, p):
    clearance = p.clearance * np.exp(p.clearance_sd * w[0])
    volume = p.central_volume * np.exp(p.volume_sd * w[1])
    return (p.dose, 0.0, clearance, volume)


def transition(x, t, w, p):
    central, peripheral, clearance, volume = x
    eliminated = clearance / volume  # shares in an hour
    leaving = p.exchange / volume
    returning = p.exchange / p.peripheral_volume

    noise = np.exp(p.process_sd * np.sqrt(p.dt[t]) * w[0])
    central, peripheral = after(central, peripheral, (eliminated, leaving, returning), p.dt[t])
    return (noise * central, noise * peripheral, clearance, volume)


def after(central, peripheral, shares, dt):
    """Both amounts after dt hours; the shares leave the body, the centre and the periphery."""
    eliminated, leaving, returning = shares
    # exp(M dt) = mean * I + slope * (M - trace(M) / 2 * I), with M's eigenvalues -slow and -fast
    middle = (eliminated + leaving + returning) / 2
    half = np.sqrt((eliminated + leaving - returning) ** 2 / 4 + leaving * returning)
    slow = eliminated * returning / (middle + half)
    left, left_fast = np.exp(-slow * dt), np.exp(-(middle + half) * dt)
    mean, slope = (left + left_fast) / 2, (left - left_fast) / (2 * half)

    difference = (returning - eliminated - leaving) / 2
    return (
        mean * central + slope * (difference * central + returning * peripheral),
        mean * peripheral + slope * (leaving * central - difference * peripheral),
    )


def _log_concentration(x):
    return np.log(x[0] / x[3])


def measurement(x, t, v, p):
    return (_log_concentration(x) + p.measurement_sd * v[0],)


def log_likelihood(y, x, t, p):
    return -0.5 * ((y[0] - _log_concentration(x)) / p.measurement_sd) ** 2


def quantity_of_interest(x, t, p):
    return (_log_concentration(x),)


model = StateSpaceModel(
    name="pharmacokinetics",
    initial=initial,
    transition=transition,
    measurement=measurement,
    log_likelihood=log_likelihood,
    quantity_of_interest=quantity_of_interest,
    initial_noise=("normal", "normal"),
    process_noise=("normal",),
    measurement_noise=("normal",),
    parameters={
        "dose": 1000.0,
        "clearance": 4.5,
        "central_volume": 20.0,
        "exchange": 6.0,
        "peripheral_volume": 40.0,
        "clearance_sd": 0.35,
        "volume_sd": 0.25,
        "process_sd": 0.01,
        "measurement_sd": 0.15,
    },
    parameter_ranges={
        "dose": POSITIVE,
        "clearance": POSITIVE,
        "central_volume": POSITIVE,
        "exchange": POSITIVE,
        "peripheral_volume": POSITIVE,
        "clearance_sd": NOT_NEGATIVE,
        "volume_sd": NOT_NEGATIVE,
        "process_sd": NOT_NEGATIVE,
        "measurement_sd": POSITIVE,
    },
    x_names=(
        "central amount [mg]",
        "peripheral amount [mg]",
        "clearance [L/h]",
        "central volume [L]",
    ),
    y_names=("log concentration",),
    z_names=("log concentration",),
)
