"""A run as a prompt and a notebook show it."""

from typing import TYPE_CHECKING

from pfdist.common.percent import cost, percent_with_interval
from pfdist.common.rounding import with_error
from pfdist.documents.parts import Cell, Page, Section, Table
from pfdist.errors import StoreError

if TYPE_CHECKING:
    from pfdist.analysis.stored_run import Run
    from pfdist.analysis.summary import SetResult


def title_of(run: "Run") -> str:
    """A run in a line: its folder, its state and how many draws are compared.

    Parameters
    ----------
    run : Run
    """
    try:
        return f"run {run.path}: {run.state}, {run.draws_compared:,} draws compared"
    except StoreError:
        return f"run {run.path}: cannot be read"


def run_card(run: "Run") -> Page:
    """The sets of a run with their expected MSE and gain."""
    try:
        results = run.summary().results
    except StoreError:
        return Page("", title_of(run), [])
    head = ("times", "measurements", "expected MSE", "below the reference")
    rows = [[Cell(text) for text in _row(name, each)] for name, each in results.items()]
    return Page("", title_of(run), [Section("", [Table("", head, rows)])])


def _row(name: str, result: "SetResult") -> tuple[str, ...]:
    mse = gain = ""
    if result.is_compared:
        mse = with_error(cost(result.expected_mse), result.standard_error)
    if result.gain_draws is not None:
        gain = percent_with_interval(result.gain_of_means, result.gain_of_means_interval)
    return name, str(result.measurements), mse, gain
