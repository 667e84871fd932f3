"""The rows of a run's table of sets, by name."""

from pfdist.results import Run
from pfdist.results.columns import Row, rows_of


def results_of(run: Run) -> dict[str, Row]:
    """None is a missing value."""
    return {row.name: row for row in rows_of(run.table("sets"))}
