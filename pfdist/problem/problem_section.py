"""The section [problem] of a job file: the horizon, the clock, and the feasible sets of times.

The keys have the names of the parameters of `Constraints`. An error about such a value begins with
its name, and this module puts ``problem.`` before it.
"""

import re
from collections import Counter
from collections.abc import Iterable, Iterator
from functools import cached_property
from itertools import chain
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    Field,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic.config import JsonDict

from pfdist.common.measurement_times import Lag, Times
from pfdist.common.section import JobSection, Listed
from pfdist.common.sensing import Sensing, names_of_repeats
from pfdist.constraints.spacing import Spacing
from pfdist.constraints.step import Money, Step, money
from pfdist.constraints.supply import Supply
from pfdist.constraints.together import Together
from pfdist.errors import MeasurementTimesError, shown
from pfdist.filters.aspects import ErrorBeside
from pfdist.filters.beside import errors_beside
from pfdist.filters.criterion import MEAN
from pfdist.problem.calendar import calendar_of
from pfdist.problem.clock import Clock, Time, plain_time
from pfdist.problem.clock_section import ClockSection, without_units
from pfdist.problem.feasible import Feasible
from pfdist.problem.limits_section import MeasurementBudget, MostWithinSection, Prices, StoreSection
from pfdist.problem.points import Points
from pfdist.problem.sections import (
    CriterionName,
    ListWritten,
    Moment,
    MomentsAndRanges,
    Written,
    is_list_of,
    ranges_or_column,
)
from pfdist.problem.sensing_section import Finite, MeasurementsSection, Sensings, SensingSection
from pfdist.problem.sensor_section import SensorSection
from pfdist.problem.shared import Limit, OfSensors, Shared
from pfdist.problem.visits import Installs
from pfdist.problem.visits_section import VisitsSection
from pfdist.problem.written import by_instant, instants_written

FILTERED, SMOOTHED = "filtered", "smoothed"
_SEASON, _YEAR = 2, 12  # months: a plan of a longer season has a count for each
_MOST_INSTANTS = 32_001
_MOST_POSSIBLE = 32_768  # possible measurements: their numbers have 16 bits in tables
_LONGEST_UNIT = 40  # characters
_Numbers = Listed[Moment]
# `_are_sensors` makes sections of names.
_OR_NAMES: JsonDict = {"type": ["object", "array"], "items": {"type": "string"}}


