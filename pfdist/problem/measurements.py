"""Measured values of one system, checked one by one or read from a table."""

import math
import re
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import chain, pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times
from pfdist.common.nearest import did_you_mean
from pfdist.errors import MeasurementsError, MeasurementTimesError, shown
from pfdist.filters.one_filter import checked_instant, checked_measurement, made, plain_number
from pfdist.filters.user_prior import user_columns
from pfdist.models import StateSpaceModel
from pfdist.models.parameters import Parameter
from pfdist.models.sensed import known_values
from pfdist.problem.clock import Clock
from pfdist.problem.sensing_section import LOST, MeasurementsSection, Sensings
from pfdist.store.user_tables import SEPARATORS, read_user_table

Array = NDArray[np.float64]
_FURTHER = 10_000  # rows
_STAMP = 1e8  # seconds; in 1973
_MOST_REPEATS = 8  # rows of a sensor at a time
_NAMED = 8  # columns that are not read
COMPONENT = re.compile(r"y\d+")
RENAME = "columns of other names need --columns y0=NAME,t=NAME"


NO_CODES = MeasurementsSection()


class Reading(NamedTuple):
    """How a user's table is read.

    Parameters
    ----------
    columns : mapping of str to str
        The names in the table of columns that have another name there.
    within : float, optional
        Largest distance from a time to the instant that is used instead, if there must be one.
    any_time : callable
        Whether the filter can have instants that the clock lacks.
    note : callable
        Receives lines about what was not read, moved or repeated.
    sensings : Sensings
        For each sensor of the model, its limits, beyond which numbers count as these, its delay,
        whether it may fail, and the sensor of the job, of which it may be one of the repeats.
    all_count : bool
        Whether a value that arrives after the horizon is an error.
    given : mapping of str to str
        Columns of the parameters that come with each reading.
    codes : MeasurementsSection
        Cells that mean that there is no value.
    """

    columns: Mapping[str, str] = {}
    within: float | None = None
    any_time: Callable[[], bool] = lambda: False
    note: Callable[[str], Any] = lambda line: None
    sensings: Sensings = Sensings()
    all_count: bool = False
    given: Mapping[str, str] = {}
    codes: MeasurementsSection = NO_CODES

    @property
    def renamed(self) -> dict[str, str]:
        """The names in the table of all columns that have another name there."""
        given = {name: column for name, column in self.given.items() if name != column}
        return {**given, **self.columns}

    def readers(self, names: Iterable[str]) -> dict[str, Callable[[str], float]]:
        """A reader of the cells of each measured column: numbers, beyond a limit, and codes."""
        has_others = self.sensings.have_limits or self.codes != NO_CODES
        return dict.fromkeys({*names} - {"t", "sensor"} if has_others else (), self._number)

    def _number(self, text: str) -> float:
        code = self.codes.number(text)
        number = self.sensings.read(text) if code is None else code
        if code is None and math.isinf(number):
            raise MeasurementsError(f"a cell must be a finite number, got {shown(text)}")
        return number

    def named(self, model: StateSpaceModel) -> list[str]:
        """The names in a column sensor: the sensors of the model, and those that repeat."""
        return [*dict.fromkeys(filter(None, (*model.sensors, *self.sensings.names)))]

    @property
    def is_of_one(self) -> bool:
        """Whether all sensors of the model are repeats of the only one: a row needs no name."""
        return {*self.sensings.names} == {""}

    @property
    def why_instants(self) -> str:
        """Why the filter can have no other instants."""
        step = "the model's step does not read p.dt"
        return f"because {'a sensor has a delay' if self.sensings.are_late else step}"

    def moved(self, distance: float, clock: Clock) -> None:
        """Note how far the furthest time moved, if any did."""
        if distance:
            self.note(
                "times of the table count at the nearest instants, at most "
                f"{clock.duration(distance)} away, {self.why_instants}"
            )

    def repeated(self, rows: int, instants: Sequence[int] = ()) -> None:
        """Note how many rows are not the first of their time and sensor, if there are any."""
        if rows:
            repeat = "1 row repeats" if rows == 1 else f"{rows} rows repeat"
            begun = 1 + sum(b < a for a, b in pairwise(instants))
            several = f"; t begins {begun} times: give the rows of one system" * (begun > 2)
            self.note(f"{repeat} a time of the table: the filter weighs each row{several}")


PLAIN_READING = Reading()


