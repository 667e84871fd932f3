"""A prior that a user brings, as an array or as a table of particles."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pfdist.errors import PriorError, shown
from pfdist.filters.cloud import Cloud, Gaussian, Prior
from pfdist.models import StateSpaceModel
from pfdist.sequential.user_columns import user_columns
from pfdist.store.user_tables import read_user_table

Array = NDArray[np.float64]


def as_prior(prior: Any, model: StateSpaceModel) -> Prior:
    """Give a prior of a model from what a user has: a prior, particles in an array, or a table.

    An array holds particles of x(0), a row a component and a column a particle. A DataFrame holds a
    particle in each row, as `read_prior` reads it.

    Raises
    ------
    PriorError
        It is neither a prior nor an array of finite numbers.
    """
    if isinstance(prior, Cloud | Gaussian):
        return prior
    if isinstance(prior, pd.DataFrame):
        return read_prior(prior, model)
    try:
        x = np.array(prior, np.float64)
    except (TypeError, ValueError) as error:
        raise PriorError(
            "a prior must be a Cloud, a DataFrame or an array (components, particles), got "
            f"{shown(prior)}"
        ) from error
    return Cloud(0, x[None] if x.ndim == 1 else x)


def read_prior(path: Path | pd.DataFrame, model: StateSpaceModel) -> Cloud:
    """Read particles from a table in Parquet or CSV, a row a particle.

    The columns are x0, x1, ..., or x_ with the names that the model gives to the states, and on
    request weight (in any unit; else all are equal) and t, the instant of the states, the same in
    all rows (else 0).

    Parameters
    ----------
    path : Path or DataFrame
    model : StateSpaceModel
        The model that has these states.

    Raises
    ------
    PriorError
        The file cannot be read, its columns do not fit, or a value is wrong.
    """
    allowed = user_columns("x", model)
    try:
        columns = read_user_table(path, partial(_check_header, allowed))
        states = next(names for names in allowed if names[0] in columns)
        x = np.stack([columns[name] for name in states])
        return Cloud(_instant(columns.get("t")), x, columns.get("weight"))
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


def _instant(column: Array | None) -> int:
    if column is None or not column.size:
        return 0
    t = float(column[0])
    if not t.is_integer() or (column != t).any():
        other = column[np.argmax(column != t)] if t.is_integer() else t
        raise PriorError(f"t must be one integer for all particles, got {other:g}")
    return int(t)
