"""Evaluate one set of measurement times in process."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from pfdist.errors import MeasurementTimesError, shown
from pfdist.evaluation.estimate import Purpose, ReportEvaluation
from pfdist.evaluation.problem import Problem
from pfdist.evaluation.work import Work, cut
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
        A job, or the path of its file.
    measurement_times : iterable of int
        In 0..T, as many as you like. They may break the job's constraints:
        ``load_job(path).problem.broken(times)`` says which.
    draws, particles, seed : int, optional
        In the place of the job's evaluation.draws, filter.particles and seed.

    Returns
    -------
    ReportEvaluation
        With ``expected_mse``, ``standard_error``, ``draws``, ``degenerate_draws`` and ``mse``, the
        per-draw values.

    Raises
    ------
    JobError, ModelError, MeasurementTimesError
        What was asked for is impossible.
    """
    return prepare(job, measurement_times, draws, particles, seed)()


def prepare(
    job: Job | str | Path,
    measurement_times: Iterable[int],
    draws: int | None = None,
    particles: int | None = None,
    seed: int | None = None,
) -> Callable[[], ReportEvaluation]:
    """Give a function that evaluates: `evaluate`, with all that must be compiled done before."""
    given = {"evaluation.draws": draws, "filter.particles": particles, "seed": seed}
    changes = [
        f"{key}={shown(value) if isinstance(value, int) else value}"
        for key, value in given.items()
        if value is not None
    ]
    job = as_job(job, changes)
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
    settings = Settings.of(job)
    whole = Work(
        (times,), (problem.horizon,), (stream,), stream, (0, settings.draws), settings.estimation
    )
    return partial(_estimated, problem, whole, policy)


def _exact(problem: Problem, times: Times, policy: str) -> ReportEvaluation:
    exact = float(problem.expected_mse([times])[0])
    return EVALUATE.evaluation(times, np.empty(0), policy, exact)


def _estimated(problem: Problem, whole: Work, policy: str) -> ReportEvaluation:
    block = max(1, int(MOST_SECONDS / problem.seconds_a_step / whole.steps_a_draw))
    pieces = [
        problem(replace(whole, draws=piece)).mse[:, 0] for piece in cut(range(*whole.draws), block)
    ]
    return EVALUATE.evaluation(whole.measurement_times[0], np.concatenate(pieces), policy)
