"""The gains of all compared times: a row for each set, the histogram of gains, and one draw."""

from typing import Any

from pfdist.common.percent import cost
from pfdist.common.rounding import with_error
from pfdist.reports.parts import Cell, Section, Table, Text
from pfdist.reports.pictures import pictures
from pfdist.reports.subject import Subject, number_of, percent_cell, sets_table

_HEAD = ("times", "expected error", "lower by, %", "draws with a lower error, %", "mean gain, %")
_MEANING = (
    "The expected error is the mean over all draws, with its standard error. The next column says "
    "how much lower it is than that of the first row. The mean gain is the mean of the relative "
    "gains of single draws, the paper's figure. Intervals in brackets hold with 95 %."
)


def gains(subject: Subject) -> Section | None:
    """Compare all sets of a run on the same draws."""
    if not subject.is_compared:
        return None
    rows = [_row(name, result) for name, result in subject.results.items()]
    draws = number_of(subject.summary["draws_compared"], "draw")
    fresh = " that took no part in the search" if subject.run.found else ""
    table = Table(f"Expected error on {draws}{fresh}", _HEAD, rows)
    broken = [
        Text(f"{_called(subject, name)} a constraint of the job. {constraint}.")
        for name, result in subject.results.items()
        for constraint in result.get("broken_constraints", ())
    ]
    texts = _degenerate(subject) + broken
    return Section(
        "What the times gain",
        [
            table,
            Text(_MEANING),
            *texts,
            *pictures(subject.tables, ["gain", "draw"], subject.shown),
            *subject.about_others,
            sets_table(subject),
        ],
    )


def _called(subject: Subject, name: str) -> str:
    is_reference = name not in subject.others
    return "The reference breaks" if is_reference else f"The times of {name} break"


def _row(name: str, result: dict[str, Any]) -> list[Cell]:
    mse = cost(result["expected_mse"])
    cells = [Cell(name), Cell(with_error(mse, result["standard_error"]), mse)]
    for key in ("gain_of_means", "positive_fraction", "mean_relative_gain"):
        known = key in result
        cells.append(percent_cell(result[key], result[f"{key}_interval"]) if known else Cell(""))
    return cells


def _degenerate(subject: Subject) -> list[Text]:
    """Say how many draws are left out of which set."""
    left_out = [
        f"{number_of(result['degenerate_draws'], 'draw')} of {name}"
        for name, result in subject.results.items()
        if result["degenerate_draws"]
    ]
    return [Text(f"Degenerate and left out: {', '.join(left_out)}.")] if left_out else []
