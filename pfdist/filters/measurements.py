"""Measured values of one system, checked one by one or read from a table."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import chain, pairwise
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pfdist.common.clock import Clock
from pfdist.common.formatted_times import formatted_time
from pfdist.common.measurement_times import Times
from pfdist.errors import MeasurementsError, MeasurementTimesError, shown
from pfdist.filters.one_filter import made
from pfdist.models import StateSpaceModel
from pfdist.store.user_tables import SEPARATORS, read_user_table

Array = NDArray[np.float64]
_FURTHER = 10_000  # rows


@dataclass(frozen=True)
class Measurements:
    """Measurements of one system, in the order of time."""

    t: tuple[int, ...]  # (K,); the instants that were measured
    y: Array  # (K, m); NaN marks a component that is missing
    missed: tuple[int, ...] = ()  # instants that have a row without any component

    def made_with(self, model: StateSpaceModel) -> Times:
        """The possible measurements that were made; without sensors, these are instants."""
        rows = zip(self.t, self.y, strict=True)
        return tuple(chain.from_iterable(made(model, t, y) for t, y in rows))


def read_measurements(
    path: Path | pd.DataFrame, model: StateSpaceModel, clock: Clock, start: int = 0
) -> Measurements:
    """Measurements from a table with the columns t, y0, y1, ..., with rows in any order.

    The table is a file in CSV or Parquet, or in memory. If the model names the components of y,
    columns may have the names: y_concentration. The column t has times on the clock, and `start` is
    the first instant that can be measured. A row without any component is a time that was not
    measured. Raises `MeasurementsError` if the file cannot be read, if its header does not fit, or
    if a value is wrong.
    """
    allowed, sensors = [["t", *names] for names in user_columns("y", model)], [*model.sensors]
    if sensors:
        most = max(part.model.components[1] for part in model.parts)
        allowed = [["t", "sensor", *(f"y{component}" for component in range(most))]]
    try:
        check = partial(_check_header, allowed)
        # Each time has one row; the first of a few rows too many is named below.
        most = _FURTHER + model.points.first(len(clock.times))
        columns = read_user_table(path, check, (), {"sensor": sensors}, clock.readers(), most)
        for row, t in enumerate(columns["t"].tolist(), 1):
            try:
                instant_on(clock, t, start)
            except MeasurementsError as error:
                raise MeasurementsError(f"{error} (row {row})") from error
        if sensors:
            columns = _side_by_side(columns, model, clock.unit)
            allowed = [["t", *(f"y{component}" for component in range(model.components[1]))]]
        wanted = next(names for names in allowed if names[1] in columns)
        components = _components_of_sensors(model) if sensors else wanted[1:]
        times = [instant_on(clock, t, start) for t in columns["t"].tolist()]
        for t, following in pairwise(sorted(times)):
            if t == following:
                repeated = formatted_time(clock.time(t))
                raise MeasurementsError(f"each time must have one row, got t = {repeated} twice")
        table = np.stack([columns[name] for name in wanted[1:]], axis=1)
        rows = [
            (t, checked_measurement(table[row], model, formatted_time(clock.time(t)), components))
            for row, t in sorted(enumerate(times), key=itemgetter(1))
        ]
    except (MeasurementsError, ValueError) as error:
        where = "measurements" if isinstance(path, pd.DataFrame) else path
        raise MeasurementsError(f"{where}: {error}") from error
    except OSError as error:
        raise MeasurementsError(f"cannot read {path}: {error.strerror or error}") from error
    measured = {t: y for t, y in rows if y is not None}
    return Measurements(
        tuple(measured),
        np.array(list(measured.values())).reshape(-1, model.components[1]),
        tuple(t for t, y in rows if y is None),
    )


def _components_of_sensors(model: StateSpaceModel) -> list[str]:
    """The components of y as a table names them: by their column and the sensor of their row."""
    return [
        f"y{column} of {part.name}"
        for part in model.parts
        for column in range(part.model.components[1])
    ]


def _side_by_side(columns: dict[str, Array], model: StateSpaceModel, unit: str) -> dict[str, Array]:
    """Columns with a row for each time, and all components of y, from a row for each sensor."""
    times = np.unique(columns["t"])
    y = np.full((times.size, model.components[1]), np.nan)
    seen = set[tuple[float, int]]()
    for row, (t, sensor) in enumerate(zip(columns["t"].tolist(), columns["sensor"], strict=True)):
        name, alone, own, _ = model.parts[int(sensor)]
        count = alone.components[1]
        given = np.array([column[row] for key, column in columns.items() if key[0] == "y"])
        if (t, sensor) in seen:
            raise MeasurementsError(
                f"a sensor must have one row for each time, got {name} at t = "
                f"{formatted_time(t, unit)} twice"
            )
        if not np.isnan(given[count:]).all():
            raise MeasurementsError(
                f"the sensor {name} must have {count} components of y, got more at t = "
                f"{formatted_time(t, unit)}"
            )
        seen.add((t, sensor))
        y[times == t, own] = given[:count]
    return {"t": times} | {f"y{component}": y[:, component] for component in range(y.shape[1])}


def instant_on(clock: Clock, t: Any, start: int = 0) -> int:
    """The checked instant of a time on a clock.

    Raises `MeasurementsError` if no instant has this time, or if it lies before the instant
    `start`.
    """
    if clock.counts:
        return checked_instant(t, start, clock.horizon)
    try:
        instant = clock.instant(_plain(t), "t")
    except MeasurementTimesError as error:
        raise MeasurementsError(str(error)) from error
    if instant < start:
        raise MeasurementsError(
            f"t must lie in {formatted_time(clock.time(start))}.."
            f"{clock.formatted(clock.horizon)}, got {formatted_time(clock.time(instant))}"
        )
    return instant


def checked_instant(t: Any, start: int, horizon: int) -> int:
    """A checked instant as an int.

    Raises `MeasurementsError` if it is not a whole number, or lies outside start..horizon.
    """
    number = isinstance(t, int | float | np.integer | np.floating) and not isinstance(t, bool)
    if not number or t != t // 1:
        raise MeasurementsError(f"t must be an integer, got {shown(_plain(t))}")
    if not start <= t <= horizon:
        raise MeasurementsError(f"t must lie in {start}..{horizon}, got {shown(int(t))}")
    return int(t)


def checked_measurement(
    y: float | Sequence[float] | Array, model: StateSpaceModel, t: str, names: Sequence[str] = ()
) -> Array | None:
    """A checked measurement as an array (m,); None if every component is missing.

    `t` and `names` are the time and the components in error messages. Raises `MeasurementsError` if
    the number of components is wrong, if one is not a finite number, or if one is missing and the
    model does not declare `missing_components`.
    """
    components = model.components[1]
    try:
        values = np.atleast_1d(np.array(y, np.float64))
    except (TypeError, ValueError, OverflowError):
        values = np.empty(0)
    if y is None or values.shape != (components,):
        raise MeasurementsError(
            f"a measurement must have as many numbers as y of the model {model.name}, "
            f"{components}, got {shown(y)} at t = {t}"
        )
    names = names or [f"y[{component}]" for component in range(components)]
    infinite = np.flatnonzero(np.isinf(values))
    if infinite.size:
        raise MeasurementsError(
            f"a measurement must be finite, or NaN where a component is missing, got "
            f"{names[infinite[0]]} = {values[infinite[0]]} at t = {t}"
        )
    missing = np.flatnonzero(np.isnan(values))
    if missing.size == components:
        return None
    # A sensor that lacks all of its components did not measure.
    idle = [part.y for part in model.parts if np.isnan(values[part.y]).all()]
    partly = [k for k in missing.tolist() if not any(y.start <= k < y.stop for y in idle)]
    if partly and not model.missing_components:
        raise MeasurementsError(
            f"all components of y must be measured or none, got {names[partly[0]]} missing at "
            f"t = {t}: the model {model.name} does not declare missing_components=True, that is, "
            "that its log_likelihood takes NaN"
        )
    return values


def _check_header(allowed: list[list[str]], header: list[str]) -> None:
    if sorted(header) in map(sorted, allowed):
        return
    choices = " or ".join(map(", ".join, allowed))
    text = f"the columns must be {choices}, got {shown(', '.join(header))}"
    if len(header) == 1 and any(separator in header[0] for separator in ";\t|"):
        text += f"; {SEPARATORS}"
    elif header and header[0][:1].isdigit():
        text += "; the first line must name the columns"
    raise MeasurementsError(text)


def _plain(value: Any) -> Any:
    """A number of NumPy as Python writes it."""
    return value.item() if isinstance(value, np.generic) else value


def user_columns(kind: str, model: StateSpaceModel) -> list[list[str]]:
    """The lists of columns that a table of x or y may have: x0, x1, ..., or names.

    There is a second list if the model names these components.
    """
    components = model.named(kind)
    numbered = [f"{kind}{number}" for number in range(len(components))]
    named = [f"{kind}_{each.suffix}" for each in components if each.name]
    return [numbered, named] if named else [numbered]
