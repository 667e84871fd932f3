"""The error of the estimate that the job did not ask for: afterwards, or at the moment.

A job whose estimate uses the measurements until then shows the error of an analysis afterwards,
with all measurements; another one that of the filter.
"""

from dataclasses import replace
from typing import TYPE_CHECKING

from pfdist.filters.aspects import ErrorBeside, FilterTraits
from pfdist.kernels.estimators import TWO_CLOUDS, TWO_ERRORS

if TYPE_CHECKING:
    from pfdist.filters.work import Estimation

_MORE = 4  # times the particles


def _by_two_filters(evaluator: FilterTraits, own: "Estimation") -> "Estimation":
    """The estimation of the smoothed error.

    A smoothed estimate comes from few ancestors, whose part two filters take out of its error. The
    rest falls with the number of particles, as the variance of a draw does where that is due to
    particles: so more of them are worth fewer draws.
    """
    if not evaluator.has_particle_loss:
        return own
    if not evaluator.variance_is_error:
        return replace(own, estimator=TWO_ERRORS.name)
    return replace(own, particles=_MORE * own.particles, estimator=TWO_CLOUDS.name)


SMOOTHED = ErrorBeside(
    table="other_estimate",
    start="smoothed",
    description="MSE of the smoothed estimate with this set",
    settings=_by_two_filters,
    fits=lambda lag: not lag,
    is_smoothed=True,
    exact="exact_other_mse",
    head="afterwards",
    meaning="expected MSE of the smoothed estimate, if the job's own estimate is filtered; on at "
    "most a fifth of the draws by two filters, or exact",
    is_raised=True,
    when="Analysed afterwards, with all measurements",
    alone="If you analyse only afterwards",
    planned='`problem.estimate = "smoothed"` plans for that.',
)
FILTERED = ErrorBeside(
    table="other_estimate",
    start="filtered",
    description="MSE of the filtered estimate with this set",
    fits=bool,
    exact="exact_other_mse",
    head="at the moment",
    meaning="expected MSE of the filtered estimate, if the job's own estimate uses later "
    "measurements; on at most a fifth of the draws, or exact",
    when="At the moment, with the measurements until then",
)