@dataclass(frozen=True)
class Measurements:
    """Measurements of one system, in the order of time."""

    t: tuple[int, ...]  # (K,); the instants that were measured, or at which values arrived
    y: Array  # (K, R * m) with up to R rows for a sensor; NaN marks a component that is missing
    missed: tuple[int, ...]  # instants that have a row without any component
    clock: Clock  # of these instants: that of the job, or also with the times of the table
    repeats: int = 1  # R
    failed: Times = ()  # measurements that were made, and gave no value
    in_flight: Times = ()  # possible measurements whose values arrive after the last row
    # Parameters that came with readings, (T+1,); those of the model at other instants.
    given: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

    def made_with(self, model: StateSpaceModel) -> Times:
        """The possible measurements that gave a value; without sensors, these are instants."""
        rows = zip(self.t, known_values(self.y[:, : model.components[1]]), strict=True)
        return tuple(chain.from_iterable(made(model, t, y) for t, y in rows))

    def arriving(self, model: StateSpaceModel, delays: Sequence[int]) -> "Measurements":
        """The values at the instants at which they arrive, until T, each sensor after its delay."""
        components, found = model.components[1], dict[int, Array]()
        for each, delay in zip(model.ways, delays, strict=True):
            columns = np.arange(self.y.shape[1]).reshape(-1, components)[:, each.y].ravel()
            for t, y in zip(self.t, self.y[:, columns], strict=True):
                if t + delay <= self.clock.horizon and not np.isnan(y).all():
                    row = found.setdefault(t + delay, np.full(self.y.shape[1], np.nan))
                    row[columns] = y
        rows = [found[t] for t in sorted(found)]
        return replace(self, t=tuple(sorted(found)), y=np.array(rows).reshape(-1, self.y.shape[1]))


def read_measurements(
    path: Path | pd.DataFrame,
    model: StateSpaceModel,
    clock: Clock,
    start: int = 0,
    reading: Reading = PLAIN_READING,
) -> Measurements:
    """Measurements from a table with the columns t, y0, y1, ..., with rows in any order.

    The table is a file in CSV or Parquet, or in memory. If the model names the components of y,
    columns may have the names: y_concentration. `start` is the first instant that can be measured.
    A row without any component is a time that was not measured; if its sensor has `works`, it was
    measured and failed, which is inf. Several rows for a sensor at a time are repeats, which all
    count. A column of a parameter must have the values of the model; further
    columns are not read. Raises `MeasurementsError` if the file cannot be read, if its header does
    not fit, or if a value is wrong.
    """
    allowed, sensors = [["t", *names] for names in user_columns("y", model)], reading.named(model)
    if sensors:
        most = max(each.model.components[1] for each in model.ways)
        allowed = [["t", "sensor", *(f"y{component}" for component in range(most))]]
        allowed += [["t", *allowed[0][2:]]] * reading.is_of_one
    try:
        own = clock.without(model.parameters)
        below = {f"{name}_below" for name in chain(*allowed)}
        known = {*chain(*allowed), *own, *below}
        check = partial(_check_header, allowed, own, reading)
        most = _FURTHER + _MOST_REPEATS * model.points.first(len(clock.times))
        readers = clock.readers(between=True) | reading.readers(chain(*allowed))
        columns = read_user_table(path, check, known, {"sensor": sensors}, readers, most,
                                  reading.renamed)  # fmt: skip
        times = clock.of_table(columns["t"].tolist(), reading.note)
        of_rows, instants, moved = instants_of_table(times, clock, reading, start)
        reading.moved(moved, clock)
        kept = {name: value for name, value in own.items() if name not in reading.given}
        if of_rows is not clock and (
            varied := [k for k, v in kept.items() if isinstance(v, tuple)]
        ):
            reading.note(
                f"{', '.join(varied)} of the model: constant from an instant of the job to the next"
            )
        for name, value in kept.items():
            _check_parameter(name, columns.get(name), value, times, clock)
        header = next(names for names in allowed if names[-1] in columns)
        wanted = [each for each in header if each not in ("t", "sensor")]
        table, code = _cells(columns, wanted, reading)
        own_values = parameters_at(
            {name: own[name] for name in reading.given}, clock, of_rows.times
        )
        given_values = {
            name: given_at(name, columns[name], instants, of_rows, own_values)
            for name in reading.given
        }
        named = [sensors[int(k)] for k in columns.get("sensor", ())] or [""] * len(times)
        ways = [*_sensors_of_rows(zip(instants, named, strict=True), model, reading)]
        arrivals = [
            t + reading.sensings.by_way(way).delay for t, way in zip(instants, ways, strict=True)
        ]
        rows = _Rows(instants, arrivals, ways, table, code, of_rows.horizon)
        values = _placed(rows.with_failures(model), model, wanted, of_rows, reading)
    except (MeasurementsError, ValueError) as error:
        where = "measurements" if isinstance(path, pd.DataFrame) else path
        raise MeasurementsError(f"{where}: {error}") from error
    except OSError as error:
        raise MeasurementsError(f"cannot read {path}: {error.strerror or error}") from error
    _tell_not_given({name: columns[name] for name in reading.given}, ways, table, reading)
    measured, repeats = sorted({t for t, _, _ in values}), 1 + max(k for *_, k in [(0,), *values])
    reading.repeated(sum(k > 0 for *_, k in values), instants)
    place = {t: k for k, t in enumerate(measured)}
    y = np.full((len(measured), repeats, model.components[1]), np.nan)
    for (t, way, number), each in values.items():
        y[place[t], number, model.ways[way].y] = each
    # A value that is not in the table has not arrived until its last time.
    missed = tuple(sorted({min(t, rows.now) for t in arrivals} - {*measured}))
    failed, in_flight = rows.without_a_value(model, reading.sensings)
    tell_failures(model, [np.isposinf(y)], reading)
    return Measurements(
        tuple(measured),
        y.reshape(len(measured), repeats * model.components[1]),
        missed,
        of_rows,
        repeats,
        failed,
        in_flight,
        given=given_values,
    )


