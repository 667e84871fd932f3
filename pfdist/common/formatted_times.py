"""Times as texts show them."""

from collections.abc import Iterable


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
    text = ", ".join(map(formatted_time, times))
    return f"{text} {unit}" if unit and text else text
