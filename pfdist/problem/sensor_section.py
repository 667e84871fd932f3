"""The sections of a job file about sensors and visits.

They are `[problem.sensor]`, `[problem.sensors.NAME]` and `[problem.visits]`.
"""

import math
from collections.abc import Sequence
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, AliasChoices, Field, model_validator

from pfdist.common.section import JobSection, Listed
from pfdist.common.sensing import REPEATS, Sensing
from pfdist.errors import MeasurementTimesError, shown
from pfdist.problem.clock import Clock, Time, plain_time
from pfdist.problem.constraints import money
from pfdist.problem.points import Points
from pfdist.problem.sections import Moment, MomentsAndRanges, Written
from pfdist.problem.visits import Visits
from pfdist.problem.written import instants_written

Finite = int | Annotated[float, Field(allow_inf_nan=False)]
Price = Annotated[Finite, AfterValidator(plain_time)]
Prices = Listed[Price] | dict[str, Price]
MeasurementBudget = Annotated[int, Field(ge=1, lt=2**63)]


def priced(name: str, former: str) -> Any:
    """A key about money; its former name is still allowed."""
    return Field(None, validation_alias=AliasChoices(name, former))


class SensingSection(JobSection):
    """The limits of a sensor's readings, its failures, and repeated measurements.

    Parameters
    ----------
    limit : number, that of y
        Readings below are known to be below: censored. The model needs `log_tails`.
    limits : list of two numbers, that of y
        Readings below the first, and above the second, are known to be so.
    fails : float
        Probability that a planned measurement gives nothing.
    repeats : int
        Largest number of measurements at one instant, each with its own noise and price.
    delay : number, clock
        Time after which a value arrives, as 2 or "2 h". A smoothed estimate waits for it.
    """

    limit: Finite | None = None
    limits: Annotated[Listed[Finite], Field(min_length=2, max_length=2)] | None = None
    fails: Annotated[float, Field(gt=0.0, lt=1.0, strict=False)] | None = None
    repeats: Annotated[int, Field(ge=2, le=len(REPEATS))] | None = None
    delay: Annotated[Moment, Field(gt=0), Written] | None = None

    @model_validator(mode="after")
    def _has_limits(self) -> Self:
        if self.limits is not None and (self.limit is not None or self.limits[0] >= self.limits[1]):
            got = f"limits = {shown(list(self.limits))}, limit = {self.limit}"
            raise ValueError(f"a sensor has a limit, or two limits in ascending order, got {got}")
        return self

    def sensing(self, delay: int) -> Sensing:
        """The same for a model, with the delay in instants."""
        low = -math.inf if self.limit is None else float(self.limit)
        low, high = self.limits or (low, math.inf)
        return Sensing(float(low), float(high), self.fails or 0.0, self.repeats or 1, delay)


class SensorSection(SensingSection):
    """The price of a sensor's measurements, constraints on them, and how it senses.

    The lower bound relaxes `most`, `minimum_spacing` and `together`.

    Parameters
    ----------
    price : number or list or section of ranges
        Price of a measurement by this sensor, or at each instant, or in each range.
    install : number, that of price
        Price that is paid once if this sensor measures at all.
    together : str
        Name of a group: at most one of its sensors measures at an instant.
    forbidden : list of times and ranges, clock
        Times at which this sensor does not measure.
    allowed : list of times and ranges, clock
        The only times at which this sensor measures.
    most : int
        Largest number of measurements by this sensor.
    minimum_spacing : number, clock
        Smallest difference of two times of this sensor, as 2 or "2 h".
    """

    price: Annotated[Finite | Prices, AfterValidator(plain_time)] | None = priced("price", "cost")
    install: Annotated[Price, Field(gt=0)] | None = None
    together: Annotated[str, Field(min_length=1, max_length=40)] | None = None
    forbidden: MomentsAndRanges | None = None
    allowed: MomentsAndRanges | None = None
    most: MeasurementBudget | None = None
    minimum_spacing: Annotated[Time, Written] | None = None


class VisitsSection(JobSection):
    """Visits: measurements that share a price, and the largest number of visits.

    Exactly one of `within`, `per` and `allowed` says which measurements share a visit. With visits,
    `measurement_budget` is the largest number of measurements. The lower bound relaxes `most`.

    Parameters
    ----------
    price : number, that of price
        Price of a visit, in addition to those of its measurements.
    most : int
        Largest number of visits.
    within : number, clock
        A visit lasts so long from its first measurement, as 4 or "4 h".
    per : str
        "day" or "week": measurements of a day, or of a week from Monday, share a visit.
    allowed : list of times and ranges, clock
        Each entry is a possible visit; there are no other measurements.
    """

    price: Annotated[Price, Field(gt=0)] | None = None
    most: MeasurementBudget | None = None
    within: Annotated[Moment, Field(gt=0), Written] | None = None
    per: Literal["day", "week"] | None = None
    allowed: Annotated[MomentsAndRanges, Field(min_length=1)] | None = None

    @model_validator(mode="after")
    def _is_one_rule(self) -> Self:
        rules = {"within": self.within, "per": self.per, "allowed": self.allowed}
        given = [name for name, value in rules.items() if value is not None]
        if len(given) != 1:
            got = " and ".join(given) or "none of them"
            raise ValueError(f"problem.visits needs one of within, per and allowed, got {got}")
        if self.price is None and self.most is None:
            raise ValueError("problem.visits needs price, most or both, got neither")
        return self

    def on(self, points: Points) -> Visits:
        """The visits of a table of points; raises `MeasurementTimesError`."""
        clock = points.clock
        if self.within is not None:
            stops: Sequence[int] = clock.successors(float(self.within))
        elif self.per is not None:
            if not clock.has_dates:
                raise MeasurementTimesError(
                    f"visits.per = {shown(self.per)} needs dates (problem.clock.start)"
                )
            days = [date.date() for date in clock.dates]
            keys = [day.isocalendar()[:2] if self.per == "week" else day for day in days]
            last = {key: t for t, key in enumerate(keys)}
            stops = [last[key] + 1 for key in keys]
        else:
            stops = self._stops_of_ranges(clock)
        ends = tuple(points.first(stop) for stop in stops for _ in range(points.ways))
        return Visits(ends, money(self.price or 0), self.most)

    def instants(self, clock: Clock) -> set[int]:
        """The instants at which a visit is possible."""
        if self.allowed is None:
            return {*range(clock.horizon + 1)}
        return {*instants_written(self.allowed, clock, "visits.allowed")}

    def _stops_of_ranges(self, clock: Clock) -> list[int]:
        """The instant after the visit of each instant; instants outside of visits are alone."""
        stops, before = [t + 1 for t in range(clock.horizon + 1)], -1
        for entry in self.allowed or ():
            each = instants_written([entry], clock, "visits.allowed")
            if not each or each != [*range(each[0], each[-1] + 1)]:
                raise MeasurementTimesError(
                    "visits.allowed must list ranges of all instants from one to another, got "
                    f"{shown(entry)}: for a visit each day, per = 'day' with problem.allowed"
                )
            if each[0] <= before or each[-1] > clock.horizon:
                raise MeasurementTimesError(
                    "visits.allowed must list visits one after another, within the horizon, got "
                    f"{shown(list(self.allowed or ()))}"
                )
            before = each[-1]
            for t in each:
                stops[t] = before + 1
        return stops