@dataclass(frozen=True)
class _Rows:
    """The rows of a table: instants, those of arrival, sensors, cells, and the codes of rows."""

    instants: Sequence[int]
    arrivals: Sequence[int]
    ways: Sequence[int]
    table: Array
    codes: Array  # FAILED, LOST or 0
    horizon: int

    @cached_property
    def is_empty(self) -> list[bool]:
        """Whether each row has no value."""
        return [bool(np.isnan(row).all()) for row in self.table]

    @cached_property
    def now(self) -> int:
        """The last instant that has a row or at which a value arrives."""
        of_values = (t for t, empty in zip(self.arrivals, self.is_empty, strict=True) if not empty)
        return max(chain(self.instants, (t for t in of_values if t <= self.horizon)), default=0)

    def with_failures(self, model: StateSpaceModel) -> Iterable[tuple[int, int, int, Array]]:
        """Instant, arrival, sensor and cells of each row; inf if a sensor with `works` failed."""
        for k, (arrival, way) in enumerate(zip(self.arrivals, self.ways, strict=True)):
            own, row = model.ways[way], self.table[k]
            is_known = self.codes[k] != LOST and arrival <= self.now
            if self.is_empty[k] and own.model.works and is_known:
                row = np.where(np.arange(row.size) < own.y.stop - own.y.start, np.inf, np.nan)
            yield self.instants[k], arrival, way, row

    def without_a_value(self, model: StateSpaceModel, sensings: Sensings) -> tuple[Times, Times]:
        """The possible measurements that were made without a value, and those in flight."""
        failed, in_flight = list[int](), set[int]()
        for k, (t, way) in enumerate(zip(self.arrivals, self.ways, strict=True)):
            point = model.points.first(t) + way
            may_fail = sensings.by_way(way).fails or model.ways[way].model.works
            if self.is_empty[k] and self.now < t <= self.horizon:
                in_flight.add(point)
            elif self.is_empty[k] and t <= self.now and (may_fail or self.codes[k]):
                failed.append(point)
        return tuple(failed), tuple(sorted(in_flight))


def _cells(
    columns: Mapping[str, Any], wanted: Sequence[str], reading: Reading
) -> tuple[Array, Array]:
    """The cells of measured columns, with NaN for codes, and the code of each row: 0 for none."""
    for name in wanted:  # an empty cell, known to be below
        censored = np.isnan(columns[name]) & (columns.get(f"{name}_below", 0.0) == 1.0)
        if censored.any():
            columns[name][censored] = reading.sensings.low
    table = np.stack([columns[name] for name in wanted], axis=1)
    if reading.codes == NO_CODES:
        return table, np.zeros(len(table))
    for number in np.unique(table):
        if (code := reading.codes.number(float(number))) is not None:
            table = np.where(table == number, code, table)
    codes = np.where(np.isinf(table), table, 0.0)
    of_row = np.where((codes == LOST).any(axis=1), LOST, codes.max(axis=1))
    return np.where(np.isinf(table), np.nan, table), of_row


def _sensors_of_rows(
    rows: Iterable[tuple[int, str]], model: StateSpaceModel, reading: Reading
) -> Iterable[int]:
    """The sensor of each row, an instant and a name: of repeats, the first without a row then."""
    names, count = [*model.sensors] or [""], Counter[tuple[int, str]]()
    for row in rows:
        alike = [way for way, name in enumerate(reading.sensings.names) if name == row[1]]
        ways = alike or [names.index(row[1])]
        yield ways[count[row] % len(ways)]
        count[row] += 1


