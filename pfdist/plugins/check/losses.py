"""The particle loss as a table, before a run."""

import warnings
from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import pandas as pd
from pydantic import Field

from pfdist.common.measurement_times import REGULAR
from pfdist.common.section import Whole, checked
from pfdist.errors import PfdistWarning
from pfdist.filters.proposal import PLAIN
from pfdist.filters.proposals import PROPOSALS, RIVALS
from pfdist.filters.variants import self_consistent
from pfdist.problem.clock import Time
from pfdist.problem.needs import LOSS
from pfdist.problem.problem import JobSource, as_job
from pfdist.questions.evaluate import UNNAMED, instants_evaluated
from pfdist.runner.build import build
from pfdist.runner.particles import (
    mean_effective_sizes,
    measured_loss,
    why_plain,
    work_of_loss,
)

if TYPE_CHECKING:
    _Numbers = Iterable[int]
else:
    _Numbers = Annotated[
        tuple[Annotated[Whole, Field(ge=1, le=10_000_000)], ...], Field(strict=False)
    ]


@checked
def particle_losses(
    job: JobSource,
    particles: _Numbers = (50, 100, 200, 500, 1000, 2000, 5000),
    measurement_times: Iterable[Time] | str = REGULAR,
    draws: Annotated[Whole, Field(ge=2, le=1_000_000)] = 1000,
    seed: int | None = None,
) -> pd.DataFrame:
    """The particle loss with each of some numbers of particles, on the same draws.

    It is that of the job's estimate, computed in this process. If the filter's model is not the
    truth, the draws are those of the filter's model. If the job has the proposal "guided" where
    "auto" takes "plain" with one of the numbers, a `PfdistWarning` says so.

    Parameters
    ----------
    job : Problem, Job, str or Path
        A job file, as ``jobs/plan.toml``, or the folder of a run.
    particles : iterable of int
        Numbers of particles; they replace that of the job.
    measurement_times : iterable of int or float, or str
        As for `pfdist.evaluate`; by default the regular times of the job.
    draws : int
        Number of draws, which all numbers of particles share.
    seed : int, optional
        By default the seed of the job.

    Returns
    -------
    DataFrame
        A row for each number of particles. The columns are particles; draws; expected_mse and
        standard_error, of the job's filter on the draws of its own model; as fractions of this
        expected MSE, particle_loss and particle_loss_error, half the squared distance of two
        independent filters and its standard error; particle_loss_at_most and
        particle_loss_at_most_error, the squared error less the variance of particles beside the
        truth, which is at least the loss; particle_loss_limit, its upper 95 % limit; and
        effective_sample_size, the mean after all measurements.

    Raises
    ------
    JobError, ModelError, MeasurementTimesError, ArgumentError
        The job, the model, the times or a number is not possible; the engine has no particles; or
        the model defines its own error.

    References
    ----------
    Andrieu, Doucet, Holenstein, "Particle Markov chain Monte Carlo methods", Journal of the Royal
    Statistical Society B 72, 2010 (the variance of particles beside the truth).
    """
    job = as_job(job, settings={"seed": seed, "filter": {"particles": max(particles, default=1)}})
    times = instants_evaluated(job, UNNAMED, measurement_times)
    built = build(job, asked=4 * draws * len(tuple(particles)))
    evaluator, rows = self_consistent(built.evaluator), []
    LOSS.check("the particle loss", job, evaluator)
    rival = PROPOSALS[built.job.filter.proposal]
    if job.filter.proposal == rival.name and rival in RIVALS:
        plains = (replace(built.comparing, proposal=PLAIN.name, particles=n) for n in particles)
        whys = (why_plain(evaluator, (times,), job.seed, each, rival) for each in plains)
        if why := next(filter(None, whys), ""):
            text = f"filter.proposal = {rival.name!r} where 'auto' takes 'plain': {why}"
            warnings.warn(text, PfdistWarning, stacklevel=3)
    for number in particles:
        estimation = replace(built.comparing, particles=number)
        work = work_of_loss(evaluator, times, job.seed, estimation, draws)
        loss, mse = measured_loss(evaluator, work)
        rows.append(
            {
                "particles": number,
                "draws": draws,
                "expected_mse": mse.mean,
                "standard_error": mse.standard_error,
                **loss.columns(),
                "effective_sample_size": mean_effective_sizes(evaluator, work).mean(),
            }
        )
    return pd.DataFrame(rows)
