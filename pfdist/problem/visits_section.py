"""The section of a job file about visits, `[problem.visits]`."""

from collections.abc import Sequence
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from pfdist.common.section import JobSection
from pfdist.constraints.step import money
from pfdist.errors import MeasurementTimesError, shown
from pfdist.problem.clock import Clock
from pfdist.problem.limits_section import MeasurementBudget, MostWithinSection, Price
from pfdist.problem.points import Points
from pfdist.problem.sections import Moment, MomentsAndRanges, Written
from pfdist.problem.visits import Visits
from pfdist.problem.written import instants_written


class VisitsSection(JobSection):
    """Visits: measurements that share a price, and the largest number of visits.

    Exactly one of `within`, `per` and `allowed` says which measurements share a visit. With visits,
    `measurement_budget` is the largest number of measurements. The lower bound relaxes `most` and
    `most_within`.

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
    most_within : section
        The most visits in any stretch of time; see ``[problem.most_within]``.
    """

    price: Annotated[Price, Field(gt=0)] | None = None
    most: MeasurementBudget | None = None
    within: Annotated[Moment, Field(gt=0), Written] | None = None
    per: Literal["day", "week"] | None = None
    allowed: Annotated[MomentsAndRanges, Field(min_length=1)] | None = None
    most_within: MostWithinSection | None = None

    @model_validator(mode="after")
    def _is_one_rule(self) -> Self:
        rules = {"within": self.within, "per": self.per, "allowed": self.allowed}
        given = [name for name, value in rules.items() if value is not None]
        if len(given) != 1:
            got = " and ".join(given) or "none of them"
            raise ValueError(f"problem.visits needs one of within, per and allowed, got {got}")
        if self.price is None and self.most is None and self.most_within is None:
            raise ValueError("problem.visits needs price, most or most_within, got none of them")
        return self

    def on(self, points: Points) -> Visits:
        """The visits of a table of points; raises `MeasurementTimesError`."""
        clock = points.clock
        if self.within is not None:
            stops: Sequence[int] = clock.successors(float(self.within))
        elif self.per is not None:
            stops = clock.ends_of(self.per, "visits.per")
        else:
            stops = self._stops_of_ranges(clock)
        late = max(points.delays, default=0)
        ends = tuple(
            points.first(stops[max(0, points.made_at(point))] + late)
            for point in range(points.number)
        )
        shifts = tuple(moment - point for point, moment in enumerate(points.moments[: points.ways]))
        return Visits.on(ends, money(self.price or 0), self.most, shifts if any(shifts) else ())

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
