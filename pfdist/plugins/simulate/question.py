"""Simulated draws of a problem's model as a table."""

from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import pyarrow as pa
from pydantic import Field

from pfdist.common.arguments import path_argument
from pfdist.common.section import Whole, checked
from pfdist.common.streams import stream_of
from pfdist.errors import ArgumentError
from pfdist.filters.draws import Draws
from pfdist.filters.engines import ENGINES
from pfdist.models import StateSpaceModel
from pfdist.models.sensed import known_values
from pfdist.problem.clock import Clock
from pfdist.problem.problem import JobSource, as_job
from pfdist.runner.build import Built, build
from pfdist.store.schema import LABELS, labels_of
from pfdist.store.user_tables import write_user_table

DRAWS = 100
MOST_NUMBERS = 50_000_000  # of a table
_TITLE = "pfdist: simulated systems"


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
    return _simulated(_built(problem, (), seed), draws)


@checked
def write_simulated(
    job: JobSource,
    out: str | Path,
    draws: Annotated[Whole, Field(ge=1, le=10_000_000)] = DRAWS,
    seed: int | None = None,
    changes: Iterable[str] = (),
) -> tuple[Path, Path]:
    """The table of `simulate` in a file, CSV or Parquet, and beside it a PNG file with its picture.

    They replace those of an earlier call, and no other file.
    """
    # Not above: the help of the command waits for no Matplotlib.
    from pfdist.pages.figure import check_figure_replaceable, save_plot  # noqa: PLC0415
    from pfdist.pages.system import simulated_plot  # noqa: PLC0415

    path, built = path_argument("out", out), _built(job, changes, seed)
    picture = path.with_suffix(".png")
    if path == picture:
        raise ArgumentError(f"out must end in .csv or .parquet, got {path}", argument="out")
    check_figure_replaceable(picture, _TITLE)
    frame = _simulated(built, draws)
    table = pa.Table.from_pandas(frame, preserve_index=False)
    write_user_table(path, table.replace_schema_metadata({"table": "simulated"}))
    save_plot(picture, simulated_plot(frame, built.evaluator.model.is_angle), _TITLE)
    return path, picture


def _built(problem: JobSource, changes: Iterable[str], seed: int | None) -> Built:
    # Draws depend on no filter, so neither particles nor a proposal need be found.
    plain = {"particles": 1, "proposal": "plain"}
    return build(as_job(problem, changes, settings={"seed": seed, "filter": plain}))


def _simulated(built: Built, draws: int) -> pd.DataFrame:
    job = built.job
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
    for name, values in (("x", draws.x), ("y", known_values(draws.y)), ("z", draws.z)):
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
