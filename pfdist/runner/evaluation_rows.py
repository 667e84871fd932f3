"""Rows of the table of the evaluations of a search."""

from collections import Counter
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import pyarrow as pa

from pfdist.search import Candidate
from pfdist.store import schema


def evaluation_rows(
    phase: str,
    generation: int,
    asked: list[Candidate],
    requests: Sequence[Any],
    evaluations: dict[Candidate, Any],
) -> pa.Table:
    """Rows of the table ``evaluations``: a row for each request of a generation.

    A column holds the value of that name from the first record of the row that has the name.
    """
    table, copies = schema("evaluations"), Counter(asked)
    individuals = {candidate: place for place, candidate in reversed([*enumerate(asked)])}
    records = [
        (
            SimpleNamespace(
                evaluation=request.id,
                phase=phase,
                generation=generation,
                individual=individuals[request.candidate],
                copies=copies[request.candidate],
                end=request.end,
            ),
            evaluations[request.candidate],
            request.estimation,
        )
        for request in requests
    ]
    columns = {name: _column(name, records) for name in table.names}
    return pa.Table.from_pydict(columns, schema=table)


def _column(name: str, records: Sequence[tuple[Any, ...]]) -> list[Any]:
    """Give the values of a name, from the first record of each row that has the name."""
    owner = next(place for place, record in enumerate(records[0]) if hasattr(record, name))
    return [getattr(row[owner], name) for row in records]  # all rows have the same records
