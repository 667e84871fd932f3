"""Times as texts show them."""

from collections.abc import Iterable, Mapping
from typing import Any


def formatted_time(time: float | str) -> str:
    """A time as text: instants as whole numbers, other times with up to ten digits.

    A text, which names a time and a sensor, stays as it is.

    >>> formatted_time(12), formatted_time(0.5), formatted_time(3.0)
    ('12', '0.5', '3')
    """
    return time if isinstance(time, str) else f"{time:.10g}"


def formatted_times(times: Iterable[float | str], unit: str = "") -> str:
    """Times as text, with their unit if there is a unit.

    >>> formatted_times([0, 6, 12]), formatted_times([0.0, 0.5], "h"), formatted_times([], "h")
    ('0, 6, 12', '0, 0.5 h', '')
    """
    listed = [*times]
    text = ", ".join(map(formatted_time, listed))
    return f"{text} {unit}" if unit and listed and not isinstance(listed[0], str) else text


def time_and_sensor(time: float | str) -> tuple[float, str]:
    """A measurement's time, and the name of its sensor; the name is empty without sensors.

    >>> time_and_sensor("12 x-ray"), time_and_sensor(0.5)
    ((12.0, 'x-ray'), (0.5, ''))
    """
    if not isinstance(time, str):
        return time, ""
    number, _, sensor = time.rpartition(" ")
    return float(number), sensor


def measurement_of(row: Mapping[Any, Any]) -> float | str:
    """The measurement of a row of a table: its time ``t``, and its ``sensor`` if there are any."""
    sensor = row.get("sensor")
    return f"{formatted_time(row['t'])} {sensor}" if sensor else row["t"]


def times_of(measurements: Iterable[float | str]) -> list[float]:
    """The times of measurements, each once, in ascending order.

    >>> times_of(["0 ct", "0 x-ray", "3 ct"])
    [0.0, 3.0]
    """
    return sorted({time_and_sensor(measurement)[0] for measurement in measurements})
