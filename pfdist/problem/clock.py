"""The clock of a problem: the time of each instant, in a unit that the user names.

Everything below the job counts instants, 0..T. A user's times become instants when they are read,
and instants become times when they are shown.
"""

import contextlib
import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from functools import cached_property
from itertools import pairwise
from typing import Any, TypeVar, cast

import numpy as np

from pfdist.common.measurement_times import CLOCK, DATES, Times
from pfdist.common.parsing import MOST_NUMBERS, as_text
from pfdist.common.rounding import unrounded
from pfdist.errors import MeasurementTimesError, shown
from pfdist.problem.calendar import (
    DAYS_OF_YEAR,
    NUMBER,
    OWN_DATES,
    SECONDS,
    Calendar,
    groups,
)

Time = int | float
T = TypeVar("T")

_MISSING = ("", "nan", "nat", "none", "null", "na")  # texts of a cell without a date
_NO_TIME = "t must not be empty, got nothing"
_ROUNDING = 1e-11
"""Rounding to 12 digits changes a time by less than this part of it."""
_FLOAT_ROUNDING = 1e-15
"""A sum of floats differs from the true sum by about this part of it."""
_LONG_RUN = 8  # instants in a row that answers show as a range
_EXACT = 2**53
"""Whole floats below this are exact."""


