"""The section [problem.clock] of a job file, and durations with a unit."""

import re
from dataclasses import replace
from typing import Any, Self

from pydantic import model_validator

from pfdist.common.section import JobSection
from pfdist.errors import MeasurementTimesError, shown
from pfdist.problem.calendar import SECONDS, Calendar, groups
from pfdist.problem.clock import Clock

_STEP = re.compile(rf"(\d{{1,9}}(?:\.\d{{1,9}})?) ?({'|'.join(SECONDS)})")
_DURATION = re.compile(r"(\d{1,9}(?:\.\d{1,9})?) ?(\S.*)")
_DURATIONS = ("lag", "minimum_spacing", "delay", "within", "time")
_YEARS = (1000, 9000)  # of a clock with dates


class ClockSection(JobSection):
    """The date of the first instant, and the time from an instant to the next.

    All times may then be dates. The unit of the step is that of numbers, such as `minimum_spacing`.

    Parameters
    ----------
    start : date
        Local date and hour of the instant 0; midnight without an hour.
    step : str
        A number and a unit, as "1 d" or "30 min": s, min, h, d (24 hours) or w. With
        ``problem.times``, only its unit counts.
    timezone : str
        Time zone of the start and of all dates, as "Europe/Brussels". Without one, all days have 24
        hours.
    """

    start: str
    step: str
    timezone: str | None = None

    @model_validator(mode="after")
    def _is_clock(self) -> Self:
        try:
            self.calendar  # noqa: B018  made here: it checks the values together
        except ValueError as error:
            raise ValueError(f"problem.clock.{error}") from error
        return self

    @property
    def steps(self) -> tuple[float, str]:
        """The number and the unit of the step."""
        found = _STEP.fullmatch(self.step)
        if not found or not float(found[1]):
            raise ValueError(
                f"step must be a number above 0 and a unit ({', '.join(SECONDS)}), as '30 min', "
                f"got {shown(self.step)}"
            )
        return float(found[1]), found[2]

    @property
    def calendar(self) -> Calendar:
        """The dates; by the hour, also if all instants are midnights."""
        start = " ".join(map(" ".join, groups(self.start)))
        return Calendar.starting(start, self.steps[1], self.timezone or "")

    def on(self, times: Clock) -> Clock:
        """The clock with dates of the same times; raises `MeasurementTimesError`."""
        start, are_whole = self.calendar, all(float(t).is_integer() for t in times.times)
        is_midnight = "T" not in self.start and " " not in self.start and not self.timezone
        by_days = is_midnight and are_whole and start.unit in ("d", "w")
        clock = replace(times, unit=start.unit, calendar=replace(start, by_days=by_days))
        try:
            years = [clock.dates[t].year for t in (0, -1)]
        except OverflowError:
            years = [10_000]
        if min(years) < _YEARS[0] or max(years) > _YEARS[1]:
            raise MeasurementTimesError(
                f"clock must lie in the years {_YEARS[0]} to {_YEARS[1]}, got one from {self.start}"
            )
        return clock


def without_units(value: Any, key: str, unit: str) -> Any:
    """The value of a key, or of those in its sections, with numbers for durations."""
    if isinstance(value, dict):
        return {name: without_units(each, f"{key}.{name}", unit) for name, each in value.items()}
    if not isinstance(value, str) or key.rpartition(".")[2] not in _DURATIONS:
        return value
    found = _DURATION.fullmatch(value)
    if found and found[2] == unit:
        return float(found[1])
    if found and {found[2], unit} <= SECONDS.keys():
        return float(found[1]) * SECONDS[found[2]] / SECONDS[unit]
    like = f", as '2 {unit}'" if unit else ": the clock has no unit (time_unit)"
    raise ValueError(f"{key} must be a number, or one with a unit{like}, got {shown(value)}")
