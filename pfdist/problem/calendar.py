"""Dates of times, which count a unit from a start.

As a text, in tables and answers, a calendar is a unit of the CF conventions (cfconventions.org,
section 4.4.1) with a time zone: ``min since 2026-04-01T08:00 Europe/Brussels``. Without a time zone
all days have 24 hours. With one, times are elapsed time, and dates and hours are local.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime, time, timedelta, tzinfo
from fractions import Fraction
from functools import partial
from typing import Any
from zoneinfo import ZoneInfo, ZoneInfoNotFoundError

from pfdist.errors import MeasurementTimesError, shown

SECONDS = {"s": 1, "min": 60, "h": 3600, "d": 86_400, "w": 604_800}
"""The length of each unit of a clock with dates."""
_WEEKDAYS = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")
_DATE = re.compile(r"\d{4}-\d\d-\d\d")
NUMBER = re.compile(r"[+-]?\d{1,40}(\.\d{1,40})?")
_HOUR = re.compile(r"\d\d:\d\d(:\d\d)?")
_MOMENT = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d(:\d\d(\.\d{1,6})?)?(Z|[+-]\d\d:\d\d)?")
_UNIT = re.compile(rf"({'|'.join(SECONDS)}) since (\d{{4}}-\d\d-\d\d(?:T\S+)?)(?: (\S+))?")
_DATED = re.compile(r"\.\.|\d{4}-\d\d-\d\d")
_WITH_SPACE = re.compile(r"(?<=\d{4}-\d\d-\d\d) (?=\d\d:\d\d)")
_AROUND_DOTS = re.compile(r"\s*\.\.\s*")
OWN_DATES, DAYS_OF_YEAR = "dates and times of the clock", "days of the year"
_NUMBERED = {  # number, of how many seconds, that 1970 has: numbers that are dates
    "seconds since 1970": ("1", "0"),
    "milliseconds since 1970": ("1e-3", "0"),
    "microseconds since 1970": ("1e-6", "0"),
    "nanoseconds since 1970": ("1e-9", "0"),
    "Julian dates": ("86400", "2440587.5"),
    "modified Julian dates": ("86400", "40587"),
}
_WRITTEN = {  # dates that are not those of ISO 8601
    "year month day": r"(?P<y>\d{4})(?P<m>\d\d)(?P<d>\d\d)",
    "day.month.year": r"(?P<d>\d\d?)\.(?P<m>\d\d?)\.(?P<y>\d{4})",
    "day/month/year": r"(?P<d>\d\d?)/(?P<m>\d\d?)/(?P<y>\d{4})",
    "month/day/year": r"(?P<m>\d\d?)/(?P<d>\d\d?)/(?P<y>\d{4})",
    "year/month/day": r"(?P<y>\d{4})/(?P<m>\d\d?)/(?P<d>\d\d?)",
}
_THEN_HOUR = r"(?:[ T]?(?P<H>\d\d|\d(?=:)):?(?P<M>\d\d)?:?(?P<S>\d\d)?)?"
_SPELLED = (
    "must name dates, as {0}, ranges of dates, as {0}..{1}, hours of the day, as 08:00..18:00, or "
    "weekdays, as mon..fri, because the clock has a start; got {2}"
)


@dataclass(frozen=True)
class Calendar:
    """The date of each time, which counts a unit from a start."""

    unit: str  # a key of `SECONDS`
    start: datetime  # with a time zone, or local time without daylight saving
    by_days: bool = False  # whether all instants are midnights, which are written without an hour

    @classmethod
    def starting(
        cls, start: str, unit: str, timezone: str = "", *, by_days: bool = False
    ) -> "Calendar":
        """The calendar that starts at a written date.

        Raises ValueError, which begins with ``timezone`` or ``start``.
        """
        try:
            zone = ZoneInfo(timezone) if timezone else None
        except (ZoneInfoNotFoundError, ValueError, OSError) as error:
            raise ValueError(
                f"timezone must be a name of the IANA database, as Europe/Brussels, got "
                f"{shown(timezone)}; `pip install tzdata` adds names that this machine lacks"
            ) from error
        try:
            return cls(unit, _moment(start, zone), by_days)
        except ValueError as error:
            raise ValueError(f"start {error}") from error

    def __str__(self) -> str:
        """The unit with the start, from which `calendar_of` makes the calendar again."""
        zone = self.start.tzinfo
        return f"{self.unit} since {self.written(0)}" + (f" {zone}" if zone else "")

    def date(self, time: float) -> datetime:
        """The local date and hour of a time; raises OverflowError beyond the year 9999."""
        elapsed = timedelta(microseconds=round(time * SECONDS[self.unit] * 1_000_000))
        moment, zone = _in_utc(self.start) + elapsed, self.start.tzinfo
        return moment.astimezone(zone) if zone else moment.replace(tzinfo=None)

    def time(self, moment: datetime) -> float:
        """The time of a date and hour, in the unit."""
        return self._elapsed(moment) / timedelta(seconds=SECONDS[self.unit])

    def readings(self, last: float) -> dict[str, Callable[[str], float]]:
        """The possible readings of texts in a table, each with a function from a text to its time.

        A function raises ValueError for another text. Numbers such as seconds since 1970 are in
        UTC, or without a time zone in local time. Days of the year are those from the start on, if
        the horizon, which ends at `last`, has one of each.
        """
        own = SECONDS[self.unit]

        def number(name: str, text: str) -> float:
            size, origin = map(Fraction, _NUMBERED[name])
            since_1970 = (Fraction(_matched(NUMBER.pattern, text)[0]) - origin) * size
            return float(round(since_1970 - Fraction(_in_utc(self.start).timestamp()), 6)) / own

        def written(name: str, text: str) -> float:
            found = _matched(_WRITTEN[name] + _THEN_HOUR, text)
            y, m, d, *hour = (found[each] or "0" for each in "ymdHMS")
            at = ":".join(each.zfill(2) for each in hour)
            return self.time(self.read(f"{y}-{m:0>2}-{d:0>2}T{at}"))

        def day_of_year(text: str) -> float:
            day = float(_matched(NUMBER.pattern, text)[0])
            if not 1 <= day < 367:
                raise ValueError(f"must be a day of the year, got {text}")
            starts = (self.start.replace(year=self.start.year + k, month=1, day=1) for k in (0, 1))
            midnights = (datetime.combine(each, time(), self.start.tzinfo) for each in starts)
            both = [self.time(each + timedelta(day - 1)) for each in midnights]
            return both[both[0] < 0]

        found: dict[str, Callable[[str], float]] = {OWN_DATES: self.elapsed}
        found |= {name: partial(number, name) for name in _NUMBERED}
        found |= {name: partial(written, name) for name in _WRITTEN}
        if last * own < 365 * SECONDS["d"]:
            found[DAYS_OF_YEAR] = day_of_year
        return found

    def in_year_of_start(self, moments: Sequence[float]) -> list[float]:
        """The same days and hours, the earliest in the year that begins with the start.

        Raises ValueError if a day is missing then, as 29 February.
        """
        dates = [*map(self.date, moments)]
        years = self.start.year - min(dates).year
        years += min(dates).replace(year=self.start.year) < self.start
        return [self.time(each.replace(year=each.year + years)) for each in dates]

    def written(self, time: float) -> str:
        """The date and hour of a time as a text; with its offset in an hour that occurs twice."""
        return self.shown(self.date(time))

    def shown(self, moment: datetime) -> str:
        """A local date and hour as a text."""
        if self.by_days and moment.time() == time():
            return moment.date().isoformat()
        is_whole = not (moment.second or moment.microsecond)
        own = moment if _is_ambiguous(moment) else moment.replace(tzinfo=None)
        return own.isoformat(timespec="minutes" if is_whole else "auto")

    def read(self, text: str) -> datetime:
        """The date and hour that a text names, midnight without an hour.

        Raises ValueError for any other text, and for an hour that the time zone skips or repeats.
        """
        return _moment(text, self.start.tzinfo)

    def elapsed(self, text: str) -> float:
        """The time of a written date or number; raises `MeasurementTimesError`."""
        try:
            return float(text) if NUMBER.fullmatch(text) else self.time(self.read(text))
        except ValueError as error:
            raise MeasurementTimesError(f"t {error}") from error

    def single(self, word: str) -> float | None:
        """The time that a word names: a date with its hour, or a number; None for other words."""
        if _MOMENT.fullmatch(word):
            return self.time(self.read(word))
        return float(word) if NUMBER.fullmatch(word) else None

    def condition(self, word: str, dates: Sequence[datetime]) -> Callable[[datetime], bool]:
        """Whether a date fulfils a word: a date, a weekday, or a range of dates, hours or weekdays.

        Ranges include both ends. `dates` are those of the clock's instants. Raises ValueError for
        any other word, and for a date that lies outside of these.
        """
        ends = (dates[0], dates[-1])
        begin, dots, end = word.partition("..")
        names = (begin, end) if dots else (begin, begin)
        if all(each.lower() in _WEEKDAYS for each in names):
            first, last = (_WEEKDAYS.index(each.lower()) for each in names)
            days = {(first + k) % 7 for k in range((last - first) % 7 + 1)}
            return lambda moment: moment.weekday() in days
        if dots and all(map(_HOUR.fullmatch, names)):
            low, high = (_read(time.fromisoformat, each) for each in names)
            if low <= high:
                return lambda moment: low <= moment.time() <= high
            return lambda moment: moment.time() >= low or moment.time() <= high  # past midnight
        if all(_DATE.fullmatch(each) or _MOMENT.fullmatch(each) for each in names):
            after, before = (self._side(each, ends) for each in names)
            return lambda moment: after(moment) >= 0 >= before(moment)
        raise ValueError(_SPELLED.format(*map(self.shown, ends), shown(word)))

    def _side(self, text: str, ends: tuple[datetime, datetime]) -> Callable[[datetime], int]:
        """Whether a date lies before, on or after a written day or moment: -1, 0 or 1."""
        is_day = bool(_DATE.fullmatch(text))
        wanted: Any = _read(date.fromisoformat, text) if is_day else self._elapsed(self.read(text))

        def compared(moment: datetime) -> int:
            own: Any = moment.date() if is_day else self._elapsed(moment)
            return int(own > wanted) - int(own < wanted)

        first, last = ends
        if not compared(first) <= 0 <= compared(last):
            raise ValueError(
                f"must lie in the horizon, {self.shown(first)}..{self.shown(last)}, got {text}"
            )
        return compared

    def _elapsed(self, moment: datetime) -> timedelta:
        # Python subtracts moments of one zone as if it had no daylight saving.
        return _in_utc(moment) - _in_utc(self.start)


def calendar_of(unit: str) -> Calendar | None:
    """The calendar of the text of a unit with a start; None for any other unit.

    >>> calendar_of("d since 2026-04-01").written(10), calendar_of("d")
    ('2026-04-11', None)
    """
    found = _UNIT.fullmatch(unit)
    if not found:
        return None
    name, start, zone = found.groups()
    return Calendar.starting(start, name, zone or "", by_days="T" not in start)


def groups(text: str) -> list[list[str]]:
    """The words of each part of a text between commas.

    >>> groups("mon..fri 08:00 .. 18:00, 2026-04-11 09:30")
    [['mon..fri', '08:00..18:00'], ['2026-04-11T09:30']]
    """
    joined = _WITH_SPACE.sub("T", _AROUND_DOTS.sub("..", text))
    return [words for part in joined.split(",") if (words := part.split())]


def names_dates(text: str) -> bool:
    """Whether a text has a date, or a range with two dots, which only clocks with dates read."""
    return bool(_DATED.search(text))


def _moment(text: str, zone: tzinfo | None) -> datetime:
    text = _WITH_SPACE.sub("T", text)
    if not (_DATE.fullmatch(text) or _MOMENT.fullmatch(text)):
        hint = "; hours are 00:00 to 23:59" * text.lower().rstrip(".").endswith(("am", "pm"))
        rule = "must be a date, as 2026-04-01 or 2026-04-01T08:00"
        raise ValueError(f"{rule}, got {shown(text)}{hint}")
    moment: datetime = _read(datetime.fromisoformat, text)
    if moment.tzinfo is not None:
        if zone is None:
            raise ValueError(f"must be a local time, because the clock has no timezone, got {text}")
        return moment.astimezone(zone)
    moment = moment.replace(tzinfo=zone)
    if not _is_ambiguous(moment):
        return moment
    both = [moment.replace(fold=fold).astimezone(UTC).astimezone(zone) for fold in (0, 1)]
    if both[0].replace(tzinfo=None) != moment.replace(tzinfo=None):
        hours = " and ".join(f"{each:%Y-%m-%dT%H:%M}" for each in sorted(both, key=_in_utc))
        raise ValueError(
            f"must exist in {zone}, whose clocks are put forward, got {text}; {hours} exist"
        )
    hours = " or ".join(each.isoformat(timespec="minutes") for each in both)
    raise ValueError(f"must be one moment in {zone}, got {text}: write {hours}")


def _matched(pattern: str, text: str) -> "re.Match[str]":
    if not (found := re.fullmatch(pattern, text)):
        raise ValueError(f"must be written as in the other rows, got {shown(text)}")
    return found


def _read(read: Callable[[str], Any], text: str) -> Any:
    try:
        return read(text)
    except ValueError as error:
        raise ValueError(f"must be dates and hours that exist, got {text}: {error}") from error


def _in_utc(moment: datetime) -> datetime:
    """A moment in UTC, where a local time without a time zone is put, too."""
    return moment.astimezone(UTC) if moment.tzinfo else moment.replace(tzinfo=UTC)


def _is_ambiguous(moment: datetime) -> bool:
    """Whether an hour occurs twice; an hour that is skipped counts, too."""
    return moment.utcoffset() != moment.replace(fold=1 - moment.fold).utcoffset()
