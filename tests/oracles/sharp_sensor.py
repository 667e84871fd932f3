"""A model on which a particle filter fools itself: a sensor that is at times too sharp for it.

A position is sensed at multiples of 3 with a standard deviation a hundredth of the prior's. A few
particles survive such a measurement: their variance is next to nothing, whatever their error is.
"""

from pfdist import StateSpaceModel, where


def _standard_deviation(t, p):
    return where(t % 3 == 0, p.sharp, p.dull)


model = StateSpaceModel(
    name="sharp sensor",
    initial=lambda w, p: (3.0 * w[0], w[1]),
    transition=lambda x, t, w, p: (x[0] + x[1], x[1] + 0.1 * w[0]),
    measurement=lambda x, t, v, p: (x[0] + _standard_deviation(t, p) * v[0],),
    log_likelihood=lambda y, x, t, p: -0.5 * ((y[0] - x[0]) / _standard_deviation(t, p)) ** 2,
    quantity_of_interest=lambda x, t, p: (x[0],),
    initial_noise=("normal", "normal"),
    process_noise=("normal",),
    measurement_noise=("normal",),
    parameters={"sharp": 0.03, "dull": 0.5},
)
