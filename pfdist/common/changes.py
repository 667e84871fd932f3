"""Changes of an error in words, with their intervals."""

import math
from collections.abc import Sequence

from pfdist.common.rounding import with_interval


def change_of(gain: float, interval: Sequence[float | None]) -> str:
    """How far an error lies below or above another, with its 95 % interval.

    Parameters
    ----------
    gain : float
        Relative; negative if the error is higher.
    interval : list of float or None
        Lower and upper end; None and infinite ends are unknown, equal ends exact.

    Examples
    --------
    >>> change_of(0.05, [0.01, 0.09]), change_of(-0.05, [-0.05, -0.05])
    ('5.0 % lower (95 % CI 1.0 to 9.0 %)', '5.0000 % higher (exact)')
    >>> change_of(-0.05, [-0.09, 0.01])
    '5.0 % higher (95 % CI -1.0 to 9.0 %)'
    >>> change_of(0.05, [math.nan, math.nan])
    '5.00 % lower (too few draws for an interval)'
    """
    low, high = interval
    side = "lower" if gain >= 0 else "higher"
    if low is None or high is None or not math.isfinite(high - low):
        value, *_ = with_interval(100 * abs(gain), None, None)
        return f"{value} % {side} (too few draws for an interval)"
    ends = [low, high] if gain >= 0 else [-high, -low]
    value, least, most = with_interval(*(100 * part for part in (abs(gain), *ends)))
    if low == high:
        return f"{value} % {side} (exact)"
    return f"{value} % {side} (95 % CI {least} to {most} %)"


def is_clear(interval: Sequence[float | None]) -> bool:
    """Whether an interval does not contain 0, as far as it is known."""
    low, high = interval
    return low is None or high is None or not low <= 0.0 <= high or low == high


def effect(
    gain: float, interval: Sequence[float | None], other: str, what: str = "the expected MSE"
) -> str:
    """How far an error lies below that of other times, or that there is no clear difference.

    Parameters
    ----------
    gain, interval
        As for `change_of`.
    other : str
        The other times.
    what : str
        Which error.

    Examples
    --------
    >>> effect(0.05, [0.01, 0.09], "the plan")
    'The expected MSE is 5.0 % lower (95 % CI 1.0 to 9.0 %) than with the plan'
    >>> effect(0.05, [-0.01, 0.11], "the plan")
    'No clear difference from the plan; the expected MSE is 5.0 % lower (95 % CI -1.0 to 11.0 %)'
    """
    change = f"{what} is {change_of(gain, interval)}"
    if is_clear(interval):
        return f"{change[0].upper()}{change[1:]} than with {other}"
    return f"No clear difference from {other}; {change}"
