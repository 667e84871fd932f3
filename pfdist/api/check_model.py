"""The checks of a model: all in a table, or one after another while they run."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeGuard

import pandas as pd

from pfdist.checks.model import Check, check_object
from pfdist.checks.model import check_model as check_named
from pfdist.common.arguments import whole_argument
from pfdist.errors import ArgumentError, ModelError, shown
from pfdist.job.job import Job
from pfdist.job.problem import Problem
from pfdist.job.source import JobSource, as_job
from pfdist.models import PYTHON, CarriedModel, StateSpaceModel, carried
from pfdist.runner.build import models_of
from pfdist.times.clock import Time

HORIZON, PARTICLES = 60, 500
MOST_INSTANTS, MOST_PARTICLES = 32_000, 10_000_000


def check_model(
    model: StateSpaceModel | JobSource, horizon: int | None = None, particles: int | None = None
) -> pd.DataFrame:
    """Check a model in every way, as the command ``pfdist check-model`` does.

    Parameters
    ----------
    model : StateSpaceModel, Problem, Job, str or Path
        A model or the name of a model; or a problem, a job, or the path of a job file ``*.toml``,
        whose models are checked with their parameters.
    horizon : int, optional
        T of the draws that are simulated; by default that of the problem, or 60. With a clock, T
        is at most that of the clock.
    particles : int, optional
        Number of particles of the filter that is timed; by default that of the problem, or 500.

    Returns
    -------
    DataFrame
        A row for each check: check (its name), state and text. The state is "ok"; "note" for
        something worth knowing; or "wrong" for a mistake that makes all results wrong or ends a
        run. If the filter has a model of its own, the names of its checks begin with "filter: ".

    Raises
    ------
    JobError, ArgumentError
        The job, the horizon or the number of particles is not possible.
    """
    checks = checks_of(model, horizon, particles)
    rows = [{"check": check.name, "state": check.state, "text": check.text} for check in checks]
    return pd.DataFrame(rows)


def checks_of(
    model: StateSpaceModel | JobSource,
    horizon: int | None = None,
    particles: int | None = None,
    times: Sequence[float] = (),
) -> Iterator[Check]:
    """Check a model, or the models of a job, and yield the result of each check as it ends.

    Parameters
    ----------
    model, horizon, particles
        As for `check_model`.
    times : sequence of float, (T+1,), optional
        The clock for a model that is given by its name. A job has a clock of its own, and a
        StateSpaceModel ignores these times: use its ``on_clock``.

    Raises
    ------
    JobError, ArgumentError
        As `check_model` raises; and if times are given with a job.
    """
    job = as_job(model) if _is_job(model) else None
    own = (HORIZON, PARTICLES)
    if job is not None:
        own = (
            job.problem.feasible.horizon,
            PARTICLES if job.filter.is_automatic else job.filter.particles,
        )
    instants = whole_argument("horizon", own[0] if horizon is None else horizon, 1, MOST_INSTANTS)
    count = whole_argument(
        "particles", own[1] if particles is None else particles, 1, MOST_PARTICLES
    )
    if job is not None:
        if times:
            raise ArgumentError("a job has a clock of its own, got times, too", argument="times")
        return _checks_of_job(job, instants, count)
    if isinstance(model, str):
        return check_named(model, instants, count, times=times)
    if isinstance(model, StateSpaceModel):
        return _checks_of_object(model, instants, count)
    raise ArgumentError(
        "a model must be a StateSpaceModel, the name of a model, a problem or a job, got "
        f"{shown(model)}",
        argument="model",
    )


def _is_job(model: StateSpaceModel | JobSource) -> TypeGuard[JobSource]:
    is_file = isinstance(model, Path) or (isinstance(model, str) and model.endswith(".toml"))
    return is_file or isinstance(model, Problem | Job)


def _checks_of_job(job: Job, horizon: int, particles: int) -> Iterator[Check]:
    """Check the models of a job, with its parameters."""
    try:
        model, filter_model = models_of(job)
    except ModelError as error:
        yield Check("load", "wrong", str(error))
        return
    clock = job.problem.clock.times if job.problem.has_clock else ()
    yield from _checks_of(model, horizon, particles, clock)
    if filter_model.key != model.key:
        for check in _checks_of(filter_model, horizon, particles, clock):
            yield replace(check, name=f"filter: {check.name}")


def _checks_of_object(model: StateSpaceModel, horizon: int, particles: int) -> Iterator[Check]:
    try:
        carried(model, f"{PYTHON}{model.name}")
    except ModelError as error:
        yield Check("load", "wrong", str(error))
    else:
        yield from check_object(model, horizon, particles)


def _checks_of(
    model: CarriedModel, horizon: int, particles: int, clock: Sequence[Time]
) -> Iterator[Check]:
    try:
        loaded = model.model
        if clock:
            loaded, horizon = loaded.on_clock(clock), min(horizon, len(clock) - 1)
    except ModelError as error:
        yield Check("load", "wrong", str(error))
    else:
        yield from check_object(loaded, horizon, particles)
