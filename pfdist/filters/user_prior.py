"""A user's prior, as an array or as a table of particles."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pfdist.common.clock import Clock
from pfdist.common.formatted_times import formatted_time
from pfdist.errors import MeasurementTimesError, PriorError, shown
from pfdist.filters.cloud import Cloud, Gaussian, Prior
from pfdist.filters.measurements import user_columns
from pfdist.models import StateSpaceModel
from pfdist.store.user_tables import read_user_table

Array = NDArray[np.float64]


def as_prior(prior: Any, model: StateSpaceModel, clock: Clock | None = None) -> Prior:
    """The prior of a model, from a prior, particles in an array, or a table.

    An array holds particles of x at the first instant, a row a component and a column a particle. A
    DataFrame holds a particle in each row, as `read_prior` reads it. The t of a `Cloud` or a
    `Gaussian` is an instant, even if there is a clock. Raises `PriorError` for anything else, or if
    a number is not finite.
    """
    if isinstance(prior, Cloud | Gaussian):
        return prior
    if isinstance(prior, pd.DataFrame):
        return read_prior(prior, model, clock)
    try:
        x = np.array(prior, np.float64)
    except (TypeError, ValueError) as error:
        raise PriorError(
            "a prior must be a Cloud, a DataFrame or an array (components, particles), got "
            f"{shown(prior)}"
        ) from error
    return Cloud(0, x[None] if x.ndim == 1 else x)


def read_prior(
    path: Path | pd.DataFrame, model: StateSpaceModel, clock: Clock | None = None
) -> Cloud:
    """Particles from a table in Parquet or CSV, or in memory, a row a particle.

    The columns are x0, x1, ..., or x_ with the names that the model gives to the states. There may
    also be columns weight (in any unit; else all are equal) and t. The column t has the time of the
    states on the clock, or their instant without a clock. It is the same in all rows; without it,
    the first instant is used. Raises `PriorError` if the file cannot be read, if its columns do not
    fit, or if a value is wrong.
    """
    allowed = user_columns("x", model)
    try:
        readers = clock.readers() if clock else {}
        columns = read_user_table(path, partial(_check_header, allowed), readers=readers)
        states = next(names for names in allowed if names[0] in columns)
        x = np.stack([columns[name] for name in states])
        return Cloud(_instant(columns.get("t"), clock), x, columns.get("weight"))
    except (PriorError, ValueError) as error:
        where = "prior" if isinstance(path, pd.DataFrame) else path
        raise PriorError(f"{where}: {error}") from error
    except OSError as error:
        raise PriorError(f"cannot read {path}: {error.strerror or error}") from error


def _check_header(allowed: list[list[str]], header: list[str]) -> None:
    if {name for name in header if name not in ("weight", "t")} not in map(set, allowed):
        raise PriorError(
            f"the columns must be {' or '.join(map(', '.join, allowed))}, and may be weight and t, "
            f"got {shown(', '.join(header))}"
        )


def _instant(column: Array | None, clock: Clock | None) -> int:
    if column is None or not column.size:
        return 0
    t = float(column[0])
    counts = clock is None or clock.counts
    if (counts and not t.is_integer()) or (column != t).any():
        kind = "integer" if counts else "time"
        other = column[np.argmax(column != t)] if t.is_integer() or not counts else t
        raise PriorError(f"t must be one {kind} for all particles, got {formatted_time(other)}")
    if clock is None or clock.counts:
        return int(t)
    try:
        return clock.instant(t, "t")
    except MeasurementTimesError as error:
        raise PriorError(str(error)) from error