def _placed(
    rows: Iterable[tuple[int, int, int, Array]],
    model: StateSpaceModel,
    columns: Sequence[str],
    clock: Clock,
    reading: Reading,
) -> dict[tuple[int, int, int], Array]:
    """The measurement of each instant of arrival, sensor and repeat."""
    values, count = dict[tuple[int, int, int], Array](), Counter[tuple[int, int]]()
    late = 0
    for t, arrival, way, row in rows:
        text, name = clock.text(clock.times[t]), model.ways[way].name
        sensing = reading.sensings.by_way(way)
        y = _of_sensor(model, way, row, columns, text, (sensing.low, sensing.high))
        if y is None:
            continue
        if arrival > clock.horizon:
            late += 1
            continue
        if count[t, way] == _MOST_REPEATS:
            of_sensor = f" of {name}" * bool(name)
            raise MeasurementsError(
                f"each time must have at most {_MOST_REPEATS} rows{of_sensor}, got more at t = "
                f"{text}"
            )
        values[arrival, way, count[t, way]] = y
        count[t, way] += 1
    if late:
        unused = f"values that arrive after {clock.formatted(clock.horizon)} do not count: {late}"
        if reading.all_count:
            raise MeasurementsError(f"{unused}; give the job file, not the folder of its run")
        reading.note(unused)
    return values


def _of_sensor(
    model: StateSpaceModel,
    way: int,
    row: Array,
    columns: Sequence[str],
    t: str,
    limits: tuple[float, float],
) -> Array | None:
    """The checked measurement of a row; None if all is missing."""
    name, alone, own, _ = model.ways[way]
    count = own.stop - own.start
    if not np.isnan(row[count:]).all():
        raise MeasurementsError(
            f"the sensor {name} must have {count} components of y, got more at t = {t}"
        )
    names = [f"{column} of {name}" if name else column for column in columns[:count]]
    return checked_measurement(row[:count], alone, t, names, limits)


def _check_parameter(
    name: str, given: Any, own: Parameter, times: Sequence[float], clock: Clock
) -> None:
    """Raise `MeasurementsError` if a column has other values of a parameter than the model."""
    if given is None:
        return
    here = np.array(covariate_at(own, clock, times)) if isinstance(own, tuple) else own
    if not (np.isnan(given) | np.isclose(given, here, rtol=1e-6)).all():
        raise MeasurementsError(
            f"column {name}: the filter has the job's value of this parameter, got another: only "
            "backtest and fit read parameters from tables"
        )


def covariate_at(
    values: Sequence[float], clock: Clock, times: Iterable[float]
) -> tuple[float, ...]:
    """The values of a covariate at times: from each instant of the clock on until the next."""
    at = np.searchsorted(np.array(clock.times) - clock.slack, [*times], side="right") - 1
    return tuple(np.array(values)[at.clip(0)].tolist())


def parameters_at(
    parameters: Mapping[str, Parameter], clock: Clock, times: Sequence[float]
) -> dict[str, Parameter]:
    """Parameters, whose covariates have a value for each instant of a clock, at other times."""
    return {
        name: covariate_at(value, clock, times) if isinstance(value, tuple) else value
        for name, value in parameters.items()
    }


def given_at(
    name: str, values: Array, at: Sequence[int], clock: Clock, own: Mapping[str, Parameter]
) -> tuple[float, ...]:
    """A parameter that comes with readings, (T+1,): the model's where no row has a value."""
    try:
        series = series_at(name, values, at, clock)
    except MeasurementsError as error:
        remedy = (
            f"; if {name} is a standard error, give such readings as one: their mean weighted by "
            f"1 / {name}^2, whose error is 1 / sqrt(sum of 1 / {name}^2)"
        )
        raise MeasurementsError(f"{error}{remedy * bool(np.isfinite(values).all())}") from error
    return tuple(np.where(np.isnan(series), np.array(own[name]), series).tolist())


def _tell_not_given(
    given: Mapping[str, Array], ways: Sequence[int], table: Array, reading: Reading
) -> None:
    """Tell readings without a value that comes with other readings of the same sensor."""
    has_value = ~np.isnan(table).all(axis=1)
    for name, values in given.items():
        with_it = np.isin(ways, np.asarray(ways)[~np.isnan(values)])
        if without := int(np.sum(has_value & with_it & np.isnan(values))):
            rows = f"{without} row{'s' * (without > 1)}"
            reading.note(f"{name} is empty in {rows} with a reading: there the job's value counts")


