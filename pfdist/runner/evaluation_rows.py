"""Rows of the tables of a search: its evaluations, and their per-draw MSE."""

from collections import Counter
from collections.abc import Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow as pa

from pfdist.evaluation.work import Result, Work
from pfdist.search import Candidate
from pfdist.store import schema


def draw_rows(work: Work, result: Result) -> pa.Table:
    """Rows of the table ``draws``: evaluation after evaluation."""
    evaluation = np.repeat(np.arange(len(work.ids)), len(result.mse))
    columns = [
        pa.array(work.ids, pa.string()).take(evaluation),
        pa.array(np.tile(np.arange(*work.draws), len(work.ids))),
        pa.array(result.mse.T.ravel(), from_pandas=True),
    ]
    return pa.Table.from_arrays(columns, schema=schema("draws"))


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
    table, copies, rows = schema("evaluations"), Counter(asked), []
    for request in requests:
        candidate = request.candidate
        place = SimpleNamespace(
            evaluation=request.id,
            phase=phase,
            generation=generation,
            individual=asked.index(candidate),
            copies=copies[candidate],
            end=request.end,
        )
        records = (place, evaluations[candidate], request.estimation)
        rows.append({name: _value(name, records) for name in table.names})
    return pa.Table.from_pylist(rows, schema=table)


def _value(name: str, records: Sequence[Any]) -> Any:
    return next(getattr(record, name) for record in records if hasattr(record, name))
