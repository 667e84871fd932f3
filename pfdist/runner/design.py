"""The linearized design of a job's problem: a finalist of plans, a search, and a name for times."""

import math
from collections.abc import Iterable

from pfdist.common.measurement_times import Times
from pfdist.common.streams import stream_of
from pfdist.errors import ModelError
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.linearized import DRAWS, Linearized, linearized
from pfdist.kernels.variates import generator
from pfdist.problem.job import Job
from pfdist.search.linearized import designs

_STARTS = 3  # random sets from which exchanges begin, beside given ones
_STEPS = 100  # particle-steps in the time of a draw and an instant of a linearized error


def linearized_of(job: Job, evaluator: Evaluator) -> Linearized:
    """The linearized errors of a job's sets.

    Raises `ModelError` if the criterion is not the expected MSE, the filter has another model than
    the truth, or a formula has no derivatives.
    """
    is_mse = job.criterion.is_mean and not job.criterion.aspects
    why = {
        "a criterion other than the expected MSE": not is_mse,
        "scenarios": bool(evaluator.scenarios),
        "a filter with another model": evaluator.believed != evaluator.model,
        "values that arrive later": any(evaluator.delays),
    }  # fmt: skip
    for what, is_so in why.items():
        if is_so:
            raise ModelError(f"there is no linearized design for {what}")
    stream = stream_of("search", job.seed, "linearized")
    model, own = evaluator.model, (evaluator.horizon, stream, evaluator.lag)
    weights = evaluator.instant_weights
    found: Linearized = model.kept(
        ("linearized", *own, evaluator.weights), lambda: linearized(model, *own, weights)
    )
    return found


def design_of(
    job: Job, evaluator: Evaluator, starts: Iterable[Times] = (), most: float = math.inf
) -> Times:
    """The linearized design of a job, for so many particle-steps.

    Exchanges begin at the given sets that are feasible, or at regular times, and at random sets.
    Raises `ModelError` as `linearized_of`.
    """
    errors, feasible = linearized_of(job, evaluator), job.problem.feasible
    own = [*filter(feasible.accepts, starts)] or [feasible.regular()]
    some = feasible.random(_STARTS, generator("search", job.seed, "linearized"))
    sets = most / (DRAWS * (evaluator.horizon + 1) * _STEPS)
    return designs(feasible, errors, [*own, *some], sets)[0]
