"""What a run's tables say, as pandas DataFrames and figures with their intervals.

Reads tables alone: no Ray, no model, no kernel.
"""

from pfdist.analysis.gains import (
    BIN,
    BLOCK,
    EDGES,
    Comparison,
    Gain,
    GainSummary,
    relative_gain,
    summarise_gain,
)
from pfdist.analysis.tables import Run, finite, open_run

__all__ = [
    "BIN",
    "BLOCK",
    "EDGES",
    "Comparison",
    "Gain",
    "GainSummary",
    "Run",
    "finite",
    "open_run",
    "relative_gain",
    "summarise_gain",
]
