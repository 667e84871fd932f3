"""How named sets of times compare: their ranks, and all pairs on the same draws."""

from collections.abc import Mapping
from typing import Any

from pfdist.common.parts import Block, Cell, Figures, Section, Table, Text, without_empty_columns
from pfdist.common.percent import range_of
from pfdist.common.rounding import with_interval
from pfdist.questions.subject import (
    ERROR_HEAD,
    Subject,
    cost_cell,
    mse_cell,
    number_of,
    percent_cell,
)
from pfdist.results.pairs import formatted_ranks

_PAIRS_HEAD = (
    "first", "second", "first less second", "clear", "in % of second",
    "draws where first is lower, %",
)  # fmt: skip
_MEANING = (
    "All sets filter the same draws, so differences are far more exact than the errors. A negative "
    "difference says that the first set of a pair has the lower error. Intervals in brackets hold "
    "with 95 % for one pair alone. A difference is clear if its sign holds with 95 % for all pairs "
    "together. The best rank of a set counts the sets that are clearly better, the worst rank all "
    "that are not clearly worse."
)
_EXACT = (
    "The filter is exact, so the expected errors, their differences and the ranks are exact. Only "
    "the shares of draws are estimated."
)
_MOST_OPEN = 28
"""Pairs of 8 sets; a table of more pairs is folded away."""


def compared(subject: Subject) -> Section | None:
    """The ranks and the pairs of a run whose job names sets."""
    ranks, pairs = subject.summary.ranks, subject.summary.pairs
    if not ranks:
        return None
    draws = number_of(subject.summary.draws_compared, "draw")
    head = ("rank", "times", "number", subject.cost_head, ERROR_HEAD, "above the best by")
    sets = Table(f"Ranks on {draws}", head, [_set_row(subject, row) for row in ranks])
    rows = [_pair_row(pair) for pair in pairs or ()]
    blocks: list[Block] = [
        without_empty_columns(sets),
        Text(_EXACT if subject.summary.is_exact else _MEANING, detail=True),
        Figures(["compared"] if subject.found_results else ["times", "compared"]),
        Table(
            "Pairs of sets", _PAIRS_HEAD, rows, len(rows) > _MOST_OPEN, optional=_PAIRS_HEAD[:-4:-1]
        ),
    ]
    return Section("How the sets compare", blocks)


def _set_row(subject: Subject, row: Mapping[str, Any]) -> list[Cell]:
    result = subject.results[row["name"]]
    number = result.measurements
    return [
        Cell(formatted_ranks(row["best_rank"], row["worst_rank"]), row["best_rank"]),
        Cell(row["name"]),
        Cell(str(number), number),
        cost_cell(result),
        mse_cell(row["expected_mse"], row["standard_error"]),
        _difference(row) if row["difference"] else Cell(""),
    ]


def _pair_row(pair: Mapping[str, Any]) -> list[Cell]:
    keys = ("gain_of_means", "gain_of_means_high", "gain_of_means_low")
    relative, low, high = (None if pair[key] is None else -pair[key] for key in keys)
    wins = (pair["first_wins"], [pair["first_wins_low"], pair["first_wins_high"]])
    return [
        Cell(pair["first"]),
        Cell(pair["second"]),
        _difference(pair),
        Cell("yes" if pair["clear"] else "no"),
        percent_cell(relative, [low, high]),
        percent_cell(*wins),
    ]


def _difference(row: Mapping[str, Any]) -> Cell:
    value, low, high = with_interval(row["difference"], row["low"], row["high"])
    exact = row["low"] == row["high"] and row["low"] is not None
    return Cell(value if exact else f"{value} ({range_of(low, high)})", row["difference"])
