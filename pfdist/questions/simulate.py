"""Simulated draws of a problem's model as a table."""

from typing import Annotated

import numpy as np
import pandas as pd
from pydantic import Field

from pfdist.common.section import Whole, checked
from pfdist.common.streams import stream_of
from pfdist.errors import ArgumentError
from pfdist.filters.draws import Draws
from pfdist.filters.engines import ENGINES
from pfdist.models import StateSpaceModel
from pfdist.problem.clock import Clock
from pfdist.problem.problem import JobSource, as_job
from pfdist.runner.build import build
from pfdist.store.schema import LABELS, labels_of

DRAWS = 100
MOST_NUMBERS = 50_000_000  # of a table


@checked
def simulate(
    problem: JobSource,
    draws: Annotated[Whole, Field(ge=1, le=10_000_000)] = DRAWS,
    seed: int | None = None,
) -> pd.DataFrame:
    """Simulated draws of a problem's model: states, measurements and quantities of interest.

    Parameters
    ----------
    problem : Problem, Job, str or Path
        A job file, as ``jobs/plan.toml``, or the folder of a run.
    draws : int
        The number of draws. A larger number begins with the same draws.
    seed : int, optional
        By default the seed of the job; 0 for a problem.

    Returns
    -------
    DataFrame
        A row for each draw and instant: draw, t (on the clock, if there is one), the states x_0,
        x_1, ..., the measurements y_0, ... that could be made at every instant, and the quantities
        of interest z_0, ... If the model names components, columns have the names instead of the
        numbers, and the attribute ``labels`` has names and units. With a clock, the attribute
        ``time_unit`` has its unit.

    Raises
    ------
    JobError, ModelError
        The job or its model is not possible, or a formula failed.
    ArgumentError
        There are fewer than 1 draws, or more than fit into a table.
    """
    # Draws depend on no filter, so neither particles nor a proposal need be found.
    job = as_job(problem, settings={"seed": seed, "filter": {"particles": 1, "proposal": "plain"}})
    built = build(job)
    model, horizon = built.evaluator.model, built.evaluator.horizon
    numbers = draws * (horizon + 1) * (2 + sum(model.components))
    if numbers > MOST_NUMBERS:
        most = MOST_NUMBERS * draws // numbers
        raise ArgumentError(
            f"draws must be at most {most:,} for a table of {MOST_NUMBERS:,} numbers, got "
            f"{draws:,}",
            argument="draws",
        )
    engine = ENGINES[built.evaluator.engine]
    simulated = engine.simulate(model, horizon, range(draws), stream_of("simulate", job.seed))
    return _table(simulated, model, job.problem.clock)


def _table(draws: Draws, model: StateSpaceModel, clock: Clock) -> pd.DataFrame:
    count, instants = len(draws.index), draws.instants
    columns = {
        "draw": np.repeat(np.array(draws.index), len(instants)),
        **{name: np.tile(values, count) for name, values in clock.columns(instants).items()},
    }
    labels = dict[str, str]()
    for name, values in (("x", draws.x), ("y", draws.y), ("z", draws.z)):
        components = model.named(name)
        labels |= labels_of(f"{name}_", components)
        for k, component in enumerate(components):
            columns[f"{name}_{component.suffix}"] = values[:, :, k].ravel()
    table = pd.DataFrame(columns)
    if labels:
        table.attrs[LABELS] = labels
    if not clock.counts:
        table.attrs["time_unit"] = clock.time_unit
    return table
