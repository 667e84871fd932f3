"""One Parquet file, written and read; and its rows, cut at fixed counts and made unique.

If a path is text, pyarrow takes ``a:b`` for the address of a file system and refuses names that are
not UTF-8. So pyarrow gets open files, which are opened by the bytes of their names.
"""

import contextlib
import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from pfdist.errors import StoreError
from pfdist.store.schema import RUN_KEY, check_schema_version

_LONGEST_NAME = 64  # a search's name and a number of measurements
_NAME = re.compile(rf"[a-z][a-z0-9_]{{0,{_LONGEST_NAME - 1}}}")


def write_table(table: pa.Table, path: Path) -> None:
    """Write a table as a Parquet file."""
    with pa.OSFile(os.fsencode(path), "wb") as file:
        pq.write_table(table, file, compression="zstd", write_page_checksum=True)


def holds_table(path: Path, name: bytes) -> bool:
    """Whether a file is a Parquet file whose metadata give its table this name."""
    try:
        with pa.OSFile(os.fsencode(path)) as file:
            return bool((pq.read_schema(file).metadata or {}).get(b"table") == name)
    except pa.ArrowException:
        return False


def rows_and_run(path: Path) -> tuple[int, str | None]:
    """Number of rows of a file, and the key of the run that wrote it, if the file names one.

    Raises `FileNotFoundError` if there is no such file, and `StoreError` if it is no readable
    Parquet file.
    """
    with _reading(path) as file:
        about = pq.read_metadata(file)
    key = (about.metadata or {}).get(RUN_KEY)
    return about.num_rows, None if key is None else key.decode(errors="replace")


def read_file(
    path: Path,
    columns: list[str] | None = None,
    filters: pc.Expression | None = None,
    run_key: str | None = None,
) -> pa.Table:
    """Columns and rows of a file of this schema version, all of them by default.

    The file must belong to the run with this key; None: it must carry no key. Raises
    `FileNotFoundError` if there is no such file. Raises `StoreError` if it cannot be read, has
    another schema version, or belongs to another run.
    """
    with _reading(path) as file:
        table = pq.read_table(
            file,
            columns=columns,
            filters=filters,
            partitioning=None,
            use_threads=False,  # each thread would keep its own memory
            page_checksum_verification=True,
        )
    metadata = table.schema.metadata or {}
    if metadata.get(RUN_KEY) != (run_key.encode() if run_key else None):
        carries = f"the run's key {run_key}" if run_key else "no key"
        raise StoreError(
            f"{path} belongs to another run: every file here must carry {carries}, "
            f"got {metadata.get(RUN_KEY, b'none').decode(errors='replace')}; `pfdist repair` moves "
            "such files to quarantine"
        )
    check_schema_version(path, int(metadata.get(b"pfdist_schema_version", b"0")))
    return table


def signed(table: pa.Table, run_key: str | None) -> pa.Table:
    """Table whose metadata says to which run it belongs."""
    if run_key is None:
        return table
    metadata = table.schema.metadata or {}
    return table.replace_schema_metadata({**metadata, RUN_KEY: run_key.encode()})


def cut_rows(pieces: Iterable[pa.Table], count: int) -> Iterator[pa.Table]:
    """Yield a stream of tables as tables of a fixed number of rows, the last one shorter."""
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


def first_occurrences(*columns: NDArray[Any]) -> NDArray[np.bool_]:
    """Whether each row of sorted columns differs from the row before it."""
    first = np.ones(columns[0].size, np.bool_)
    first[1:] = np.any([column[1:] != column[:-1] for column in columns], axis=0)
    return first


def unique(pieces: list[pa.Table], key: list[str]) -> pa.Table:
    """Rows sorted by their key, each once: the first row of each key."""
    rows = pa.concat_tables(pieces)
    rows = rows.sort_by([(name, "ascending") for name in key])  # a stable sort
    return rows.filter(pa.array(first_occurrences(*(rows[name].to_numpy() for name in key))))


def check_names(names: Iterable[object], where: Path) -> None:
    """Raise a `StoreError` unless each name of a compared set is one that a job could have given.

    `where` is the table, for the error.
    """
    for name in names:
        if not (isinstance(name, str) and _NAME.fullmatch(name)):
            raise StoreError(
                f"{where}: a name must be lower-case letters, digits and underscores, at most "
                f"{_LONGEST_NAME}, got {str(name)[:80]!r}"
            )


@contextlib.contextmanager
def _reading(path: Path) -> Iterator[Any]:
    """An open file inside a with statement, whose errors name the file."""
    try:
        with pa.OSFile(os.fsencode(path)) as file:
            yield file
    except FileNotFoundError:
        raise
    except (OSError, pa.ArrowInvalid) as error:
        reason = str(error).splitlines()[0]
        raise StoreError(
            f"cannot read {path}: {reason}; the job, run again, makes it anew if it is damaged"
        ) from error
