"""Measured values of one system, checked one by one or read from a table."""

from dataclasses import dataclass
from functools import partial
from itertools import chain, pairwise
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times
from pfdist.errors import MeasurementsError, MeasurementTimesError, shown
from pfdist.filters.one_filter import checked_instant, checked_measurement, made, plain_number
from pfdist.filters.user_prior import user_columns
from pfdist.models import StateSpaceModel
from pfdist.problem.clock import Clock
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
            columns = _side_by_side(columns, model, clock)
            allowed = [["t", *(f"y{component}" for component in range(model.components[1]))]]
        wanted = next(names for names in allowed if names[1] in columns)
        components = _components_of_sensors(model) if sensors else wanted[1:]
        times = [instant_on(clock, t, start) for t in columns["t"].tolist()]
        for t, following in pairwise(sorted(times)):
            if t == following:
                repeated = clock.text(clock.times[t])
                raise MeasurementsError(f"each time must have one row, got t = {repeated} twice")
        table = np.stack([columns[name] for name in wanted[1:]], axis=1)
        rows = [
            (t, checked_measurement(table[row], model, clock.text(clock.times[t]), components))
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


def _side_by_side(
    columns: dict[str, Array], model: StateSpaceModel, clock: Clock
) -> dict[str, Array]:
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
                f"a sensor must have one row for each time, got {name} at t = {clock.text(t)} twice"
            )
        if not np.isnan(given[count:]).all():
            raise MeasurementsError(
                f"the sensor {name} must have {count} components of y, got more at t = "
                f"{clock.text(t)}"
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
        instant = clock.instant(plain_number(t), "t")
    except MeasurementTimesError as error:
        raise MeasurementsError(str(error)) from error
    if instant < start:
        raise MeasurementsError(
            f"t must lie in {clock.text(clock.times[start])}.."
            f"{clock.formatted(clock.horizon)}, got {clock.text(clock.times[instant])}"
        )
    return instant


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
