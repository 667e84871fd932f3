"""The checks of a model: all in a table, or one after another while they run."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, TypeGuard

import pandas as pd
from pydantic import Field

from pfdist.common.section import Whole, checked
from pfdist.errors import ArgumentError, ModelError, shown
from pfdist.filters.engines import AUTO
from pfdist.filters.proposal import PLAIN
from pfdist.models import StateSpaceModel, load_model
from pfdist.models.sensed import sensed
from pfdist.plugins.check.model_checks import EVERY_INSTANT, Check, check_filter_model, check_loaded
from pfdist.problem.job import Job
from pfdist.problem.problem import JobSource, Problem, as_job
from pfdist.runner.build import evaluator_of, models_of_job
from pfdist.runner.searches import comparing_of

HORIZON, PARTICLES = 60, 500


def check_model(
    model: StateSpaceModel | JobSource, horizon: int | None = None, particles: int | None = None
) -> pd.DataFrame:
    """The result of each check of a model, as ``pfdist check-model`` prints it.

    Parameters
    ----------
    model : StateSpaceModel, Problem, Job, str or Path
        A model or the name of a model; or a problem, a job, or the path of a job file ``*.toml``.
        Its models are checked with their parameters, and its filter with the job's horizon,
        sensors, scenarios and regular times.
    horizon : int, optional
        T of the draws with which formulas are checked; by default that of the problem, or 60. With
        a clock, T is at most that of the clock.
    particles : int, optional
        Number of particles of the filter that is timed; by default that of the problem, or 500.

    Returns
    -------
    DataFrame
        A row for each check: check (its name), state and text. The state is "ok"; "note" for
        useful information; or "wrong" for a mistake that makes all results wrong or ends a run. If
        the filter has another model, the names of the checks of its formulas begin with "filter: ".
        Each check takes about 20 seconds at most: a slow model has fewer draws.

    Raises
    ------
    JobError, ArgumentError
        The job, the horizon or the number of particles is not possible.
    """
    checks = checks_of(model, horizon, particles)
    rows = [{"check": check.name, "state": check.state, "text": check.text} for check in checks]
    return pd.DataFrame(rows)


@checked
def checks_of(
    model: StateSpaceModel | JobSource,
    horizon: Annotated[Whole, Field(ge=1, le=32_000)] | None = None,
    particles: Annotated[Whole, Field(ge=1, le=10_000_000)] | None = None,
    times: Sequence[float] = (),
) -> Iterator[Check]:
    """Yield the result of each check of a model, or of the models of a job, as the check ends.

    Parameters
    ----------
    model, horizon, particles
        As for `check_model`.
    times : sequence of float, (T+1,), optional
        The clock for a model that is given by its name. A job has a clock, and a StateSpaceModel
        ignores these times: use its ``on_clock``.

    Raises
    ------
    JobError, ArgumentError
        As `check_model` raises; and if times are given with a job.
    """
    job = as_job(model) if _is_job(model) else None
    if horizon is None:
        horizon = job.problem.feasible.horizon if job else HORIZON
    if particles is None:
        particles = job.filter.particles if job and not job.filter.is_automatic else PARTICLES
    if job is not None:
        if times:
            raise ArgumentError(
                "times cannot be given with a job: it has a clock", argument="times"
            )
        return _checks_of_job(job, horizon, particles)
    if isinstance(model, str):
        return check_loaded(lambda: sensed(load_model(model)), horizon, particles, times)
    if isinstance(model, StateSpaceModel):
        return check_loaded(lambda: sensed(model), horizon, particles)
    raise ArgumentError(
        "a model must be a StateSpaceModel, the name of a model, a problem or a job, got "
        f"{shown(model)}",
        argument="model",
    )


def _is_job(model: StateSpaceModel | JobSource) -> TypeGuard[JobSource]:
    is_file = isinstance(model, Path) or (isinstance(model, str) and model.endswith(".toml"))
    return is_file or isinstance(model, Problem | Job)


def _checks_of_job(job: Job, horizon: int, particles: int) -> Iterator[Check]:
    """Check the models of a job with its parameters, then its filter at its regular times."""
    try:
        models = models_of_job(job)
    except ModelError as error:
        yield Check("load", "wrong", str(error))
        return
    clock, complete = job.problem.clock if job.problem.has_clock else None, True
    if clock is not None:
        horizon = min(horizon, clock.horizon)
    prefixes = ("",) if models[0] == models[1] else ("", "filter: ")
    for prefix, each in zip(prefixes, models, strict=False):

        def load(each: StateSpaceModel = each) -> StateSpaceModel:
            return each if clock is None else each.on_clock(clock.times, clock.dates_in_formulas)

        for check in check_loaded(load, horizon, particles, filtered=False):
            yield replace(check, name=f"{prefix}{check.name}")
        complete &= check.name == EVERY_INSTANT
    if complete:
        proposal = PLAIN.name if job.filter.proposal == AUTO else job.filter.proposal
        settings = {"particles": particles, "proposal": proposal}
        job = job.with_changes(settings={"filter": settings})
        made = partial(evaluator_of, job)
        yield from check_filter_model(
            made, models, job.problem.feasible.regular(), comparing_of(job)
        )
