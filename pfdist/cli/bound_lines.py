"""The lines of a summary about the lower bound of a set."""

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
        limit = f" ({100 * gap['confidence']:.3g}\xa0%: {_percent(gap['gap_at_most'])})"
    return paragraph(
        f"No other {times} can lower the error by more than another {_percent(gap['gap'])}{limit}."
    )


def _percent(fraction: float) -> str:
    return f"{rounded(100 * fraction, 2)}\xa0%"
