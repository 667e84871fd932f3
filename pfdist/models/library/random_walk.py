"""A random walk, measured with noise: the simplest model.

The model is linear and Gaussian, so the expected MSE is known exactly. The noise is the same at all
times, so regular times are almost the best.

References
----------
Harvey, "Forecasting, structural time series models and the Kalman filter", 1989: the local level
model.
"""

from pfdist.models.base import StateSpaceModel
from pfdist.models.parameters import NOT_NEGATIVE, POSITIVE

model = StateSpaceModel(
    name="random_walk",
    initial=lambda w, p: (p.initial_sd * w[0],),
    transition=lambda x, t, w, p: (x[0] + p.step_sd * w[0],),
    measurement=lambda x, t, v, p: (x[0] + p.measurement_sd * v[0],),
    log_likelihood=lambda y, x, t, p: -0.5 * ((y[0] - x[0]) / p.measurement_sd) ** 2,
    quantity_of_interest=lambda x, t, p: (x[0],),
    initial_noise=("normal",),
    process_noise=("normal",),
    measurement_noise=("normal",),
    parameters={"initial_sd": 5.0, "step_sd": 1.0, "measurement_sd": 1.0},
    parameter_ranges={
        "initial_sd": NOT_NEGATIVE,
        "step_sd": NOT_NEGATIVE,
        "measurement_sd": POSITIVE,
    },
    linear_gaussian=True,
    x_names=("level",),
    y_names=("measured level",),
    z_names=("level",),
)
