"""The sections of a job file about sensors, `[problem.sensor]` and `[problem.sensors.NAME]`."""

from typing import Annotated

from pydantic import AfterValidator, Field

from pfdist.problem.clock import Time, plain_time
from pfdist.problem.limits_section import MeasurementBudget, MostWithinSection, Price, Prices
from pfdist.problem.sections import MomentsAndRanges, Written
from pfdist.problem.sensing_section import Finite, SensingSection


class SensorSection(SensingSection):
    """The price of a sensor's measurements, constraints on them, and how it senses.

    The lower bound relaxes `most`, `most_within`, `minimum_spacing` and `together`.

    Parameters
    ----------
    price : number or list or section of ranges
        Price of a measurement by this sensor; by time as that of ``[problem]``.
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
    most_within : section
        The most of its measurements in any stretch of time; see ``[problem.most_within]``.
    """

    price: Annotated[Finite | Prices, AfterValidator(plain_time)] | None = None
    install: Annotated[Price, Field(gt=0)] | None = None
    together: Annotated[str, Field(min_length=1, max_length=40)] | None = None
    forbidden: MomentsAndRanges | None = None
    allowed: MomentsAndRanges | None = None
    most: MeasurementBudget | None = None
    minimum_spacing: Annotated[Time, Written] | None = None
    most_within: MostWithinSection | None = None
