"""The filter of a job, for one real system."""

from pfdist.errors import JobError
from pfdist.filters.cloud import Prior
from pfdist.runner.build import Built
from pfdist.sequential.filter import Filter


def filter_of(built: Built, prior: Prior | None = None, draw: int = 0) -> Filter:
    """The filter of a job for one system, with the job's [model.filter], [filter] and seed.

    Parameters
    ----------
    built : Built
    prior : Cloud or Gaussian, optional
        The knowledge of x(s), in the place of the model's `initial`.
    draw : int
        Number of the system, which keys the noise.

    Raises
    ------
    PriorError
        The prior does not fit the model.
    """
    job = built.job
    if built.evaluator.told:
        raise JobError(
            "a filter of real measurements cannot be told the scenario, got scenarios.filter = "
            f"'told' ({job.path}): 'nominal' gives it the parameters of the model"
        )
    return Filter(
        built.evaluator.believed,
        job.filter.particles,
        job.seed,
        resampling=job.filter.resampling,
        resample=job.filter.resample or "always",
        engine=built.evaluator.engine,
        prior=prior,
        draw=draw,
        horizon=job.problem.feasible.horizon,
    )
