"""Read one file of a table, and cut tables at fixed counts of rows."""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from pfdist.errors import StoreError
from pfdist.store.schema import SCHEMA_VERSION


def cut_rows(pieces: Iterable[pa.Table], count: int) -> Iterator[pa.Table]:
    """Cut a stream of tables into tables of a fixed number of rows, the last one shorter."""
    waiting: list[pa.Table] = []
    rows = 0
    for piece in pieces:
        waiting.append(piece)
        rows += piece.num_rows
        while rows >= count:
            whole = pa.concat_tables(waiting)
            yield whole.slice(0, count)
            waiting, rows = [whole.slice(count)], rows - count
    if rows:
        yield pa.concat_tables(waiting)


def guarded(path: Path, read: Callable[[], pa.Table]) -> pa.Table:
    """Read, and name the file where that fails."""
    try:
        return read()
    except FileNotFoundError:
        raise
    except (OSError, pa.ArrowInvalid) as error:
        reason = str(error).splitlines()[0]
        raise StoreError(
            f"cannot read {path}: {reason}; the job, run again, makes it anew if it is damaged"
        ) from error


def read_file(
    path: Path, columns: list[str] | None = None, filters: pc.Expression | None = None
) -> pa.Table:
    """Read what is wanted of a file, of this schema or an older one."""
    table = guarded(
        path,
        lambda: pq.read_table(
            path,
            columns=columns,
            filters=filters,
            partitioning=None,
            use_threads=False,  # each would keep memory of its own
            page_checksum_verification=True,
        ),
    )
    version = int((table.schema.metadata or {}).get(b"pfdist_schema_version", b"0"))
    if version > SCHEMA_VERSION:
        raise StoreError(
            f"{path} is of schema version {version}; this pfdist reads up to {SCHEMA_VERSION}: "
            "use the newer pfdist that wrote it"
        )
    return table