class ProblemSection(JobSection):
    """The horizon, and constraints on the measurement times: number, price, and allowed times.

    Without a clock, the horizon and all times count instants. With `time_step`, `time_unit`,
    `times` or a section `clock` there is a clock, and all times are times on the clock.

    Parameters
    ----------
    clock : section
        Start, step and time zone, if times are dates; see ``[problem.clock]``.
    horizon : number, clock
        T, the last instant, or its time or date: 1 to 32,000 steps. Required unless ``times`` is
        given.
    time_step : float, time_unit
        Time from an instant to the next. Without a clock, instants are counted.
    time_unit : str
        Name of the unit of time, such as "h", for tables, figures and reports.
    times : list of numbers, time_unit
        The time of every instant, 2 to 32,001 in ascending order, instead of ``horizon``.
    instant_weights : "last", "first", list of numbers, or section of ranges
        Weight of the error of each instant in the MSE, or in each range, at least 0; only ratios
        matter. With "last" or "first" that instant alone counts.
    lag : number, clock
        The estimate of z at a time uses measurements until so much later, as 2 or "2 h".
    estimate : str
        Whether the estimate of z at a time uses the measurements until then (by default, unless
        there is a lag), or all ("smoothed").
    criterion : str
        The aim: the least "expected_mse", the most "information", the least expected error at the
        worst instant ("worst_instant"), or the least quantile of the MSE ("quantile 0.9").
    measurement_budget : int
        N, the exact number of measurements, at most the number of allowed instants.
    forbidden : list of times and ranges, clock
        Times without a measurement.
    allowed : list of times and ranges, clock
        The only times at which a measurement may be made, less those that are forbidden.
    required : list of times and ranges, clock
        Times that every set contains.
    minimum_spacing : number, clock
        Smallest difference of two measurement times, as 2 or "2 h".
    price : number or list or section of ranges
        Price of a measurement, above 0, or at each instant, or in each range; or a column of a
        table with a row for each instant, as ``{ file = "prices.csv", column = "price" }``.
    total_price : number, that of price
        Largest sum of the prices of a set, instead of ``measurement_budget``.
    sensors : section of sections
        Sensors of the model in their order, a section ``[problem.sensors.NAME]`` for each.
    sensor : section
        The only sensor, of a model without sensors.
    given : dict of str to str
        Parameters that come with each reading, such as its standard error: for each the column of
        measured tables. Plans have the job's values.
    visits : section
        Measurements that share a visit; see ``[problem.visits]``.
    store : section
        A store that measurements draw from; see ``[problem.store]``.
    most_within : section
        The most measurements in any stretch of time; see ``[problem.most_within]``.
    measurements : section
        Codes in tables of measurements; see ``[problem.measurements]``.
    """

    # Read as "clock": `clock` is the clock that follows from all keys.
    dates: ClockSection | None = Field(None, alias="clock")
    horizon: Annotated[Moment, Written] | None = None
    time_step: Annotated[float, Field(gt=0.0, allow_inf_nan=False, strict=False)] | None = None
    time_unit: Annotated[str, Field(max_length=_LONGEST_UNIT)] | None = None
    times: (
        Annotated[_Numbers, Field(min_length=2, max_length=_MOST_INSTANTS), ListWritten] | None
    ) = None
    instant_weights: (
        Literal["first", "last"]
        | _Numbers
        | Annotated[dict[str, Moment], ranges_or_column()]
        | None
    ) = None
    lag: Annotated[Moment, Written] | None = None
    # None stands for "filtered", which is not written into a job
    estimate: Literal["filtered", "smoothed"] | None = None
    criterion: CriterionName | None = None  # None stands for "expected_mse"
    measurement_budget: MeasurementBudget | None = None
    forbidden: MomentsAndRanges | None = None
    allowed: MomentsAndRanges | None = None
    required: MomentsAndRanges | None = None
    minimum_spacing: Annotated[Moment, Written] | None = None
    price: Annotated[Finite | Prices, AfterValidator(plain_time)] | None = None
    total_price: Annotated[Moment, Field(gt=0, lt=2**63)] | None = None
    sensors: (
        Annotated[dict[str, SensorSection], Field(min_length=1, json_schema_extra=_OR_NAMES)] | None
    ) = None
    sensor: SensingSection | None = None
    given: dict[str, str] | None = None
    visits: VisitsSection | None = None
    store: StoreSection | None = None
    most_within: MostWithinSection | None = None
    measurements: MeasurementsSection | None = None

    @field_validator("horizon", "times", mode="before")
    @classmethod
    def _may_be_dates(cls, value: Any, info: ValidationInfo) -> Any:
        """Numbers for dates, which a clock with a start reads."""
        dates: ClockSection | None = info.data.get("dates")
        if dates is None or value is None:
            return value
        try:
            calendar = dates.calendar
            numbers = [
                calendar.time(calendar.read(each)) if isinstance(each, str) else each
                for each in (value if is_list_of(value, int, float, str) else [value])
            ]
        except ValueError as error:
            raise ValueError(f"problem.{info.field_name} {error}") from error
        return numbers if isinstance(value, list | tuple) else numbers[0]

    @field_validator(
        "lag", "minimum_spacing", "sensors", "sensor", "visits", "most_within", mode="before"
    )
    @classmethod
    def _may_have_units(cls, value: Any, info: ValidationInfo) -> Any:
        """Numbers in the unit of the clock for durations such as "2 h"."""
        dates: ClockSection | None = info.data.get("dates")
        unit = info.data.get("time_unit") or "" if dates is None else dates.steps[1]
        return without_units(value, f"problem.{info.field_name}", unit)

    @field_validator("estimate")
    @classmethod
    def _is_no_lag(cls, value: str | None, info: ValidationInfo) -> str | None:
        if info.data.get("lag") is not None:
            raise ValueError(
                f"problem.estimate must be left out with problem.lag, got {value!r}: a lag is "
                "between 'filtered' and 'smoothed'"
            )
        return value if value == SMOOTHED else None

    @field_validator("criterion")
    @classmethod
    def _is_no_mean(cls, value: str | None) -> str | None:
        return None if value == MEAN.name else value

    @field_validator("sensors", mode="before")
    @classmethod
    def _are_sensors(cls, value: Any) -> Any:
        return {name: {} for name in value} if is_list_of(value, str) else value

    @model_validator(mode="after")
    def _is_possible(self) -> Self:
        if self.sensor is not None and self.sensors is not None:
            raise ValueError(
                "problem.sensor must be left out with problem.sensors, got both: it is that of a "
                "model without names of sensors"
            )
        for column, count in Counter((self.given or {}).values()).items():
            if count > 1:
                raise ValueError(
                    f"problem.given must name a column for each parameter, got {column!r} twice: "
                    "errors of several sensors need a column each"
                )
        try:
            self.feasible, self.weights, self.instants_of_lag, self.waited_for  # noqa: B018  made here: they check the values together
        except MeasurementTimesError as error:
            raise ValueError(self._said(str(error))) from error
        return self

    @property
    def has_clock(self) -> bool:
        """Whether times are times on a clock."""
        keys = self.time_step, self.time_unit, self.times, self.dates
        return any(value is not None for value in keys)

    @cached_property
    def sensings(self) -> dict[str, Sensing]:
        """The limits, failures and repeats of each sensor; the only one has the name ""."""
        waits = self.estimate == SMOOTHED
        return {
            name: each.sensing(f"sensors.{name}" if name else "sensor", self.clock, waits=waits)
            for name, each in self._own_sensors.items()
        }

    @cached_property
    def waited_for(self) -> tuple[int, ...]:
        """The delay of each sensor of the model, in instants, if the estimate waits for values.

        Empty if no value is late.
        """
        if self.estimate != SMOOTHED:
            return ()
        of_each = {
            name: each.delay_in(f"sensors.{name}" if name else "sensor", self.clock)
            for name, each in self._own_sensors.items()
        }
        delays = tuple(of_each[name] for name in self.sensed.names)
        return delays if any(delays) else ()

    @property
    def errors_beside(self) -> list[ErrorBeside]:
        """The errors that answers show beside that of the job."""
        return errors_beside(self.instants_of_lag, self.weights, self.waited_for)

    @property
    def _own_sensors(self) -> dict[str, Any]:
        return {"": self.sensor} if self.sensor else self.sensors or {}

    @cached_property
    def sensed(self) -> Sensings:
        """How each sensor of the model senses, which may be a repeat."""
        pairs = [(name, each) for name, each in self.sensings.items() for _ in range(each.repeats)]
        return Sensings(tuple(each for _, each in pairs), tuple(name for name, _ in pairs))

    @cached_property
    def each_sensor(self) -> dict[str, SensorSection]:
        """The sensors by which points differ: a sensor that repeats counts as several."""
        if self.sensor is not None:
            sensors = {"": SensorSection(price=self.price)}
        else:
            sensors = self.sensors or {}
        return {
            repeat: each
            for name, each in sensors.items()
            for repeat in names_of_repeats(name, self.sensings[name].repeats)
        }

    @cached_property
    def points(self) -> Points:
        """The table of all possible measurements; raises as `clock`."""
        names, delays = self.sensed.names, tuple(each.delay for each in self.sensed.each)
        points = Points(
            self.clock,
            tuple(self.each_sensor),
            delays if any(delays) else (),
            tuple(map(names.index, names)) if len({*names}) < len(names) else (),
        )
        if points.number > _MOST_POSSIBLE:
            raise MeasurementTimesError(
                f"sensors times instants must be at most {_MOST_POSSIBLE:,}, got {points.number:,}"
            )
        return points

    @cached_property
    def clock(self) -> Clock:
        """The time of each instant; without a clock, the number of the instant.

        Raises `MeasurementTimesError`, which begins with the key, if values contradict each other.
        """
        if calendar_of(self.time_unit or ""):
            raise MeasurementTimesError(
                f"time_unit must have no start, which is clock.start; got {shown(self.time_unit)}"
            )
        if self.dates is None:
            return self._clock_without_dates(self.time_step)
        for name in ("time_step", "time_unit"):
            if getattr(self, name) is not None:
                raise MeasurementTimesError(
                    f"{name} must be left out, because clock.step gives it; got "
                    f"{shown(getattr(self, name))}"
                )
        step = self.dates.steps[0] if self.times is None else None
        try:
            times = self._clock_without_dates(step)
        except MeasurementTimesError as error:
            raise MeasurementTimesError(str(error).replace("time_step", "clock.step")) from error
        return self.dates.on(times)

    def _clock_without_dates(self, time_step: float | None) -> Clock:
        if self.times is not None:
            for name in ("horizon", "time_step"):
                if getattr(self, name) is not None:
                    raise MeasurementTimesError(
                        f"{name} must be left out, because times gives every instant; got "
                        f"{getattr(self, name):g}"
                    )
            return Clock(tuple(map(float, self.times)), self.time_unit or "")
        if self.horizon is None:
            raise MeasurementTimesError("horizon must be given, or times instead")
        if not self.has_clock:
            return Clock.counting(self._whole("horizon", self.horizon))
        step = time_step or 1.0
        if not 1 <= round(self.horizon / step) < _MOST_INSTANTS:
            counts = 1 <= self.horizon < step and float(self.horizon).is_integer()
            raise MeasurementTimesError(
                f"horizon must be 1 to {_MOST_INSTANTS - 1:,} steps of time_step = {step:g}, got "
                f"{self.horizon:g}" + f": did you mean {self.horizon * step:g}?" * counts
            )
        return Clock.regular(self.horizon, step, self.time_unit or "")

    @cached_property
    def feasible(self) -> Feasible:
        """The feasible sets of measurement times, which count instants."""
        clock, spacing = self.clock, self.minimum_spacing
        if spacing is not None and self.has_clock and not 0 < spacing < np.inf:
            raise MeasurementTimesError(f"minimum_spacing must be above 0, got {spacing:g}")
        if not self.has_clock and not (spacing is None and self.each_sensor):
            spacing = 1 if spacing is None else self._whole("minimum_spacing", spacing)
        if len({*self.points.delays}) > 1 and spacing is not None:
            raise MeasurementTimesError(
                "minimum_spacing must be left out with sensors of different delays, got "
                f"{spacing:g}: give each sensor its own"
            )
        points, shared = self.points, tuple(self._shared)
        paid = [each.priced for each in shared if any(setup.price for setup in each.setups)]
        if self.total_price is None and paid:
            raise MeasurementTimesError(f"{paid[-1]} needs total_price and prices of measurements")
        prices = [sum(prices or (0,)) for prices in self._prices_of_sensors] or [0]
        return Feasible(
            horizon=clock.horizon,
            measurement_budget=self.measurement_budget,
            forbidden=self._forbidden,
            required=tuple(sorted({*self.points.read(self.required or (), "required")})),
            minimum_spacing=spacing or 0.0,
            price=None if self.store and self.total_price is None else self._prices_of_points,
            total_price=None if self.total_price is None else money(self.total_price),
            points=points,
            # To sets within limits, nothing may be left to buy.
            smaller=any(self.total_price is not None or not each.is_exact for each in shared),
            shared=shared,
            cheapest=prices.index(min(prices)),  # the first sensor if none has a price
        )

    @property
    def _forbidden(self) -> Times:
        points, clock = self.points, self.clock
        times = {*points.read(self.forbidden or (), "forbidden", of_all=True)}
        if self.allowed is not None:
            allowed = points.read(self.allowed, "allowed", of_all=True)
            times.update({*range(points.number)} - {*allowed})
        if self.visits:
            possible = self.visits.instants(clock)
            times.update(t for t in range(points.number) if points.made_at(t) not in possible)
        times.update(point for point in range(points.number) if points.made_at(point) < 0)
        for way, (name, sensor) in enumerate(self.each_sensor.items()):
            barred = {*instants_written(sensor.forbidden or (), clock, f"sensors.{name}.forbidden")}
            if sensor.allowed is not None:
                others = instants_written(sensor.allowed, clock, f"sensors.{name}.allowed")
                barred.update({*range(clock.horizon + 1)} - {*others})
            arrive = (points.first(t + points.delay(way)) + way for t in barred)
            times.update(point for point in arrive if point < points.number)
        return tuple(sorted(times))

    @property
    def _limits(self) -> Iterator[Limit]:
        """The limits of each sensor alone."""
        for name, sensor in self.each_sensor.items():
            spacing = sensor.minimum_spacing
            if spacing is not None and not 0 < spacing < np.inf:
                raise MeasurementTimesError(
                    f"sensors.{name}.minimum_spacing must be above 0, got {spacing:g}"
                )
            apart = None if spacing is None else Spacing(self.clock.successors(spacing))
            yield Limit(sensor.most, apart)

    @property
    def _shared(self) -> Iterator[Shared]:
        """The prices and limits of several measurements together."""
        groups, points, limits = dict[str, list[Times]](), self.points, [*self._limits]
        if any(limit != Limit() for limit in limits):
            yield OfSensors.on(points, limits)
        sensors = [*zip((self.sensors or {}).values(), points.sensor_ways, strict=False)]
        if self.visits:
            yield self.visits.on(points)
        if installs := [(money(each.install), ways) for each, ways in sensors if each.install]:
            yield Installs.on(points, installs)
        for each, ways in sensors:
            if each.together is not None:
                groups.setdefault(each.together, []).append(ways)
        if groups:
            yield Shared(
                steps=tuple(Together.made_of(each, points.ways) for each in groups.values())
            )
        if others := tuple(self._others):
            yield Shared(steps=others)

    @property
    def _others(self) -> Iterator[Step]:
        """Limits that are no more than their step."""
        points, clock, visits, store = self.points, self.clock, self.visits, self.store
        sensors = zip((self.sensors or {}).items(), points.sensor_ways, strict=False)
        limited = [
            ("most_within", self.most_within, points.alone(*range(points.ways))),
            *((f"sensors.{name}.most_within", each.most_within, points.alone(*ways))
              for (name, each), ways in sensors),
            *[("visits.most_within", visits.most_within, visits.on(points).setup.ends)
              for visits in filter(None, [visits])],
        ]  # fmt: skip
        for key, section, ends in limited:
            if section is not None:
                yield section.on(key, clock, ends)
        if store is not None:
            capacity = money(store.capacity)
            full = capacity if store.start is None else money(store.start)
            income = self._prices("store.income", store.income)
            prices = self._drawn
            for name, amounts in (("store.income", income), ("price", prices)):
                if min(amounts) < 0:
                    raise MeasurementTimesError(
                        f"{name} must be at least 0 with a store, got {min(amounts)}"
                    )
            yield Supply(key="store", capacity=capacity, full=full, income=income, prices=prices)

    @property
    def _drawn(self) -> tuple[Money, ...]:
        """The amount that each possible measurement draws from the store."""
        return self._prices_of_points or (1,) * self.points.number

    @property
    def _prices_of_sensors(self) -> list[tuple[Money, ...]]:
        """The price of each sensor at each instant; empty for a sensor without a price."""
        return [
            self._late(self._prices(f"sensors.{name}.price", sensor.price), way)
            for way, (name, sensor) in enumerate(self.each_sensor.items())
        ]

    def _late(self, prices: tuple[Money, ...], way: int) -> tuple[Money, ...]:
        """The prices of measurements by the instants at which their values arrive."""
        delay = self.points.delay(way)
        return (*prices[:1] * delay, *prices[: len(prices) - delay])

    @cached_property
    def weights(self) -> tuple[float, ...] | None:
        """Weight of each instant's error in the MSE, (T+1,), with mean 1; None if all are equal.

        Raises `MeasurementTimesError` unless each instant has one weight, none of them below 0.
        """
        given: Any = self.instant_weights
        if given is None:
            if self.clock.is_even:
                return None
            given = self.clock.trapezoids
        if isinstance(given, str):
            weights = np.eye(len(self.clock.times))[0 if given == "first" else -1]
        else:
            weights = np.array(by_instant("instant_weights", given, self.clock), np.float64)
        if not (np.isfinite(weights).all() and (weights >= 0.0).all() and weights.any()):
            raise MeasurementTimesError(
                f"instant_weights must be finite, at least 0, and not all 0, got {shown(given)}"
            )
        return tuple((weights / weights.mean()).tolist())

    @cached_property
    def instants_of_lag(self) -> Lag:
        """The estimate of z(t) uses measurements until so many instants after t; see `lag_on`."""
        return self.lag_on(self.clock)

    def lag_on(self, clock: Clock) -> Lag:
        """The estimate of z(t) uses measurements until so many instants of a clock after t.

        It is T for the smoothed estimate, and 0 for the filtered one. With uneven steps each
        instant has its own number. Raises `MeasurementTimesError` if the lag is no number of
        instants, or shorter than all steps of the own clock; on another clock it then is 0.
        """
        lag = self.lag
        if lag is None:
            return clock.horizon if self.estimate == SMOOTHED else 0
        if not self.has_clock:
            return min(self._whole("lag", lag), clock.horizon)
        times = np.array(clock.times)
        step = np.diff(times).min()
        if not step - clock.slack <= lag < np.inf:
            if clock is not self.clock:
                return 0
            raise MeasurementTimesError(f"lag must be at least a step, {step:g}, got {lag:g}")
        if clock.is_even:
            return min(int((lag + clock.slack) / step), clock.horizon)
        last = np.searchsorted(times, times + lag + clock.slack, "right") - 1
        return tuple((last - np.arange(times.size)).tolist())

    @property
    def estimate_written(self) -> str:
        """The key that says which measurements an estimate uses, and its value."""
        if self.lag is not None:
            return f"problem.lag = {self.lag:g}"
        return f"problem.estimate = {self.estimate or FILTERED!r}"

    @property
    def of_the_estimate(self) -> str:
        """Which estimate has the expected MSE, in an answer; empty for the filter's."""
        if self.lag is None:
            return " of the smoothed estimate" * (self.estimate == SMOOTHED)
        return f" of the estimate with a lag of {self.lag:g} {self.clock.unit}".rstrip()

    @property
    def is_constrained(self) -> bool:
        """Whether a constraint excludes sets of the same number of measurements or price."""
        sets = self.feasible
        limited = bool(sets.forbidden or sets.required or sets.shared)
        return limited or not sets.spacing.is_free

    def by_parts(self, times: Iterable[Time | str]) -> str:
        """When a set measures, by what its measurements share; empty if they share nothing."""
        read = self.points.read(times)
        return "".join(each.in_words(self.points, read) for each in self.feasible.shared)

    def when(self, times: Iterable[Time | str]) -> str:
        """When a set measures, in words: dates have weekdays, and a season a count a month."""
        listed = [*times]
        text = self.clock.listed(listed)
        if not self.clock.has_dates or not listed or " to " in text:
            return f"at {'t = ' if listed else 'no time'}{text}"
        made_at, dates = self.points.made_at, self.clock.dates
        months = Counter(f"{dates[max(0, made_at(e))]:%b %Y}" for e in self.points.read(listed))
        counts = ", ".join(f"{month[:3]} {count}" for month, count in months.items())
        is_season = _SEASON < len(months) <= _YEAR
        return f"on {', '.join(self.clock.in_words(listed))}" + f" (by month: {counts})" * is_season

    def broken(self, times: Iterable[Time | str]) -> list[str]:
        """The constraints that a set of times breaks, one sentence each.

        The times are instants, or times on the clock. Each sentence begins with the key, for
        instance ``problem.forbidden: 4 is measured``. Fewer measurements break none.
        """
        broken = self.feasible.broken(self.points.read(times), fewer=True)
        return [self._said(sentence) for sentence in broken]

    def _said(self, sentence: str) -> str:
        """A sentence that begins with a key, with its section and, for times, both keys."""
        keys = "forbidden" if self.allowed is None else "allowed or problem.forbidden"
        return f"problem.{re.sub('^forbidden', keys, sentence)}"

    @property
    def _prices_of_points(self) -> tuple[Money, ...] | None:
        """The price of each possible measurement; None if measurements are counted."""
        if not self.each_sensor:
            return None if self.price is None else self._late(self._prices("price", self.price), 0)
        if self.price is not None and self.sensors:
            raise MeasurementTimesError(
                "price must be left out with sensors, because each has its own: "
                f"sensors.{next(iter(self.sensors))}.price"
            )
        if self.total_price is None and self.store is None:
            return None
        lacking = [name for name, each in self.each_sensor.items() if each.price is None]
        if lacking and self.total_price is None:
            return None
        if lacking:
            raise MeasurementTimesError(
                f"sensors.{lacking[0]}.price must be given with total_price"
            )
        return tuple(chain.from_iterable(zip(*self._prices_of_sensors, strict=True)))

    def _prices(self, name: str, given: Time | Prices | None) -> tuple[Money, ...]:
        """The price of each instant; empty if no price is given."""
        return () if given is None else tuple(map(money, by_instant(name, given, self.clock)))

    def _whole(self, name: str, value: Time) -> int:
        """A number of instants; the error about another number names the keys of a clock."""
        if not isinstance(value, int):
            raise MeasurementTimesError(
                f"{name} must be an integer, or in the unit of a clock (time_step, time_unit or "
                f"times), got {shown(value)}"
            )
        most = _MOST_INSTANTS - 1 if name == "horizon" else 2**63 - 1
        if not 1 <= value <= most:
            bound = "at least 1" if value < 1 else f"at most {most}"
            raise MeasurementTimesError(f"{name} must be {bound}, got {shown(value)}")
        return value