def tell_failures(
    model: StateSpaceModel, have_failed: Sequence[NDArray[np.bool_]], reading: Reading
) -> None:
    """Tell how cells without a value of sensors with `works` were read, (..., m) for each table."""
    first = [each.y.start for each in model.ways if each.model.works]
    if failed := sum(int(each[..., first].sum()) for each in have_failed):
        are = "empty rows are failed measurements, which say" if failed > 1 else (
            "empty row is a failed measurement, which says"
        )  # fmt: skip
        reading.note(f"{failed} {are} something about x (works)")
    elif first:
        reading.note(
            "no row is empty: times without a row are taken as left out without knowledge of x "
            "(works)"
        )


def series_at(name: str, values: Array, at: Sequence[int], clock: Clock) -> Array:
    """The value at each instant, (T+1,), given those of some rows; NaN elsewhere."""
    series = np.full(len(clock.times), np.nan)
    for t, value in zip(at, values.tolist(), strict=True):
        if np.isinf(value) or (value != series[t] and not np.isnan([value, series[t]]).any()):
            rule = "must have one finite value at each time"
            got = f"{value}" if np.isinf(value) else f"{series[t]} and {value}"
            raise MeasurementsError(f"{name} {rule}, got {got} at t = {clock.formatted(t)}")
        series[t] = series[t] if np.isnan(value) else value
    return series


def instants_of_table(
    times: Sequence[float], clock: Clock, reading: Reading, start: int = 0, *, alone: bool = False
) -> tuple[Clock, list[int], float]:
    """The clock of a table, the instant of each of its times on it, and the largest distance.

    It is the job's clock if that has all times, or if the filter can have no others; they are then
    moved to the nearest instants. Else it has the instants of the job, or if `alone` only the
    first, and the times of the table. Raises `MeasurementsError` for a time before the instant
    `start` or after the last, or too far from all instants.
    """
    exact, has_others = list[float](), False
    for row, t in enumerate(times, 1):
        try:
            exact.append(clock.times[instant_on(clock, t, start)])
        except MeasurementsError as error:
            if not clock.times[start] <= t <= clock.times[-1]:
                is_stamp = not clock.has_dates and t > _STAMP
                hint = "; stamps since 1970 need a start, problem.clock" * is_stamp
                raise MeasurementsError(f"{error} (row {row}){hint}") from error
            exact.append(t)
            has_others = True
    if has_others and not clock.counts and reading.any_time():
        first = clock.times[:1] if alone else clock.times
        clock = replace(clock, times=tuple(sorted({*first, *exact})))
    instants = clock.nearest(exact)
    distances = [abs(clock.times[k] - t) for k, t in zip(instants, exact, strict=True)]
    moved, within = max(distances, default=0.0), reading.within
    if within is not None and moved > within + clock.slack:
        far = exact[distances.index(moved)]
        raise MeasurementsError(
            f"t must be at most {clock.duration(within)} from an instant, {reading.why_instants}, "
            f"got {clock.text(far)}, {clock.duration(moved)} from the nearest: allow more "
            "(--within)"
            + ", or write the step with p.dt, as pfdist.ode does"
            * (not reading.sensings.are_late)
        )
    return clock, instants, moved


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


def _check_header(
    allowed: list[list[str]], parameters: Collection[str], reading: Reading, header: list[str]
) -> None:
    given = [name for name in header if name in chain(*allowed) or COMPONENT.fullmatch(name)]
    if sorted(given) in map(sorted, allowed):
        below = {f"{name}_below" for name in given}
        read = {*given, *parameters, *below}
        note_unread([each for each in header if each not in read], reading)
        return
    choices = " or ".join(map(", ".join, allowed))
    text = f"the columns must be {choices}, got {shown(', '.join(header))}"
    if len(header) == 1:
        text += f"; {SEPARATORS}"
    elif header and header[0][:1].isdigit():
        text += "; the first line must name the columns"
    elif {"date", "time"} <= {*map(str.lower, header)}:
        text += "; join the date and the time to one column t"
    else:
        text += f"; {RENAME}"
    raise MeasurementsError(text)


def note_unread(columns: Sequence[str], reading: Reading, known: Iterable[str] = ()) -> None:
    """Note the columns of a table that are not read, and names that they may mean."""
    if columns:
        names = [f"{each}{did_you_mean(each, [*known])}" if each else "one without a name"
                 for each in columns[:_NAMED]]  # fmt: skip
        more = f" and {len(columns) - _NAMED} more" * (len(columns) > _NAMED)
        reading.note(f"columns of the table that are not read: {', '.join(names)}{more}")
