"""The sections of a job file about a store, and about the most measurements in a time."""

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from pfdist.common.section import JobSection, Listed
from pfdist.constraints.most_within import MostWithin
from pfdist.errors import MeasurementTimesError
from pfdist.problem.clock import Clock, plain_time
from pfdist.problem.sections import Moment, Written, ranges_or_column
from pfdist.problem.sensing_section import Finite

Price = Annotated[Finite, AfterValidator(plain_time)]
Prices = Listed[Price] | Annotated[dict[str, Price], ranges_or_column()]
MeasurementBudget = Annotated[int, Field(ge=1, lt=2**63)]
Amount = Annotated[Price, Field(ge=0)]


class StoreSection(JobSection):
    """A store that measurements draw from, such as a battery that the sun charges.

    A measurement draws its price, or 1 without prices. The income of an instant arrives before its
    measurement, and what does not fit is lost. `measurement_budget` is then the largest number. The
    lower bound relaxes the store.

    Parameters
    ----------
    capacity : number, that of price
        The most that it holds.
    start : number, that of price
        The level at first; by default it is full.
    income : number or list or section of ranges
        The amount that arrives at an instant; by time as `price` of ``[problem]``.
    """

    capacity: Annotated[Price, Field(gt=0, le=1e12)]
    start: Amount | None = None
    income: Amount | Prices = 0

    @model_validator(mode="after")
    def _holds_its_start(self) -> Self:
        if self.start is not None and self.start > self.capacity:
            raise ValueError(
                f"problem.store.start must be at most its capacity, {self.capacity}, got "
                f"{self.start}"
            )
        return self


class MostWithinSection(JobSection):
    """The largest number in any stretch of time, or in each day or week.

    The lower bound checks it within windows alone.

    Parameters
    ----------
    number : int
        The largest number.
    time : number, clock
        The length of the stretch, as 2 or "2 h": the next one is at least so much later.
    per : str
        "day" or "week", in place of ``time``: of a day, or of a week from Monday.
    """

    number: MeasurementBudget
    time: Annotated[Moment, Field(gt=0), Written] | None = None
    per: Literal["day", "week"] | None = None

    def on(self, key: str, clock: Clock, ends: tuple[int, ...]) -> MostWithin:
        """The constraint on what begins at some points; raises `MeasurementTimesError`."""
        if (self.time is None) == (self.per is None):
            got = "neither" if self.time is None else "both"
            raise MeasurementTimesError(f"{key} needs time or per, got {got}")
        most = min(self.number, len(clock.times))
        if self.time is not None:
            until, what = clock.successors(float(self.time)), f"within {clock.duration(self.time)}"
        else:
            until, what = clock.ends_of(self.per or "", f"{key}.per"), f"a {self.per}"
        return MostWithin(key=f"{key} is {self.number} {what}", most=most, until=until, ends=ends)
