"""Times, spans of time and sizes as texts show them."""

import math
from collections.abc import Iterable, Mapping
from typing import Any

from pfdist.common.calendar import calendar_of


def formatted_time(time: float | str, unit: str = "") -> str:
    """A time as text: a date if the unit has a start, or else a number with up to ten digits.

    A text, which names a date or a sensor, stays as it is.

    >>> formatted_time(12), formatted_time(0.5), formatted_time(3.0, "h")
    ('12', '0.5', '3')
    >>> formatted_time(3.0, "h since 2026-04-01T08:00")
    '2026-04-01T11:00'
    """
    if isinstance(time, str):
        return time
    calendar = calendar_of(unit)
    return calendar.written(time) if calendar else f"{time:.10g}"


def formatted_times(times: Iterable[float | str], unit: str = "", between: str = ", ") -> str:
    """Times as text, with their unit if there is a unit.

    >>> formatted_times([0, 6, 12]), formatted_times([0.0, 0.5], "h"), formatted_times([], "h")
    ('0, 6, 12', '0, 0.5 h', '')
    >>> formatted_times(["0 ct", "0.5 x-ray"], "h")
    '0 ct, 0.5 x-ray (t in h)'
    """
    listed = [*times]
    text = between.join(formatted_time(time, unit) for time in listed)
    if not unit or not listed or calendar_of(unit):
        return text
    return f"{text} (t in {unit})" if isinstance(listed[0], str) else f"{text} {unit}"


def time_and_sensor(time: float | str, unit: str = "") -> tuple[float, str]:
    """A measurement's time as a number, and the name of its sensor; empty without sensors.

    >>> time_and_sensor("12 x-ray"), time_and_sensor(0.5)
    ((12.0, 'x-ray'), (0.5, ''))
    >>> time_and_sensor("2026-04-02 x-ray", "d since 2026-04-01")
    (1.0, 'x-ray')
    """
    if not isinstance(time, str):
        return time, ""
    written, _, sensor = time.partition(" ")
    calendar = calendar_of(unit)
    return calendar.time(calendar.read(written)) if calendar else float(written), sensor


def time_of(row: Mapping[Any, Any]) -> float | str:
    """The time of a row of a table: its ``date``, or its ``t`` where the clock has no dates."""
    found: float | str = row["date"] if "date" in row else row["t"]
    return found


def measurement_of(row: Mapping[Any, Any]) -> float | str:
    """The measurement of a row of a table: its time, and its ``sensor`` if there are any."""
    sensor = row.get("sensor")
    return f"{formatted_time(time_of(row))} {sensor}" if sensor else time_of(row)


def by_sensor(measurements: Iterable[float | str], unit: str = "") -> dict[str, list[float]]:
    """The times of each sensor; one nameless sensor makes measurements without a sensor, or none.

    >>> by_sensor(["0 x-ray", "2 ct", "3 x-ray"]), by_sensor([0, 6]), by_sensor([])
    ({'ct': [2.0], 'x-ray': [0.0, 3.0]}, {'': [0, 6]}, {'': []})
    """
    times = dict[str, list[float]]()
    for time, sensor in (time_and_sensor(each, unit) for each in measurements):
        times.setdefault(sensor, []).append(time)
    return dict(sorted(times.items())) or {"": []}


_SPANS = (("day", 86_400.0), ("h", 3600.0), ("min", 60.0), ("s", 1.0))
_SIZES = (("GB", 10**9), ("MB", 10**6), ("kB", 10**3))


def formatted_seconds(seconds: float) -> str:
    """Seconds with two significant digits below 10, otherwise whole; empty if they are unknown.

    >>> formatted_seconds(0.0276), formatted_seconds(1234.5), formatted_seconds(math.nan)
    ('0.028', '1,234', '')
    """
    if math.isnan(seconds):
        return ""
    return f"{seconds:.2g}" if seconds < 9.95 else f"{seconds:,.0f}"


def formatted_age(seconds: float) -> str:
    """A span of time in the largest unit that fits; a span below zero is 0 s.

    >>> [formatted_age(seconds) for seconds in (12.3, 3 * 3600 + 1, 86_400, 40 * 86_400)]
    ['12 s', '3 h', '1 day', '40 days']
    """
    for unit, length in _SPANS:
        number = int(seconds // length)
        if number > 0:
            return f"{number:,} {unit}" + ("s" if unit == "day" and number > 1 else "")
    return "0 s"


def formatted_size(count: int) -> str:
    """A number of bytes in the largest unit that fits.

    >>> [formatted_size(size) for size in (999, 340_000, 1_200_000, 12_000_000)]
    ['999 B', '340 kB', '1.2 MB', '12 MB']
    """
    for unit, length in _SIZES:
        if count >= length:
            size = count / length
            return f"{size:.1f} {unit}" if size < 9.95 else f"{size:,.0f} {unit}"
    return f"{count} B"
