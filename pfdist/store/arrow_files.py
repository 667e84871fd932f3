"""Read and write Parquet files whatever their names are: the only calls of pyarrow with a path.

Given a path as text, pyarrow takes ``a:b`` for the address of a file system and refuses names that
are not UTF-8. So it is given open files, and these are opened by the bytes of their names.
"""

import os
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq


def write_table(table: pa.Table, path: Path) -> None:
    """Write a table as a Parquet file."""
    with pa.OSFile(os.fsencode(path), "wb") as file:
        pq.write_table(table, file, compression="zstd", write_page_checksum=True)


def read_table(path: Path, **options: Any) -> pa.Table:
    """Read a Parquet file; the options are those of `pyarrow.parquet.read_table`."""
    with pa.OSFile(os.fsencode(path)) as file:
        return pq.read_table(file, partitioning=None, **options)


def read_schema(path: Path) -> pa.Schema:
    """Read the schema of a Parquet file."""
    with pa.OSFile(os.fsencode(path)) as file:
        return pq.read_schema(file)


def count_rows(path: Path) -> int:
    """Read how many rows a Parquet file says it has."""
    with pa.OSFile(os.fsencode(path)) as file:
        return int(pq.read_metadata(file).num_rows)
