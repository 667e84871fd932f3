"""Numbers as text, rounded to their significant digits."""

import math
from collections.abc import Callable
from decimal import Decimal

_DIGITS = 5  # significant digits of a number without an error
_DIGITS_OF_UNKNOWN = 3  # significant digits of a number with an unknown error
_SMALLEST, _LARGEST = 1e-4, 1e6  # between these no exponent is written
_SMALLEST_PLACE = -5  # a zero is not written with more decimals than the smallest of these numbers
WIDE = 0.1  # of a value: two sides that lie further apart are limits
_MOST_DIGITS = 12  # beyond them a double's own rounding begins to show


def rounded(value: float | None, digits: int = _DIGITS) -> str:
    """A number without a standard error, as text with a few significant digits.

    None, like NaN, is unknown.

    >>> rounded(31.2), rounded(1234567.0), rounded(-0.00001), rounded(0.0)
    ('31.200', '1.2346e+06', '-1.0000e-05', '0')
    """
    if value is None or not math.isfinite(value):
        return _word(value)
    return _text(value, _exponent(value) - digits + 1) if value else "0"


def unrounded(value: float | str) -> str:
    """A number with up to ten digits; a text as it is.

    >>> unrounded(12), unrounded(0.5), unrounded(3.0), unrounded("12 ct")
    ('12', '0.5', '3', '12 ct')
    """
    return value if isinstance(value, str) else f"{value:.10g}"


def with_error(value: float | None, error: float | None) -> str:
    """A value ± its standard error as text, both to the second significant digit of the error.

    None, like NaN, is unknown. An error of 0 belongs to an exact value, and is left out.

    >>> with_error(22.7345, 0.0304), with_error(1234.5, 249.0)
    ('22.735 ± 0.030', '1230 ± 250')
    >>> with_error(1.234e108, 4e107), with_error(1e-9, 3e-11)
    ('(1.23 ± 0.40)e+108', '(1.000 ± 0.030)e-09')
    """
    if value is None or not math.isfinite(value) or error == 0.0:
        return rounded(value)
    if error is None or not math.isfinite(error):
        return f"{rounded(value)} ± {_word(error)}"
    place, size = _last_place(error), max(abs(value), error)
    if _exponent(size) - place >= _MOST_DIGITS:
        return f"{rounded(value)} ± {error:.1e}"
    if _SMALLEST <= size < _LARGEST:
        return f"{_fixed(value, place)} ± {_fixed(error, place)}"
    exponent = int(f"{size:.{_exponent(size) - place}e}".partition("e")[2])  # once it is rounded
    # As decimals: a power of ten may be too large or too small for a double.
    mantissa, error_part = (Decimal(part).scaleb(-exponent) for part in (value, error))
    decimals = max(0, exponent - place)
    return f"({mantissa:.{decimals}f} ± {error_part:.{decimals}f})e{exponent:+03d}"


def with_interval(value: float | None, low: float | None, high: float | None) -> tuple[str, ...]:
    """A value and the ends of its interval as texts, to two significant digits of the half width.

    None, like NaN, is unknown.

    >>> with_interval(17.6321, 16.2, 19.04)
    ('17.6', '16.2', '19.0')
    """
    finite_values = [
        part for part in (value, low, high) if part is not None and math.isfinite(part)
    ]
    if len(finite_values) < 3:
        return rounded(value, _DIGITS_OF_UNKNOWN), rounded(low), rounded(high)
    half = (finite_values[2] - finite_values[1]) / 2
    place = _last_place(half) if half > 0.0 else 0
    if half > 0.0 and max(map(_exponent, finite_values)) - place < _MOST_DIGITS:
        return tuple(_text(part, place) for part in finite_values)
    return rounded(value), rounded(low), rounded(high)


def with_sides(value: float | None, low: float | None, high: float | None, unit: str = "") -> str:
    """A lower side as a limit, if the upper side is far away; else nothing.

    Parameters
    ----------
    value : float or None
        That of the lower side.
    low, high : float or None
        Lower 95 % limit of the lower side, and upper one of the upper side.
    unit : str

    Examples
    --------
    >>> with_sides(15.2, 14.93, 88.7, "nats"), with_sides(15.2, 14.9, math.inf)
    ('at least 14.9 nats (at most 88.7)', 'at least 14.9')
    >>> with_sides(15.2, 14.9, 15.5), with_sides(15.2, 14.9, 16.3)
    ('', '')
    """
    if value is None or low is None or high is None:
        return ""
    if not (high - low > WIDE * abs(value) and high - value > 3 * (value - low)):
        return ""
    least = f"at least {_limit(max(low, 0.0), math.floor)} {unit}".rstrip()
    return f"{least} (at most {_limit(high, math.ceil)})" if math.isfinite(high) else least


def _limit(value: float, to_whole: Callable[[float], int]) -> str:
    """A limit with three digits, rounded to its safe side."""
    if not value:
        return "0"
    place = _exponent(value) - 2
    return _text(to_whole(value / 10.0**place) * 10.0**place, place)


def _word(value: float | None) -> str:
    if value is None or math.isnan(value):
        return "unknown"
    return "infinite" if value > 0 else "-infinite"


def _exponent(value: float) -> int:
    """Exponent of the first significant digit; 0 for 0."""
    return Decimal(value).adjusted() if value else 0


def _last_place(error: float) -> int:
    """Exponent of the second significant digit, once the error is rounded to it."""
    return int(f"{error:.1e}".partition("e")[2]) - 1


def _text(value: float, place: int) -> str:
    """A number rounded to a decimal place, with an exponent if the number is large or small."""
    nearest = round(value, -place) + 0.0
    if nearest and not _SMALLEST <= abs(nearest) < _LARGEST:
        return f"{nearest:.{max(0, _exponent(nearest) - place)}e}"
    return "0" if not nearest and place < _SMALLEST_PLACE else _fixed(value, place)


def _fixed(value: float, place: int) -> str:
    nearest = round(value, -place) + 0.0  # no minus sign before a zero
    return f"{nearest:.{max(0, -place)}f}"
