"""An epidemic that is monitored by counts of patients, with a Poisson likelihood.

The epidemic is that of `pfdist.models.library.epidemic`: shares of the susceptible and of the
infectious, and a transmission rate that wanders. On a measured day, sentinel practices count the
patients with the disease. `registered` persons belong to these practices. Each infectious person
comes with the probability `consulting`, and some persons come with the same symptoms of another
disease, a share `background` of all. The count is a Poisson number. It has no upper limit, unlike a
number of positive tests, and it is drawn from one uniform variate.

The quantity of interest is the prevalence, in per cent of the population. The unit of time is a
day. The model reads ``p.dt``, so a job needs a clock.

References
----------
Farrington, Andrews, Beale, Catchpole, "A statistical algorithm for the early detection of outbreaks
of infectious disease", Journal of the Royal Statistical Society A 159, 1996 (Poisson counts of
reports with a background).
"""

from dataclasses import replace

from pfdist.densities.draws import poisson_draw
from pfdist.densities.log_densities import poisson_logpmf
from pfdist.models.library import epidemic
from pfdist.models.parameters import POSITIVE


def mean_count(x, p):
    return p.registered * (p.consulting * x[1] + p.background)


def measurement(x, t, v, p):
    return (poisson_draw(v[0], mean_count(x, p)),)


def log_likelihood(y, x, t, p):
    return poisson_logpmf(y[0], mean_count(x, p))


_OF_THE_TESTS = {"sensitivity", "specificity"}
_OWN = {"registered": 5000.0, "consulting": 0.1, "background": 0.0005}

model = replace(
    epidemic.model,
    name="epidemic_counts",
    measurement=measurement,
    log_likelihood=log_likelihood,
    measurement_noise=("uniform",),
    parameters={k: v for k, v in epidemic.model.parameters.items() if k not in _OF_THE_TESTS}
    | _OWN,
    parameter_ranges={
        name: limits
        for name, limits in epidemic.model.parameter_ranges.items()
        if name not in _OF_THE_TESTS
    }
    | {
        "registered": POSITIVE,
        "consulting": (0.0, 1.0),
        # Without any background, a count would be impossible where nobody is infectious.
        "background": POSITIVE,
    },
    normalised=True,
    y_names=("patients",),
)
