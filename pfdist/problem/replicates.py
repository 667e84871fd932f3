"""Measurements of many systems, the replicates, read from one long table."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pfdist.common.measurement_times import CLOCK, Times
from pfdist.common.nearest import must_be
from pfdist.errors import MeasurementsError, MeasurementTimesError, shown
from pfdist.filters.user_prior import user_columns
from pfdist.models import StateSpaceModel
from pfdist.models.parameters import Parameter
from pfdist.problem.clock import Clock
from pfdist.problem.measurements import (
    COMPONENT,
    PLAIN_READING,
    RENAME,
    Reading,
    given_at,
    instants_of_table,
    note_unread,
    parameters_at,
    read_measurements,
    series_at,
    tell_failures,
)
from pfdist.problem.points import Points
from pfdist.store.user_tables import SEPARATORS, read_user_table

Array = NDArray[np.float64]
USED = "an earlier time uses"
TRAIN = "train"
"""Column that marks replicates to which the model was fitted."""


@dataclass(frozen=True, eq=False)
class Replicate:
    """One system: a patient, a day, a year.

    Parameters
    ----------
    name : str
    clock : Clock
        That of the job, or of the replicate's own times.
    y : array of float64, (T+1, m)
        Measurements; NaN marks a component that was not measured. Repeats follow each other.
    z : array of float64, (T+1, q), optional
        Known values of the quantity of interest, NaN elsewhere.
    parameters : mapping of str to float or tuple of float
        Values of the model's parameters for this system, or covariates at each instant.
    is_training : bool
        Whether the model was fitted to it.
    has_own_clock : bool
    """

    name: str
    clock: Clock
    y: Array
    z: Array | None = None
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    is_training: bool = False
    has_own_clock: bool = False

    @property
    def key(self) -> tuple[Any, ...]:
        """Replicates of the same key have the same parameters, and the same clock."""
        return tuple(self.parameters.items()), self.clock.times

    def measured(self, model: StateSpaceModel) -> Times:
        """The possible measurements that were made."""
        parts = [~np.isnan(self.y[:, each.y]).all(axis=1) for each in model.ways]
        return tuple(np.flatnonzero(np.stack(parts, axis=1).ravel()).tolist())

    def nearest(
        self, wanted: Iterable[tuple[float, int]], points: Points, model: StateSpaceModel,
        within: float,
    ) -> Times:  # fmt: skip
        """The measurements that are nearest to wanted times, by the same sensors; sorted.

        Each is used once, by the earlier wanted time.

        Parameters
        ----------
        wanted : iterable of (float, int)
            Times with the number of a sensor.
        points : Points
            The possible measurements on the clock of the replicate.
        model : StateSpaceModel
        within : float
            The largest distance in time.

        Raises
        ------
        MeasurementsError
            There is no measurement within this distance.
        """
        measured, chosen = self.measured(model), list[int]()
        made = {each: points.clock.times[points.made_at(each)] for each in measured}
        for time, way in wanted:
            free = [each for each in measured if points.way(each) == way and each not in chosen]
            away = [abs(made[each] - time) for each in free]
            if not away or min(away) > within + self.clock.slack:
                name = f" by {model.ways[way].name}" if model.sensors else ""
                at = self.clock.text(time) if self.clock.has_dates else f"{time:.4g}"
                used = (e for e in chosen if points.way(e) == way and abs(made[e] - time) <= within)
                but = f", but one that {USED}" * any(True for _ in used)
                raise MeasurementsError(
                    f"no measurement{name} within {self.clock.duration(within)} of t = {at}{but}"
                )
            chosen.append(free[int(np.argmin(away))])
        return tuple(sorted(chosen))


def read_replicates(
    source: Path | pd.DataFrame, column: str, model: StateSpaceModel, clock: Clock,
    parameters: Sequence[str], reading: Reading = PLAIN_READING,
) -> list[Replicate]:  # fmt: skip
    """The replicates of a long table in the order of their first rows.

    Parameters
    ----------
    source : Path or DataFrame
        A table with a row for each time, and for each sensor if there are any. Its columns are that
        of the replicate, those of `read_measurements`, and if wanted ``z0, z1, ...`` (or
        ``z_NAME``) with known quantities of interest, ``train`` (0 or 1), and parameters.
    column : str
        Column with the name of the replicate; if it is empty, the first column.
    model : StateSpaceModel
    clock : Clock
        That of the job. A replicate with other times has a clock of its own.
    parameters : sequence of str
        Names of parameters that a column may hold.
    reading : Reading, optional

    Raises
    ------
    MeasurementsError
        The table cannot be read, a column is unknown, or a value is wrong.
    """
    where = "data" if isinstance(source, pd.DataFrame) else source
    try:
        table, column = _table(source, column, model, [*parameters], clock, reading)
        found, distances = list[Replicate](), [0.0]
        quiet = reading._replace(note=lambda line: None, columns={})
        for name, rows in table.groupby(column, sort=False):
            try:
                each, moved = _replicate(str(name), rows, model, clock, column, quiet)
            except (MeasurementsError, MeasurementTimesError, ValueError) as error:
                # Rows would be counted from the first row of this replicate.
                reason = str(error).removeprefix("measurements: ").partition(" (row ")[0]
                raise MeasurementsError(f"replicate {shown(str(name))}: {reason}") from error
            found.append(each)
            distances.append(moved)
        reading.moved(max(distances), clock)
        first = [each.y.start for each in model.ways]
        each_row = [each.y.reshape(len(each.y), -1, model.components[1]) for each in found]
        reading.repeated(sum(int((~np.isnan(y[:, 1:, first])).sum()) for y in each_row))
        tell_failures(model, [np.isposinf(y) for y in each_row], reading)
        return found
    except OSError as error:
        raise MeasurementsError(f"cannot read {source}: {error.strerror or error}") from error
    except (MeasurementsError, ValueError) as error:
        raise MeasurementsError(f"{where}: {error}") from error


def _table(
    source: Path | pd.DataFrame,
    column: str,
    model: StateSpaceModel,
    parameters: list[str],
    clock: Clock,
    reading: Reading,
) -> tuple[pd.DataFrame, str]:
    """The checked table, and the name of the column of replicates."""
    sensors = ["sensor"] if model.sensors else []
    needed = ["t", *sensors * (not reading.is_of_one)]
    most = max(each.model.components[1] for each in model.ways)
    y = [f"y{k}" for k in range(most)]
    named = [*chain.from_iterable(user_columns("y", model))] if not sensors else y
    own = ["t", *sensors, *named, *chain.from_iterable(user_columns("z", model)), TRAIN]
    covariates = [name for name in parameters if name not in CLOCK]
    own += covariates
    read = {*own}

    def check(header: list[str]) -> list[str]:
        name, named = (
            column or next(filter(None, header), ""),
            [each for each in header if each and each not in own],
        )
        separated = f"; {SEPARATORS}" * (len(header) == 1)
        if name not in named:
            rule = f"a column with names of systems: {', '.join(named) or 'the table has none'}"
            raise MeasurementsError(must_be("replicate", rule, name, named) + separated)
        others = [each for each in header if each not in own and each != name]
        for each in filter(COMPONENT.fullmatch, others):
            columns = f"{name}, {', '.join(own)}"
            raise MeasurementsError(f"unknown column {shown(each)}. Columns: {columns}")
        for each in needed:
            if each not in header:
                got = f"got {', '.join(header)}{separated or f'; {RENAME}'}"
                raise MeasurementsError(f"the column {each} is missing, {got}")
        note_unread(others, reading, covariates)
        read.add(name)
        known = [each for each in header if each in chain(*user_columns("z", model))]
        if known and sorted(known) not in map(sorted, user_columns("z", model)):
            rule = " or ".join(map(", ".join, user_columns("z", model)))
            raise MeasurementsError(f"columns of z must be {rule}, got {', '.join(known)}")
        return [name]

    names = {"sensor": reading.named(model)} if sensors else {}
    most = max(each.model.components[1] for each in model.ways)
    measured = {*(f"y{k}" for k in range(most)), *chain(*user_columns("y", model))}
    readers = clock.readers(between=True) | reading.readers(measured)
    columns = read_user_table(source, check, read, names, readers, renamed=reading.renamed)
    if not columns["t"].size:
        raise MeasurementsError("the table must have rows, got none")
    columns["t"] = np.array(clock.of_table(columns["t"].tolist(), reading.note))
    return pd.DataFrame(columns), column or next(each for each in columns if each not in own)


def _replicate(
    name: str, rows: pd.DataFrame, model: StateSpaceModel, clock: Clock, column: str,
    reading: Reading,
) -> tuple[Replicate, float]:  # fmt: skip
    """A replicate, and how far the furthest of its times was moved."""
    most = max(each.model.components[1] for each in model.ways)
    columns = {"t", "sensor", *(f"y{k}" for k in range(most)), *chain(*user_columns("y", model))}
    given = [each for each in rows.columns if each in columns]
    on, at, moved = instants_of_table(rows["t"].tolist(), clock, reading, alone=True)
    table = rows[given].reset_index(drop=True).assign(t=on.times_of(at))
    if "sensor" in table:
        named = reading.named(model)
        table["sensor"] = [named[int(number)] for number in table["sensor"]]
    measurements = read_measurements(table, model, on, reading=reading._replace(given={}))
    y = np.full((len(on.times), measurements.y.shape[1]), np.nan)
    y[[*measurements.t]] = measurements.y
    known = next((names for names in user_columns("z", model) if names[0] in rows), [])
    series = [series_at(each, rows[each].to_numpy(), at, on) for each in known]
    z = np.stack(series, axis=1) if known else None
    others = [each for each in rows.columns if each not in (*given, *known, column, TRAIN)]
    own_values = parameters_at(model.parameters, clock, on.times)
    parameters = {
        each: given_at(each, rows[each].to_numpy(), at, on, own_values)
        if each in reading.given
        else _parameter(each, rows[each].to_numpy(), at, on)
        for each in others
    }
    train = rows[TRAIN].to_numpy(np.float64) if TRAIN in rows else np.zeros(1)
    if len({*train}) > 1 or train[0] not in (0.0, 1.0):
        raise MeasurementsError(f"{TRAIN} must be 0 or 1 in all rows, got {shown(train.tolist())}")
    own = on is not clock
    return Replicate(name, on, y, z, parameters, bool(train[0]), own), moved


def _parameter(name: str, values: Array, at: list[int], clock: Clock) -> Parameter:
    """The value of a parameter, or its value at each instant if it varies."""
    for value in values[~np.isfinite(values)][:1]:
        raise MeasurementsError(f"{name} must be a finite number in all rows, got {value}")
    if (values == values[0]).all():
        return float(values[0])
    series = series_at(name, values, at, clock)
    series[: min(at)] = series[min(at)]  # the first instant may have no row
    for t in np.flatnonzero(np.isnan(series))[:1]:
        raise MeasurementsError(
            f"{name} varies, so it must have a value at each instant, got none at t = "
            f"{clock.formatted(int(t))}"
        )
    return tuple(series.tolist())
