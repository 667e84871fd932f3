"""Seconds, spans of time and sizes of files as texts show them."""

import math

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
