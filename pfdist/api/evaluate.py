"""The expected MSE of one set of measurement times, computed in this process."""

from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pfdist.errors import MeasurementTimesError
from pfdist.evaluation.estimate import Purpose, ReportEvaluation
from pfdist.evaluation.problem import Problem
from pfdist.evaluation.work import Work
from pfdist.job.job import Job, as_job
from pfdist.runner.build import build
from pfdist.runner.pace import MOST_SECONDS
from pfdist.runner.searches import Settings
from pfdist.times.measurement_times import Times, validated

EVALUATE = Purpose("evaluate", ReportEvaluation)


def evaluate(
    job: Job | str | Path,
    measurement_times: Iterable[int],
    draws: int | None = None,
    particles: int | None = None,
    seed: int | None = None,
) -> ReportEvaluation:
    """Estimate the expected MSE of one set of measurement times, in this process.

    Parameters
    ----------
    job : Job, str or Path
        A job, or the path of a job file.
    measurement_times : iterable of int
        Any number of times in 0..T. They may break the job's constraints:
        ``load_job(path).problem.broken(times)`` lists the broken ones.
    draws, particles, seed : int, optional
        Replace the job's evaluation.draws, filter.particles and seed.

    Returns
    -------
    ReportEvaluation
        ``expected_mse``, ``standard_error``, ``draws``, ``degenerate_draws`` and the per-draw
        values ``mse``.

    Raises
    ------
    JobError, ModelError, MeasurementTimesError
        The job, the model or the times are not possible.
    """
    return prepare(job, measurement_times, draws, particles, seed)()


def prepare(
    job: Job | str | Path,
    measurement_times: Iterable[int],
    draws: int | None = None,
    particles: int | None = None,
    seed: int | None = None,
) -> Callable[[], ReportEvaluation]:
    """Compile what `evaluate` needs, and return a function that evaluates without delay."""
    settings: dict[str, Any] = {} if seed is None else {"seed": seed}
    settings |= {} if draws is None else {"evaluation": {"draws": draws}}
    settings |= {} if particles is None else {"filter": {"particles": particles}}
    job = as_job(job, settings=settings)
    try:
        times = validated(measurement_times, job.problem.horizon)
    except MeasurementTimesError as error:
        error.argument = "times"
        raise
    fresh = [times] if job.evaluation.noise == "fresh" else []
    stream = EVALUATE.stream(job.seed, *fresh)
    problem, policy = build(job).source.compiled(), job.evaluation.degenerate_draws
    if problem.exact:
        return partial(_exact, problem, times, policy)
    evaluation = Settings.from_job(job)
    work = Work(
        measurement_times=(times,),
        ends=(problem.horizon,),
        filter_streams=(stream,),
        draws_stream=stream,
        draws=(0, evaluation.draws),
        estimation=evaluation.estimation,
    )
    return partial(_estimated, problem, work, policy)


def _exact(problem: Problem, times: Times, policy: str) -> ReportEvaluation:
    exact = float(problem.expected_mse([times])[0])
    return EVALUATE.evaluation(times, np.empty(0), policy, exact)


def _estimated(problem: Problem, work: Work, policy: str) -> ReportEvaluation:
    mse = [problem.filtered(piece).mse[:, 0] for piece in problem.pieces(work, MOST_SECONDS)]
    return EVALUATE.evaluation(work.measurement_times[0], np.concatenate(mse), policy)
