"""A drug in the blood after an injection, with unknown clearance: two compartments.

The dose enters the central compartment (the blood) at time 0. The drug is eliminated from there,
and is exchanged between it and the peripheral compartment (the tissue). All rates are proportional
to amounts, so the amounts after any time follow in closed form from the exponential of a 2x2
matrix. The share of the dose that arrives differs between patients, and white noise of both amounts
models what two compartments neglect. Two assays measure the concentration in the blood with normal
noise: an immunoassay is cheap and noisy, a chromatography is expensive and precise.

The clearance is a parameter. It differs between patients by a factor of two and more, so a job
gives it scenarios: see the page on robust plans. With a known clearance the system is linear and
Gaussian, so the engine "kalman" computes all errors exactly, without draws. In `pharmacokinetics`
the clearance is a component of x that the filter estimates.

Units: mg, L, h. The parameters are about those of vancomycin in adults, as in `pharmacokinetics`.
The model reads ``p.dt``, so a job needs a clock.

References
----------
Gibaldi, Perrier, "Pharmacokinetics", 2nd edition, 1982, chapter 2. Aljutayli, Marsot, Nekka, "An
update on population pharmacokinetic analyses of vancomycin, part I: in adults", Clinical
Pharmacokinetics 59, 2020.
"""

import numpy as np

from pfdist.models.base import Sensor, StateSpaceModel
from pfdist.models.library.pharmacokinetics import after
from pfdist.models.parameters import NOT_NEGATIVE, POSITIVE


def initial(w, p):
    return (p.dose * (1.0 + p.dose_sd * w[0]), 0.0)


def transition(x, t, w, p):
    central, peripheral = x
    eliminated = p.clearance / p.central_volume  # shares in an hour
    leaving = p.exchange / p.central_volume
    returning = p.exchange / p.peripheral_volume
    noise = p.process_sd * np.sqrt(p.dt[t])
    central, peripheral = after(central, peripheral, (eliminated, leaving, returning), p.dt[t])
    return (central + noise * w[0], peripheral + noise * w[1])


def immunoassay(x, t, v, p):
    return (x[0] / p.central_volume + p.immunoassay_sd * v[0],)


def log_likelihood_of_immunoassay(y, x, t, p):
    return -0.5 * ((y[0] - x[0] / p.central_volume) / p.immunoassay_sd) ** 2


def chromatography(x, t, v, p):
    return (x[0] / p.central_volume + p.chromatography_sd * v[0],)


def log_likelihood_of_chromatography(y, x, t, p):
    return -0.5 * ((y[0] - x[0] / p.central_volume) / p.chromatography_sd) ** 2


def quantity_of_interest(x, t, p):
    return (x[0] / p.central_volume,)


model = StateSpaceModel(
    name="two_compartments",
    initial=initial,
    transition=transition,
    quantity_of_interest=quantity_of_interest,
    initial_noise=("normal",),
    process_noise=("normal", "normal"),
    sensors={
        "immunoassay": Sensor(immunoassay, log_likelihood_of_immunoassay, ("normal",), price=1),
        "chromatography": Sensor(
            chromatography, log_likelihood_of_chromatography, ("normal",), price=2
        ),
    },
    parameters={
        "dose": 1000.0,
        "dose_sd": 0.1,
        "clearance": 4.5,
        "central_volume": 20.0,
        "exchange": 6.0,
        "peripheral_volume": 40.0,
        "process_sd": 20.0,
        "immunoassay_sd": 2.5,
        "chromatography_sd": 0.5,
    },
    parameter_ranges={
        "dose": POSITIVE,
        "dose_sd": NOT_NEGATIVE,
        "clearance": POSITIVE,
        "central_volume": POSITIVE,
        "exchange": POSITIVE,
        "peripheral_volume": POSITIVE,
        "process_sd": NOT_NEGATIVE,
        "immunoassay_sd": POSITIVE,
        "chromatography_sd": POSITIVE,
    },
    linear_gaussian=True,
    x_names=("central amount [mg]", "peripheral amount [mg]"),
    y_names=("by immunoassay [mg/L]", "by chromatography [mg/L]"),
    z_names=("concentration [mg/L]",),
)
