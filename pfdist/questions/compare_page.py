"""How named sets of times compare: their ranks, and all pairs on the same draws."""

from pfdist.common.parts import Block, Cell, Figures, Section, Table, Text, without_empty_columns
from pfdist.questions.subject import Subject, number_of
from pfdist.results.columns import COLUMNS, Row, interval_cell, rows_of
from pfdist.results.pairs import formatted_ranks
from pfdist.results.stored_run import named_sets

_OF_A_SET = ("name", "measurements", "price", "expected_mse")
_PAIRS_HEAD = (
    "first", "second", "first less second", "clear", "in % of second",
    "draws where first is lower, %",
)  # fmt: skip
_MEANING = (
    "All sets filter the same draws, so differences are far more exact than the errors. A negative "
    "difference says that the first set of a pair has the lower error. Intervals in brackets hold "
    "with 95 % for one pair alone. A difference is clear if its sign holds with 95 % for all pairs "
    "together. The best rank of a set counts the sets that are clearly better, the worst rank all "
    "that are not clearly worse. A number without an interval is exact."
)
_MOST_OPEN = 28
"""Pairs of 8 sets; a table of more pairs is folded away."""


def compared(subject: Subject) -> Section | None:
    """The ranks and the pairs of a run whose job names sets."""
    run = subject.run
    if not (subject.is_compared and named_sets(run)):
        return None
    ranks, pairs = (rows_of(run.table(name)) for name in ("ranks", "pairs"))
    draws = number_of(run.draws_compared, "draw")
    head = ("rank", *(COLUMNS[name].head for name in _OF_A_SET), "above the best by")
    sets = Table(f"Ranks on {draws}", head, [_set_row(subject, row) for row in ranks])
    rows = [_pair_row(pair) for pair in pairs]
    blocks: list[Block] = [
        without_empty_columns(sets),
        Text(_MEANING, detail=True),
        Figures(["compared"] if subject.found_rows else ["times", "compared"]),
        Table(
            "Pairs of sets", _PAIRS_HEAD, rows, len(rows) > _MOST_OPEN, optional=_PAIRS_HEAD[:-4:-1]
        ),
    ]
    return Section("How the sets compare", blocks)


def _set_row(subject: Subject, row: Row) -> list[Cell]:
    return [
        Cell(formatted_ranks(row.best_rank, row.worst_rank), row.best_rank),
        *(COLUMNS[name].cell(subject.rows[row.name]) for name in _OF_A_SET),
        _difference(row) if row.difference else Cell(""),
    ]


def _pair_row(pair: Row) -> list[Cell]:
    gains = (pair.gain_of_means, pair.gain_of_means_high, pair.gain_of_means_low)
    relative = (None if gain is None else -gain for gain in gains)
    wins = (pair.first_wins, pair.first_wins_low, pair.first_wins_high)
    return [
        Cell(pair.first),
        Cell(pair.second),
        _difference(pair),
        Cell("yes" if pair.clear else "no"),
        interval_cell(*relative, is_percent=True),
        interval_cell(*wins, is_percent=True),
    ]


def _difference(row: Row) -> Cell:
    return interval_cell(row.difference, row.low, row.high)
