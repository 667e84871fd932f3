"""The tables of a search: evaluations, generation by generation, and their per-draw MSE."""

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from types import SimpleNamespace
from typing import Any

import pyarrow as pa

from pfdist.errors import StoreError
from pfdist.search import Candidate
from pfdist.store import Store, schema

_TABLES = ("evaluations", "draws", "error_sums")
_EVALUATIONS_AT_ONCE = 200  # evaluations that are read together when a phase is published


def evaluation_rows(
    phase: str,
    generation: int,
    candidates: list[Candidate],
    requests: Sequence[Any],
    evaluations: dict[Candidate, Any],
) -> pa.Table:
    """Rows of the table ``evaluations``: a row for each request of a generation.

    A column has the value of that name from the first record of the row that has the name.
    """
    table, copies = schema("evaluations"), Counter(candidates)
    individuals = {candidate: place for place, candidate in reversed([*enumerate(candidates)])}
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


def committed_generations(store: Store, phase: str) -> set[int]:
    """Generations of a phase that are committed."""
    if not store.has("evaluations", phase):
        return set()
    return set(store.read("evaluations", phase=phase)["generation"])


def unpublished(store: Store, phases: Iterable[str]) -> bool:
    """Whether a search has parts that are not published as tables yet."""
    return any(store.has_parts(table, phase) for phase in phases for table in _TABLES)


def publish_search(store: Store, phase: str) -> None:
    """Publish the parts of a search as tables; a repeated call gives the same tables.

    Draws are published before evaluations, because the rows of evaluations say which draws belong
    to the search. A kill in between leaves parts of evaluations, and the next call begins again.
    """
    if not unpublished(store, [phase]):
        return
    store.settle("error_sums", phase)
    rows = store.read("evaluations", phase=phase)
    most = rows.groupby("evaluation", sort=False)["draws"].max()
    wanted = {str(id_): int(draws) for id_, draws in most.items()}
    store.publish("draws", phase, _draws_of(store, wanted))
    own = store.own_schema(schema("evaluations"))
    table = pa.Table.from_pandas(rows, schema=own, preserve_index=False)
    store.publish("evaluations", phase, [table])


def _draws_of(store: Store, wanted: dict[str, int]) -> Iterator[pa.Table]:
    """Yield the rows of the wanted number of draws of each evaluation."""
    ids = list(wanted)
    for first in range(0, len(ids), _EVALUATIONS_AT_ONCE):
        some = ids[first : first + _EVALUATIONS_AT_ONCE]
        rows = store.per_draw(some)
        if rows.num_rows != sum(wanted[id_] for id_ in some):
            raise StoreError(
                f"{store.path} lacks draws that were committed: is another driver at work there? "
                "Run the same command again"
            )
        yield rows


def _column(name: str, records: Sequence[tuple[Any, ...]]) -> list[Any]:
    """The values of a name, from the first record of each row that has the name."""
    owner = next(place for place, record in enumerate(records[0]) if hasattr(record, name))
    return [getattr(row[owner], name) for row in records]  # all rows have the same records
