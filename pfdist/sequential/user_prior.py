"""A prior that a user brings, as an array or as a table of particles."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.errors import PriorError, shown
from pfdist.filters.cloud import Cloud, Gaussian, Prior
from pfdist.models import StateSpaceModel
from pfdist.store.user_tables import read_user_table

Array = NDArray[np.float64]


def as_prior(prior: Any) -> Prior:
    """Give a prior; an array holds particles of x(0), a row a component and a column a particle.

    Raises
    ------
    PriorError
        It is neither a prior nor an array of finite numbers.
    """
    if isinstance(prior, Cloud | Gaussian):
        return prior
    try:
        x = np.array(prior, np.float64)
    except (TypeError, ValueError) as error:
        raise PriorError(
            f"a prior must be a Cloud or an array (components, particles), got {shown(prior)}"
        ) from error
    return Cloud(0, x[None] if x.ndim == 1 else x)


def read_prior(path: Path, model: StateSpaceModel) -> Cloud:
    """Read particles from a table in Parquet or CSV, a row a particle.

    The columns are x0, x1, ..., and on request weight (in any unit; else all are equal) and t, the
    instant of the states, the same in all rows (else 0).

    Parameters
    ----------
    path : Path
    model : StateSpaceModel
        The model that has these states.

    Raises
    ------
    PriorError
        The file cannot be read, its columns do not fit, or a value is wrong.
    """
    states = [f"x{component}" for component in range(model.components[0])]
    try:
        columns = read_user_table(path, partial(_check_header, states))
        x = np.stack([columns[name] for name in states])
        return Cloud(_instant(columns.get("t")), x, columns.get("weight"))
    except (PriorError, ValueError) as error:
        raise PriorError(f"{path}: {error}") from error
    except OSError as error:
        raise PriorError(f"cannot read {path}: {error.strerror or error}") from error


def _check_header(states: list[str], header: list[str]) -> None:
    lacking = [name for name in states if name not in header]
    unknown = [name for name in header if name not in (*states, "weight", "t")]
    if lacking or unknown:
        raise PriorError(
            f"the columns must be {', '.join(states)}, and may be weight and t, "
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
