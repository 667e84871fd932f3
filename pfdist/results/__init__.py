"""A run's tables as pandas DataFrames, and its results with their intervals.

Only tables are read: no Ray, no model, no kernel.
"""

from pfdist.results.budget_curve import reaching
from pfdist.results.columns import finite
from pfdist.results.moments import (
    BIN,
    BLOCK,
    EDGES,
    ComparisonStatistics,
    Gain,
    Moments,
    relative_gain,
)
from pfdist.results.run import Run, open_run
from pfdist.results.stored_run import read_recorded
