"""The lines of a summary about the lower bound of a set."""

import math
from typing import Any

from pfdist.cli.layout import paragraph, wrapped_lines
from pfdist.common.rounding import rounded


def proof_lines(gap: dict[str, Any], measurements: int) -> list[str]:
    """Say how much lower the error of other times can be, or why nobody knows.

    Parameters
    ----------
    gap : dict
        Fields of `pfdist.bounds.gap.Gap` as JSON, and ``confidence``.
    measurements : int
        Number of measurements of the set.
    """
    if gap["reason"]:
        return wrapped_lines("no lower bound", gap["reason"])
    times = "time" if measurements == 1 else f"{measurements} times"
    limit = ""
    if gap["bound_error"]:
        at_most = _percent(_rounded_up(gap["gap_at_most"]))
        limit = f" ({100 * gap['confidence']:.3g}\xa0%:\xa0{at_most})"
    return paragraph(
        f"No other {times} can lower the error by more than another {_percent(gap['gap'])}{limit}."
    )


def _rounded_up(fraction: float) -> float:
    """Round to the next larger number of two digits: a limit must hold as it is printed."""
    if not fraction:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(fraction)) - 1)
    return math.ceil(fraction / unit * (1 - 1e-12)) * unit


def _percent(fraction: float) -> str:
    return f"{rounded(100 * fraction, 2)}\xa0%"
