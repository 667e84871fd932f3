"""The sections of a job file about sensors, `[problem.sensor]` and `[problem.sensors.NAME]`."""

import math
from typing import Annotated, Any, Self

from pydantic import AfterValidator, AliasChoices, Field, model_validator

from pfdist.common.section import JobSection, Listed
from pfdist.common.sensing import REPEATS, Sensing
from pfdist.errors import shown
from pfdist.problem.clock import Time, plain_time
from pfdist.problem.sections import Moment, MomentsAndRanges, Written

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