@dataclass(frozen=True)
class Clock:
    """The time of each instant 0..T.

    Raises `MeasurementTimesError` if a time is not finite, or the times are not in ascending order.
    """

    times: tuple[Time, ...]  # (T+1,): in ascending order
    unit: str = ""  # of spans of time, as the user names it, such as "h"; empty if there is none
    counts: bool = False  # whether the problem has no clock: the time of an instant is its number
    calendar: Calendar | None = None  # the dates of times, if the clock has a start

    def __post_init__(self) -> None:
        for time in self.times:
            if not math.isfinite(time):
                raise MeasurementTimesError(f"times must be finite numbers, got {time}")
        for time, later in pairwise(self.times):
            if not time < later:
                raise MeasurementTimesError(
                    f"times must be in ascending order, got {unrounded(time)} before "
                    f"{unrounded(later)}"
                )

    @classmethod
    def counting(cls, horizon: int) -> "Clock":
        """The default clock: the time of an instant is its number."""
        return cls(tuple(range(horizon + 1)), counts=True)

    @classmethod
    def regular(cls, horizon: float, step: float, unit: str = "") -> "Clock":
        """A clock with equal steps from 0 to the horizon.

        Raises `MeasurementTimesError` if the horizon is not a multiple of the step.
        """
        steps = round(horizon / step)
        if steps < 1 or not math.isclose(steps * step, horizon, rel_tol=1e-9):
            below = max(1, math.floor(horizon / step)) * step
            raise MeasurementTimesError(
                f"horizon must be a multiple of time_step = {step:g}, got {shown(horizon)}; the "
                f"nearest are {below:.10g} and {below + step:.10g}"
            )
        # As a person would write a multiple of a step: 3 * 0.1 is 0.3.
        times = tuple(float(f"{t * horizon / steps:.12g}") for t in range(steps + 1))
        return cls(times, unit)

    @property
    def horizon(self) -> int:
        """The number T of the last instant."""
        return len(self.times) - 1

    @cached_property
    def is_even(self) -> bool:
        """Whether all steps are equal; a clock of a single instant has none."""
        steps = np.diff(self.times)
        return not steps.size or bool(np.abs(steps - steps.mean()).max() <= self.slack)

    @cached_property
    def slack(self) -> float:
        """The largest distance between a time that a user writes and the instant that it means.

        It is a billionth of the shortest step, or the effect of rounding to 12 digits if that is
        larger. It is at most a millionth of the step, unless floats cannot resolve this.
        """
        step = min((later - time for time, later in pairwise(self.times)), default=1.0)
        far = max(map(abs, self.times))
        most = max(1e-6 * step, _FLOAT_ROUNDING * far)
        return min(max(1e-9 * step, _ROUNDING * far), most)

    @cached_property
    def trapezoids(self) -> tuple[float, ...]:
        """The weight of each instant in an integral over time, by the trapezoidal rule."""
        steps = np.diff(self.times)
        parts = np.append(steps, 0.0) / 2 + np.append(0.0, steps) / 2
        return tuple(parts.tolist())

    @property
    def has_dates(self) -> bool:
        """Whether times are dates; a clock of a table has no instants, but may have dates."""
        return self.calendar is not None

    @property
    def time_unit(self) -> str:
        """The unit as answers and tables have it: with the start, if there are dates."""
        return str(self.calendar) if self.calendar else self.unit

    @cached_property
    def dates(self) -> tuple[datetime, ...]:
        """The local date and hour of each instant, (T+1,); empty if the clock has no start."""
        return tuple(map(self.calendar.date, self.times)) if self.calendar else ()

    @cached_property
    def dates_in_formulas(self) -> dict[str, tuple[float, ...]]:
        """The parameters `DATES` of models: the value of each for each instant, in local time."""
        parts = [
            (
                each.timetuple().tm_yday,
                each.hour + each.minute / 60 + (each.second + each.microsecond / 1e6) / 3600,
                each.weekday(),
            )
            for each in self.dates
        ]
        columns = ([*map(float, column)] for column in zip(*parts, strict=True))
        return dict(zip(DATES, map(tuple, columns), strict=bool(parts)))

    def without(self, parameters: Mapping[str, T]) -> dict[str, T]:
        """The parameters of a model on this clock without those of the clock and of its dates."""
        dates = self.dates_in_formulas
        return {
            name: value
            for name, value in parameters.items()
            if name not in CLOCK and (name not in dates or value != dates[name])
        }

    @cached_property
    def _written(self) -> dict[str, int]:
        """The instant of each date as it is written; an instant that was not found is not here."""
        return {self.formatted(t): t for t in range(len(self.dates))}

    def dated(self, text: str, name: str = "measurement_times") -> list[int]:
        """The instants of a text with dates, hours of the day and weekdays.

        Entries between commas are united, words of an entry intersected. `name` is the name of the
        value in error messages. Raises `MeasurementTimesError` if the text has anything else, a
        date outside the horizon, or an entry without an instant.
        """
        if text in self._written:
            return [self._written[text]]
        found = joined_times(name, (self._where_all_hold(words, name) for words in groups(text)))
        if not found:
            raise MeasurementTimesError(f"{name} must name dates, got {shown(text)}")
        return found

    def _where_all_hold(self, words: Sequence[str], name: str) -> Iterable[int]:
        calendar = cast("Calendar", self.calendar)
        kept: Iterable[int] = range(len(self.dates))
        for word in words:
            try:
                time = calendar.single(word)
                holds = calendar.condition(word, self.dates) if time is None else None
            except ValueError as error:
                raise MeasurementTimesError(f"{name} {error}") from error
            here = {self.instant(cast("Time", time), name)} if holds is None else ()
            kept = [t for t in kept if (t in here if holds is None else holds(self.dates[t]))]
        if not kept:
            raise MeasurementTimesError(
                f"{name} must name instants of the clock, got none in {' '.join(words)!r}"
            )
        return kept

    def instant(self, time: Time | str | datetime, name: str = "measurement_times") -> int:
        """The instant of a time; `name` is the name of the value in error messages.

        Raises `MeasurementTimesError`, which names the nearest times, if no instant has this time.
        """
        time = as_text(time)
        if isinstance(time, str) and self.calendar:
            found = self.dated(time, name)
            if len(found) > 1:
                ends = f"{self.formatted(found[0])} to {self.formatted(found[-1])}"
                raise MeasurementTimesError(
                    f"{name} must name one instant, got {time} with {len(found)}: {ends}"
                )
            return found[0]
        if isinstance(time, bool) or not isinstance(time, (int, float, np.integer, np.floating)):
            raise MeasurementTimesError(f"{name} must be times, got {shown(time)}")
        after = bisect_left(self.times, time)
        near = [t for t in (after - 1, after) if 0 <= t <= self.horizon]
        nearest = min(near, key=lambda t: abs(self.times[t] - time))
        if abs(self.times[nearest] - time) <= self.slack:
            return nearest
        self.check_is_within(time, name)
        raise MeasurementTimesError(
            f"{name} must be times of the clock, got {self.text(time)}; the nearest are "
            f"{self.listed((self.times[t] for t in near), ' and ')}"
        )

    def check_is_within(self, time: Time, name: str) -> None:
        """Raise a `MeasurementTimesError` if a time lies before the first or after the last."""
        first, last = self.times[0], self.times[-1]
        if not first - self.slack <= time <= last + self.slack:
            raise MeasurementTimesError(
                f"{name} must lie in {self.text(first)}..{self.formatted(self.horizon)}, got "
                f"{self.text(time)}"
            )

    def between(self, first: Time, last: Time) -> range:
        """The instants from one time to another, both included if they are on the clock."""
        start = bisect_left(self.times, first - self.slack)
        return range(start, bisect_right(self.times, last + self.slack))

    def readers(self, *, between: bool = False) -> dict[str, Callable[[str], Any]]:
        """A reader of dates for the column t of a user's table; none if the clock has no start.

        With `between`, dates may also lie between instants and outside the horizon, and remain
        texts for `of_table`.
        """
        calendar = self.calendar
        if calendar is None:
            return {}

        def read(text: str) -> float | str:
            if text.lower() in _MISSING:
                raise MeasurementTimesError(_NO_TIME)
            if between:
                return text
            calendar.elapsed(text)  # raises if a cell has anything else than a date
            return self.times[self.instant(text, "t")]

        return {"t": read}

    def instant_of_t(self, t: float) -> int:
        """The instant of a number in the column t of a user's table; raises as `instant`."""
        if not self.counts:
            return self.instant(t, "t")
        if t != t // 1:
            raise MeasurementTimesError(f"t must be whole numbers without a clock, got {t:.10g}")
        return int(t)

    def nearest(self, times: Iterable[float]) -> list[int]:
        """The instant nearest to each time."""
        own, at = np.array(self.times, np.float64), np.array([*times], np.float64)
        after = np.minimum(np.searchsorted(own, at), own.size - 1)
        before = np.maximum(after - 1, 0)
        near: list[int] = np.where(at - own[before] <= own[after] - at, before, after).tolist()
        return near

    def of_table(
        self,
        given: Sequence[float | str],
        note: Callable[[str], Any] = lambda line: None,
        *,
        any_year: bool = False,
    ) -> list[float]:
        """The times of the column t of a user's table, whose dates may be written in many ways.

        If they do not all lie in the horizon as times and dates of the clock, another reading is
        taken if they all do in one alone, and `note` receives a line; with `any_year` they may be
        the same days of another year. Raises ValueError if a time is missing, if several readings
        are possible, or if only others than the clock's are near.
        """
        for row, time in enumerate(given, 1):
            if not isinstance(time, str) and math.isnan(time):
                raise ValueError(f"{_NO_TIME} (row {row})")
        if self.calendar is None or not given:
            return cast("list[float]", given)
        texts = [
            each if isinstance(each, str) else np.format_float_positional(each, trim="-")
            for each in given
        ]
        read, why = self._each_reading(texts)
        away = {name: self._away(times) for name, times in read.items()}
        fits = [name for name, distance in away.items() if distance <= self.slack]
        both = " or ".join(f"{self.text(read[name][0])} ({name})" for name in fits)
        if OWN_DATES in fits:
            own, other = (read[name] for name in (OWN_DATES, fits[-1]))
            if self._days_apart(own, other) > 1:  # counted from 0, days differ by one
                note(
                    f"t of the table is read as time since the start: {shown(texts[0])} is "
                    f"{self.text(own[0])}; as a day of the year it would be {self.text(other[0])}"
                )
            return own
        if len(fits) > 1:
            got = f"{shown(texts[0])}, which is {both}"
            raise ValueError(f"t must be one date, as 2026-04-01, got {got}")
        if not read:
            raise ValueError(why)
        outside = {name: sum(self._away([t]) > self.slack for t in read[name]) for name in read}
        nearest = min(read, key=lambda name: (outside[name], away[name]))
        if not fits:
            return self._in_other_reading(nearest, read, texts, any_year * [note])
        at = self.text(read[nearest][0])
        note(f"t of the table is read as {nearest}: {shown(texts[0])} is {at}")
        return read[nearest]

    def _days_apart(self, times: Iterable[Time], others: Iterable[Time]) -> int:
        """The largest number of days between the dates of two readings of a column."""
        date = cast("Calendar", self.calendar).date
        pairs = zip(times, others, strict=True)
        return max(abs((date(a).date() - date(b).date()).days) for a, b in pairs)

    def _away(self, times: Iterable[float]) -> float:
        """How far the furthest of some times lies outside the horizon."""
        return max(max(self.times[0] - time, time - self.times[-1], 0.0) for time in times)

    def _each_reading(self, texts: Sequence[str]) -> tuple[dict[str, list[float]], str]:
        """The times of a column in each possible reading, and why the best of the others is not.

        If they lie in the horizon as times and dates of the clock, only days of the year, which are
        as small, are tried besides.
        """
        read, rows, why, is_own = dict[str, list[float]](), -1, "", False
        for name, reader in cast("Calendar", self.calendar).readings(self.times[-1]).items():
            if is_own and name != DAYS_OF_YEAR:
                continue
            times = list[float]()
            try:
                times.extend(map(reader, texts))
            except (MeasurementTimesError, ValueError, OverflowError) as error:
                if len(times) > rows:
                    rows = len(times)
                    why = f"t {str(error).removeprefix('t ')} (row {rows + 1})"
                continue
            read[name] = times
            is_own |= name == OWN_DATES and self._away(times) <= self.slack
        return read, why

    def _in_other_reading(
        self,
        nearest: str,
        read: Mapping[str, list[float]],
        texts: Sequence[str],
        notes: Sequence[Callable[[str], Any]],
    ) -> list[float]:
        """Times outside the horizon; raises ValueError if another reading, or year, is near.

        With `notes`, which receive a line, those of another year are the same days of this year, if
        that is so in one reading alone.
        """
        times, moved = read[nearest], self._in_year_of_start(read, texts)
        row = max(range(len(times)), key=lambda k: self._away(times[k : k + 1]))
        rule = f"t must lie in {self.text(self.times[0])}..{self.formatted(self.horizon)}"
        rule += f", got {shown(texts[row])} (row {row + 1})"
        if notes and len(moved) == 1:
            ((name, own),) = moved.items()
            dates = "" if name == OWN_DATES else f"{name}, of "
            notes[0](
                f"t of the table is read as {dates}the same days of another year: "
                f"{shown(texts[0])} is {self.text(own[0])}"
            )
            return own
        if nearest in moved:
            calendar = cast("Calendar", self.calendar)
            years = calendar.date(times[row]).year - calendar.date(moved[nearest][row]).year
            first = calendar.start
            day = min(first.day, 28) if first.month == 2 else first.day
            start = first.replace(year=first.year + years, day=day)
            raise ValueError(
                f"{rule}, of another year: give --set problem.clock.start={calendar.shown(start)}, "
                f"or write t in {self.unit} since the start, as {unrounded(moved[nearest][row])}"
            )
        if nearest != OWN_DATES:
            raise ValueError(f"{rule}; the nearest are {nearest}: {self.text(times[row])}")
        return times

    def _in_year_of_start(
        self, read: Mapping[str, list[float]], texts: Sequence[str]
    ) -> dict[str, list[float]]:
        """The readings of a column in which the same days of the year of the start are all here."""
        found = dict[str, list[float]]()
        for name, times in read.items():
            if name == OWN_DATES and all(map(NUMBER.fullmatch, texts)):  # elapsed time has no year
                continue
            with contextlib.suppress(ValueError, OverflowError):
                own = cast("Calendar", self.calendar).in_year_of_start(times)
                if self._away(own) <= self.slack:
                    found[name] = own
        return found

    def columns(self, instants: Sequence[int]) -> dict[str, list[Any]]:
        """The columns t and, if the clock has a start, date of a table with these instants."""
        dates = {"date": [self.formatted(t) for t in instants]} if self.calendar else {}
        return {"t": self.times_of(instants)} | dates

    def time(self, instant: int) -> Any:
        """The time of an instant as users read it: a date if the clock has a start."""
        if self.counts:
            return instant
        return self.formatted(instant) if self.calendar else self.times[instant]

    def times_of(self, instants: Iterable[int]) -> list[Time]:
        """The times of some instants, in the same order."""
        return [self.times[t] for t in instants]

    def formatted(self, instant: int) -> str:
        """The time of an instant as text, with the unit, or its date if the clock has a start."""
        return self.listed([self.times[instant]])

    def text(self, time: Time | str) -> str:
        """A time as text without the unit: a date, or a number with up to ten digits.

        A text, which names a date or a sensor, stays as it is.
        """
        if self.calendar is None or isinstance(time, str):
            return unrounded(time)
        try:
            return self.calendar.written(time)
        except (OverflowError, ValueError):  # beyond the year 9999, or not finite
            return unrounded(time)

    def listed(self, times: Iterable[Time | str], between: str = ", ") -> str:
        """Times, or measurements as users read them, as text with the unit if there is a unit.

        Many instants in a row, by one sensor, are a range.

        >>> clock = Clock.regular(6, 0.5, "h")
        >>> clock.listed([0.0, 0.5]), clock.listed([]), clock.listed(["0 ct", "0.5 x-ray"])
        ('0, 0.5 h', '', '0 ct, 0.5 x-ray (t in h)')
        >>> Clock.counting(20).listed([*(f"{t} ct" for t in range(9)), "12 x-ray"])
        '0 to 8 ct, 12 x-ray'
        """
        listed = [*times]
        if all(isinstance(each, str) and " " in each for each in listed):  # late values are behind
            listed.sort(key=lambda each: self.time_and_sensor(each)[0])
        ranges = self.ranges(listed)
        texts = {  # a range once
            ranges.get(each, number): ranges.get(each) or self.text(each)
            for number, each in enumerate(listed)
        }
        text = between.join(texts.values())
        if not self.unit or not listed or self.calendar:
            return text
        return f"{text} (t in {self.unit})" if isinstance(listed[0], str) else f"{text} {self.unit}"

    def in_words(self, measurements: Iterable[Time | str]) -> list[str]:
        """Each measurement as text; a date has its weekday, and a day with hours is named once."""
        words, day = list[str](), ""
        for each in measurements:
            if self.calendar is None:
                words.append(self.text(each))
                continue
            time, sensor = self.time_and_sensor(each)
            moment = self.calendar.date(time)
            before, day = day, f"{moment:%a} {moment.date()}"
            hour = self.calendar.shown(moment).partition("T")[2]
            said = "" if hour and day == before else day
            words.append(" ".join(filter(None, [said, hour, sensor])))
        return words

    def ranges(self, times: Sequence[Time | str]) -> dict[Time | str, str]:
        """The range of each measurement that is one of many instants in a row, by one sensor.

        A sensor that is always on would be a long list, in which other times are not found.
        """
        if len(times) < _LONG_RUN:
            return {}
        instants = dict[str, dict[int, Time | str]]()  # of each sensor
        read = [self.time_and_sensor(each) for each in times]
        near = self.nearest(time for time, _ in read)
        for each, (time, sensor), nearest in zip(times, read, near, strict=True):
            if abs(self.times[nearest] - time) <= self.slack:
                instants.setdefault(sensor, {})[nearest] = each
        runs = dict[tuple[str, int], list[int]]()
        for sensor, own in instants.items():
            for place, t in enumerate(sorted(own)):
                runs.setdefault((sensor, t - place), []).append(t)
        ranges = dict[Time | str, str]()
        for (sensor, _), part in runs.items():
            if len(part) >= _LONG_RUN:
                first, last = (self.text(self.times[part[k]]) for k in (0, -1))
                text = f"{first} to {last} {sensor}".rstrip()
                ranges |= {instants[sensor][t]: text for t in part}
        return ranges

    def duration(self, length: float) -> str:
        """A length of time as text, in the unit of the clock or a smaller one.

        >>> hours = Clock.regular(6, 0.5, "h")
        >>> [hours.duration(each) for each in (8 / 3600, 0.5, 36, 0)], Clock((0, 1)).duration(0.1)
        (['8 s', '30 min', '36 h', '0 h'], '0.1')
        """
        if self.unit not in SECONDS or not length:
            return f"{length:.3g} {self.unit}".rstrip()
        seconds, longest = length * SECONDS[self.unit], SECONDS[self.unit]
        fits = [each for each, size in SECONDS.items() if size <= min(seconds, longest)]
        unit = fits[-1] if fits else "s"
        return f"{seconds / SECONDS[unit]:.3g} {unit}"

    def of_row(self, row: Mapping[Any, Any]) -> Time | str:
        """The measurement of a row of a table as users read it: its time, and its ``sensor``."""
        time: Time | str = self.text(row["t"]) if self.calendar else row["t"]
        return f"{self.text(time)} {row['sensor']}" if row.get("sensor") else time

    def time_and_sensor(self, measurement: Time | str) -> tuple[Time, str]:
        """The time of a measurement as users read it, and its sensor; empty without sensors.

        >>> Clock.counting(12).time_and_sensor("12 x-ray"), Clock.counting(12).time_and_sensor(3)
        ((12.0, 'x-ray'), (3, ''))
        """
        if not isinstance(measurement, str):
            return measurement, ""
        time, _, sensor = measurement.partition(" ")
        calendar = self.calendar
        return calendar.time(calendar.read(time)) if calendar else float(time), sensor

    def by_sensor(self, measurements: Iterable[Time | str]) -> dict[str, list[Time]]:
        """The times of each sensor; a nameless one makes measurements without a sensor, or none.

        >>> clock = Clock.counting(6)
        >>> clock.by_sensor(["0 x-ray", "2 ct", "3 x-ray"]), clock.by_sensor([0, 6])
        ({'ct': [2.0], 'x-ray': [0.0, 3.0]}, {'': [0, 6]})
        """
        times = dict[str, list[Time]]()
        for time, sensor in map(self.time_and_sensor, measurements):
            times.setdefault(sensor, []).append(time)
        return dict(sorted(times.items())) or {"": []}

    def successors(self, spacing: float) -> tuple[int, ...]:
        """For each instant, the first later instant whose time is at least `spacing` later.

        It is T+1 if there is no such instant.
        """
        after = np.array(self.times, np.float64) + spacing - self.slack
        successors = np.searchsorted(self.times, after).tolist()
        return tuple(max(t + 1, later) for t, later in enumerate(successors))

    def ends_of(self, period: str, key: str) -> tuple[int, ...]:
        """For each instant, the first one after its day, or after its week from Monday.

        Raises `MeasurementTimesError` without dates; `key` asks for the period.
        """
        if not self.has_dates:
            raise MeasurementTimesError(
                f"{key} = {shown(period)} needs dates (problem.clock.start)"
            )
        days = [date.date() for date in self.dates]
        keys = [day.isocalendar()[:2] if period == "week" else day for day in days]
        last = {key: t for t, key in enumerate(keys)}
        return tuple(last[key] + 1 for key in keys)

    def regular_times(self, number: int) -> Times:
        """N instants whose times are as evenly spaced as the clock allows; N is 1 to T+1.

        These are the instants nearest to N times that are evenly spaced from the first to the last.
        If two of them would be the same instant, the later one moves to the next. A single time is
        the instant nearest to the middle.
        """
        begin, end = self.times[0], self.times[-1]
        wanted = np.linspace(begin, end, number) if number > 1 else [np.mean((begin, end))]
        chosen = list[int]()
        for left, time in zip(range(number - 1, -1, -1), wanted, strict=True):
            first = chosen[-1] + 1 if chosen else 0
            candidates = np.array(self.times[first : self.horizon + 1 - left])
            chosen.append(first + int(np.abs(candidates - time).argmin()))
        return tuple(chosen)

    def since(self, first: int) -> "Clock":
        """The clock of the instants from `first` on: the same times; instants count from 0."""
        return replace(self, times=self.times[first:], counts=self.counts and not first)


def joined_times(name: str, parts: Iterable[Iterable[int]], most: int = 0) -> list[int]:
    """The instants or points of several entries: few of them may name very many, time and again."""
    found = list[int]()
    for part in parts:
        found += part
        if len(found) > max(most, MOST_NUMBERS):
            rule = f"{name} must name at most {max(most, MOST_NUMBERS):,} times"
            raise MeasurementTimesError(f"{rule}, those of ranges included, got more")
    return found


def plain_time(time: Time) -> Time:
    """The time as a job stores it: 48.0 and -0.0 as the integers 48 and 0, others unchanged.

    The identity of a run depends on how a number is written, so equal times must be written alike.
    """
    is_whole = isinstance(time, float) and time.is_integer() and abs(time) < _EXACT
    return int(time) if is_whole else time
