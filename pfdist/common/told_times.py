"""Times as texts show them."""

from collections.abc import Iterable


def told_time(time: float) -> str:
    """A time as text: instants as whole numbers, other times with up to ten digits.

    >>> told_time(12), told_time(0.5), told_time(3.0)
    ('12', '0.5', '3')
    """
    return f"{time:.10g}"


def told_times(times: Iterable[float], unit: str = "") -> str:
    """Times as text, with their unit if there is a unit.

    >>> told_times([0, 6, 12]), told_times([0.0, 0.5], "h"), told_times([], "h")
    ('0, 6, 12', '0, 0.5 h', '')
    """
    text = ", ".join(map(told_time, times))
    return f"{text} {unit}" if unit and text else text
