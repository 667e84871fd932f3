"""Measured values of one system: checked one by one, or read from a table."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.errors import MeasurementsError, shown
from pfdist.models import StateSpaceModel
from pfdist.store.user_tables import read_user_table

Array = NDArray[np.float64]

_TIME_WORDS = {"time", "instant", "step", "times", "k"}  # headers that probably mean t


@dataclass(frozen=True)
class Measurements:
    """Measurements of one system, in the order of time.

    Parameters
    ----------
    t : tuple of int, (K,)
        The instants that were measured.
    y : array of float64, (K, m)
        The measurements; NaN marks a component that is missing.
    missed : tuple of int
        The instants that have a row without any component: they were not measured.
    """

    t: tuple[int, ...]
    y: Array
    missed: tuple[int, ...] = ()


def read_measurements(
    path: Path, model: StateSpaceModel, horizon: int, start: int = 0
) -> Measurements:
    """Read a table with the columns t, y0, y1, ..., in CSV or Parquet, with rows in any order.

    A row without any component is a time that was not measured.

    Parameters
    ----------
    path : Path
    model : StateSpaceModel
        The model that has these measurements.
    horizon : int
        T.
    start : int
        The first instant that can be measured.

    Raises
    ------
    MeasurementsError
        The file cannot be read, its header does not fit, or a value is wrong.
    """
    wanted = ["t", *(f"y{component}" for component in range(model.components[1]))]
    try:
        columns = read_user_table(path, partial(_check_header, wanted))
        times = [checked_instant(t, start, horizon) for t in columns["t"].tolist()]
        for t, following in pairwise(sorted(times)):
            if t == following:
                raise MeasurementsError(f"a time must stand in one row, got t = {t} twice")
        table = np.stack([columns[name] for name in wanted[1:]], axis=1)
        rows = [
            (times[row], checked_measurement(table[row], model, times[row]))
            for row in np.argsort(times, kind="stable")
        ]
    except (MeasurementsError, ValueError) as error:
        raise MeasurementsError(f"{path}: {error}") from error
    except OSError as error:
        raise MeasurementsError(f"cannot read {path}: {error.strerror or error}") from error
    measured = {t: y for t, y in rows if y is not None}
    return Measurements(
        tuple(measured),
        np.array(list(measured.values())).reshape(-1, len(wanted) - 1),
        tuple(t for t, y in rows if y is None),
    )


def checked_instant(t: Any, start: int, horizon: int) -> int:
    """Give an instant as an int, after checking it.

    Raises
    ------
    MeasurementsError
        It is no whole number, or lies outside start..horizon.
    """
    number = isinstance(t, int | float | np.integer | np.floating) and not isinstance(t, bool)
    if not number or t != t // 1:
        raise MeasurementsError(f"t must be an integer, got {shown(_plain(t))}")
    if not start <= t <= horizon:
        raise MeasurementsError(f"t must lie in {start}..{horizon}, got {shown(int(t))}")
    return int(t)


def checked_measurement(
    y: float | Sequence[float] | Array, model: StateSpaceModel, t: int
) -> Array | None:
    """Give a measurement as an array (m,), after checking it; None if every component is missing.

    Raises
    ------
    MeasurementsError
        It has another number of components than the model, or a component is no finite number. Or
        a component is missing, and the model does not declare that it takes such measurements.
    """
    components = model.components[1]
    if y is None:
        raise MeasurementsError(f"a measurement must be a number, got None at t = {t}")
    try:
        values = np.atleast_1d(np.array(y, np.float64))
    except (TypeError, ValueError, OverflowError) as error:
        raise MeasurementsError(
            f"a measurement must be a number or a sequence of numbers, got {shown(y)} at t = {t}"
        ) from error
    if values.shape != (components,):
        got = str(values.size) if values.ndim == 1 else f"an array of shape {values.shape}"
        raise MeasurementsError(
            f"a measurement must have as many components as y of the model {model.name}, "
            f"{components}, got {got} at t = {t}"
        )
    infinite = np.flatnonzero(np.isinf(values))
    if infinite.size:
        raise MeasurementsError(
            f"a measurement must be finite, or NaN where a component is missing, got "
            f"y[{infinite[0]}] = {values[infinite[0]]} at t = {t}"
        )
    missing = np.flatnonzero(np.isnan(values))
    if missing.size == components:
        return None
    if missing.size and not model.missing_components:
        raise MeasurementsError(
            f"all components of y must be measured or none, got y[{missing[0]}] missing at "
            f"t = {t}: the model {model.name} does not declare missing_components=True, which says "
            "that its log_likelihood takes NaN"
        )
    return values


def _check_header(wanted: list[str], header: list[str]) -> None:
    if sorted(header) == sorted(wanted):
        return
    allowed = ", ".join(wanted)
    text = f"the columns must be {allowed}, got {shown(', '.join(header))}"
    hints = [
        f"{meant} in the place of {name}"
        for name in header
        if (meant := _meant(name, wanted)) and meant not in header
    ]
    if len(header) == 1 and any(separator in header[0] for separator in ";\t|"):
        text += "; the separator of columns is the comma"
    elif hints:
        text += f"; write {', '.join(hints)}"
    elif _is_number(header[0]):
        text += "; the first line must name the columns"
    raise MeasurementsError(text)


def _meant(name: str, wanted: list[str]) -> str:
    """Give the column that a wrong name probably means; empty if there is none."""
    if name in wanted:
        return ""
    plain = name.lower().replace("_", "").replace("[", "").replace("]", "").replace(" ", "")
    if plain in _TIME_WORDS:
        return "t"
    if plain == "y" and wanted[1:] == ["y0"]:
        return "y0"
    return plain if plain in wanted else ""


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def _plain(value: Any) -> Any:
    """Give a number of NumPy as Python writes it."""
    return value.item() if isinstance(value, np.generic) else value
