"""The checks of a model as a table."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeGuard

import pandas as pd

from pfdist.checks.model import Check, check_object
from pfdist.checks.model import check_model as check_named
from pfdist.common.arguments import whole_argument
from pfdist.errors import ArgumentError, ModelError, shown
from pfdist.job.asked import Asked, as_job
from pfdist.job.job import Job
from pfdist.job.problem import Problem
from pfdist.meaning.chosen import ChosenModel
from pfdist.meaning.given import given_model
from pfdist.models import StateSpaceModel
from pfdist.runner.chooser import chooser_of, models_of
from pfdist.times.clock import Time

HORIZON, PARTICLES = 60, 500
MOST_INSTANTS, MOST_PARTICLES = 32_000, 10_000_000


def check_model(
    model: StateSpaceModel | Asked, horizon: int | None = None, particles: int | None = None
) -> pd.DataFrame:
    """Check a model in every way, as the command ``pfdist check-model`` does.

    Parameters
    ----------
    model : StateSpaceModel, Problem, Job, str or Path
        A model or the name of a model; or a problem, a job, or the path of a job file ``*.toml``,
        whose models are checked with their parameters.
    horizon : int, optional
        T of the draws that are simulated; by default that of the problem, or 60.
    particles : int, optional
        Number of particles of the filter that is timed; by default that of the problem, or 500.

    Returns
    -------
    DataFrame
        A row for each check: check, state and text. The state is "ok"; "note" for what is worth
        knowing; or "wrong" for what makes every figure wrong or ends a run. The checks of a
        filter's model begin with "filter: ".

    Raises
    ------
    JobError, ArgumentError
        The job, the horizon or the number of particles is not possible.
    """
    job = as_job(model) if _is_job(model) else None
    own = (HORIZON, PARTICLES)
    if job is not None:
        own = (job.problem.feasible.horizon, job.filter.particles)
    instants = whole_argument("horizon", own[0] if horizon is None else horizon, 1, MOST_INSTANTS)
    count = whole_argument(
        "particles", own[1] if particles is None else particles, 1, MOST_PARTICLES
    )
    if job is not None:
        checks = _checks_of_job(job, instants, count)
    elif isinstance(model, str):
        checks = check_named(model, instants, count)
    elif isinstance(model, StateSpaceModel):
        checks = _checks_of_object(model, instants, count)
    else:
        raise ArgumentError(
            "a model must be a StateSpaceModel, the name of a model, a problem or a job, got "
            f"{shown(model)}",
            argument="model",
        )
    rows = [{"check": check.name, "state": check.state, "text": check.text} for check in checks]
    return pd.DataFrame(rows)


def _is_job(model: StateSpaceModel | Asked) -> TypeGuard[Asked]:
    is_file = isinstance(model, Path) or (isinstance(model, str) and model.endswith(".toml"))
    return is_file or isinstance(model, Problem | Job)


def _checks_of_job(job: Job, horizon: int, particles: int) -> Iterator[Check]:
    """Check the models of a job, with its parameters."""
    try:
        model, filter_model = models_of(job, chooser_of(job))
    except ModelError as error:
        yield Check("load", "wrong", str(error))
        return
    clock = job.problem.clock.times if job.problem.has_clock else ()
    yield from _checks_of(model, horizon, particles, clock)
    if filter_model.meaning != model.meaning:
        for check in _checks_of(filter_model, horizon, particles, clock):
            yield replace(check, name=f"filter: {check.name}")


def _checks_of_object(model: StateSpaceModel, horizon: int, particles: int) -> Iterator[Check]:
    try:
        given_model(model)
    except ModelError as error:
        yield Check("load", "wrong", str(error))
    else:
        yield from check_object(model, horizon, particles)


def _checks_of(
    model: ChosenModel, horizon: int, particles: int, clock: Sequence[Time]
) -> Iterator[Check]:
    try:
        loaded = model.load()
        if clock:
            loaded, horizon = loaded.on_clock(clock), min(horizon, len(clock) - 1)
    except ModelError as error:
        yield Check("load", "wrong", str(error))
    else:
        yield from check_object(loaded, horizon, particles)
