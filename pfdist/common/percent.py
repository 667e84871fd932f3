"""Numbers of a JSON answer as text. None stands for an unknown or infinite number."""

import math
from collections.abc import Mapping

from pfdist.common.rounding import rounded, with_interval

HEAVY = 0.25
"""If 1 % of the draws carry more than this share of an expected MSE, its interval is too narrow."""


def cost(expected_mse: float | None) -> float:
    """An expected MSE of an answer, in which None stands for an infinite value."""
    return math.inf if expected_mse is None else expected_mse


def times_100(fraction: float | None) -> float | None:
    """A fraction in per cent."""
    return None if fraction is None else 100 * fraction


def percent(fraction: float | None, decimals: int = 2) -> str:
    """A fraction as text in per cent."""
    if fraction is None:
        return "unknown"
    per_cent = 100 * fraction
    if abs(per_cent) < 0.5 * 10.0**-decimals:
        per_cent = 0.0  # without a minus sign
    return f"{per_cent:.{decimals}f} %" if abs(per_cent) < 1e6 else f"{rounded(per_cent, 3)} %"


def particle_loss_text(loss: float, limit: float) -> str:
    """The loss by a finite number of particles, and its upper 95 % limit, in words.

    >>> particle_loss_text(0.0056, 0.018)
    '0.56 % of the expected MSE, at most 1.80 % (95 %)'
    """
    low, high = percent(max(0.0, loss)), percent(min(1.0, max(0.0, loss, limit)))
    return f"{low} of the expected MSE, at most {high} (95 %)"


def percent_with_interval(
    fraction: float | None, interval: list[float | None], unit: str = ""
) -> str:
    """A fraction in per cent with its 95 % interval, as text.

    `interval` has the lower and the upper end. `unit` follows the per cent sign, for instance
    `` of draws``.
    """
    value, low, high = with_interval(*(times_100(part) for part in (fraction, *interval)))
    return f"{value} %{unit}  (95 %: {range_of(low, high)})"


def heavy_tail_warning(shares: Mapping[str, float | None]) -> str:
    """Warning that few draws carry much of an expected MSE; empty if there is no need.

    `shares` has the share of the expected MSE that 1 % of the draws carry, by the name of the set.
    The name of a single set may be empty.
    """
    carried = [
        f"{percent(share, 0)} of the error{f' of {name}' if name else ''}"
        for name, share in shares.items()
        if share is not None and share > HEAVY
    ]
    rest = "95 % intervals are too narrow; take more draws"
    return f"1 % of the draws carry {', '.join(carried)}: {rest}" if carried else ""


def range_of(low: str, high: str) -> str:
    """An interval as text, or "unknown" if both ends are unknown."""
    return low if low == high == rounded(None) else f"{low} to {high}"
