"""A run's tables as pandas DataFrames, and figures with their intervals.

Reads tables alone: no Ray, no model, no kernel.
"""

from pfdist.analysis.budget_curve import reaching
from pfdist.analysis.gains import (
    BIN,
    BLOCK,
    EDGES,
    ComparisonStatistics,
    Gain,
    GainSummary,
    relative_gain,
    summarise_gain,
)
from pfdist.analysis.run import Run, open_run
from pfdist.analysis.stored_run import read_recorded
from pfdist.analysis.streaming_moments import Moments
from pfdist.analysis.summary import finite
