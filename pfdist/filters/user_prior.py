"""A user's prior, as an array or as a table of particles."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pfdist.common.rounding import unrounded
from pfdist.errors import MeasurementTimesError, PriorError, shown
from pfdist.filters.cloud import Cloud, Gaussian, Prior
from pfdist.models import StateSpaceModel
from pfdist.store.user_tables import NO_READERS, read_user_table

Array = NDArray[np.float64]


def _counted(t: float) -> int:
    if not t.is_integer():
        raise PriorError(f"t must be one integer for all particles, got {unrounded(t)}")
    return int(t)


def as_prior(
    prior: Any,
    model: StateSpaceModel,
    readers: Mapping[str, Callable[[str], float]] = NO_READERS,
    instant: Callable[[float], int] = _counted,
) -> Prior | None:
    """The prior of a model, from a prior, particles in an array, or a table.

    An array holds particles of x at the first instant, a row a component and a column a particle. A
    DataFrame, or the file of a table, holds a particle in each row, as `read_prior` reads it. The
    t of a `Cloud` or a `Gaussian` is an instant. Raises `PriorError` for anything else, or if a
    number is not finite.
    """
    if prior is None or isinstance(prior, Cloud | Gaussian):
        return prior
    if isinstance(prior, pd.DataFrame | Path):
        return read_prior(prior, model, readers, instant)
    try:
        x = np.array(prior, np.float64)
    except (TypeError, ValueError) as error:
        raise PriorError(
            "a prior must be a Cloud, a DataFrame or an array (components, particles), got "
            f"{shown(prior)}"
        ) from error
    return Cloud(0, x[None] if x.ndim == 1 else x)


def read_prior(
    path: Path | pd.DataFrame,
    model: StateSpaceModel,
    readers: Mapping[str, Callable[[str], float]] = NO_READERS,
    instant: Callable[[float], int] = _counted,
) -> Cloud:
    """Particles from a table in Parquet or CSV, or in memory, a row a particle.

    The columns are x0, x1, ..., or x_ with the names that the model gives to the states. There may
    also be columns weight (in any unit; else all are equal) and t, the same in all rows; without
    it, the first instant is used. `instant` gives the instant of t, and `readers` are those of
    `read_user_table`. Raises `PriorError` if the file cannot be read, if its columns do not fit, or
    if a value is wrong.
    """
    allowed = user_columns("x", model)
    try:
        columns = read_user_table(path, partial(_check_header, allowed), readers=readers)
        states = next(names for names in allowed if names[0] in columns)
        x = np.stack([columns[name] for name in states])
        t = columns.get("t", np.empty(0))
        for other in t[t != t[:1]][:1]:
            raise PriorError(f"t must be one time for all particles, got {unrounded(other)}")
        return Cloud(instant(float(t[0])) if t.size else 0, x, columns.get("weight"))
    except (PriorError, MeasurementTimesError, ValueError) as error:
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


def user_columns(kind: str, model: StateSpaceModel) -> list[list[str]]:
    """The lists of columns that a table of x or y may have: x0, x1, ..., or names; one may be x.

    Components without names have the second as `pfdist.simulate` writes them: x_0, x_1, ...
    """
    components = model.named(kind)
    numbered = [f"{kind}{number}" for number in range(len(components))]
    named = [f"{kind}_{each.suffix}" for each in components]
    return [numbered, named, *[[kind]] * (len(components) == 1)]
