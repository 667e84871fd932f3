"""The part of a model file that small models of tests share: a state measured with noise."""

MEASURED = """    measurement=lambda x, t, v, p: (x[0] + v[0],),
    log_likelihood=lambda y, x, t, p: -0.5 * (y[0] - x[0]) ** 2,
    quantity_of_interest=lambda x, t, p: (x[0],),
    initial_noise=("normal",),
    process_noise=("normal",),
    measurement_noise=("normal",),
"""

WALK = (
    """
{before}
from pfdist import StateSpaceModel

model = StateSpaceModel(
    name="mine",
    initial=lambda w, p: (w[0],),
    transition=lambda x, t, w, p: ({formula},),
"""
    + MEASURED
    + """{after})
"""
)
"""A model with lines before it, what a step gives, and further fields."""
