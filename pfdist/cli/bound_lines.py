"""The lines of a summary about the lower bound of a set."""

from typing import Any

from pfdist.cli.layout import paragraph, wrapped_lines
from pfdist.common.gap_sentence import gap_sentence


def proof_lines(gap: dict[str, Any], measurements: int, *, is_constrained: bool) -> list[str]:
    """Say how much lower the error of other times can be, or why nobody knows.

    Parameters
    ----------
    gap : dict
        Fields of `pfdist.bounds.gap.Gap` as JSON, and ``confidence``.
    measurements : int
        Number of measurements of the set.
    is_constrained : bool
        Whether the job excludes some times, beside their number or cost.
    """
    if gap["reason"]:
        return wrapped_lines("no lower bound", gap["reason"])
    return paragraph(gap_sentence(gap, measurements, is_constrained=is_constrained))
