"""The sentence about how much lower the error of other times can be."""

import math
from collections.abc import Mapping
from typing import Any

from pfdist.common.rounding import rounded

_ROUNDING = 1e-9  # error of exact values


NO_LIMITS = "The bound leaves out most and minimum_spacing of single sensors."
"""What a bound says if sensors have such limits."""


def gap_sentence(gap: Mapping[str, Any], measurements: int, *, is_constrained: bool = False) -> str:
    """The sentence about how much lower the error of other times can be, if there is a bound.

    `gap` has the fields of `pfdist.bounds.gap.Gap` as JSON, and ``confidence``. `measurements` is
    the number of measurements of the set, and `is_constrained` says whether other constraints
    exclude some times. Numbers have no-break spaces.

    >>> gap = {"budget": 4, "gap": 0.0, "bound_error": 0.0}
    >>> gap_sentence(gap, 4)
    'No other 4 times have a lower expected error.'
    >>> gap_sentence(gap, 3)
    'No other times that cost no more have a lower expected error.'
    >>> gap_sentence({**gap, "budget": 1}, 1, is_constrained=True)
    'No other time that the constraints allow has a lower expected error.'
    """
    times = "time" if measurements == 1 else f"{measurements} times"
    conditions = ["that the constraints allow"] if is_constrained else []
    if gap["budget"] != measurements:  # the budget counts money
        times, conditions = "times", ["that cost no more", *conditions]
    have = "has" if times == "time" else "have"
    times = " ".join([times, " and ".join(conditions)]).rstrip()
    if not gap["bound_error"] and gap["gap"] < _ROUNDING:
        return f"No other {times} {have} a lower expected error."
    limit = ""
    if gap["bound_error"]:
        at_most = _percent(rounded_up(gap["gap_at_most"]))
        limit = f" ({100 * gap['confidence']:.3g}\xa0%:\xa0{at_most})"
    lower = f"can lower the error by more than another {_percent(gap['gap'])}"
    return f"No other {times} {lower}{limit}."


def rounded_up(fraction: float) -> float:
    """The next larger number of two digits: a limit must hold as it is printed.

    >>> rounded_up(0.0441), rounded_up(0.0)
    (0.045, 0.0)
    """
    if fraction < _ROUNDING:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(fraction)) - 1)
    return math.ceil(fraction / unit * (1 - 1e-12)) * unit


def _percent(fraction: float) -> str:
    return f"{rounded(100 * fraction, 2)}\xa0%"
