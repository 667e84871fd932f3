"""One Parquet file: writing, reading, and its rows, cut at fixed counts and made unique.

If a path is text, pyarrow interprets ``a:b`` as the address of a file system and does not accept
names that are not UTF-8. So pyarrow gets open files, which are opened by the bytes of their names.
"""

import contextlib
import io
import os
import re
import threading
from collections import OrderedDict
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from pfdist.errors import StoreError
from pfdist.store import files
from pfdist.store.files import Prepared, prepare, read_if_hashed, stamp_of
from pfdist.store.schema import RUN_KEY, check_schema_version, wrong_columns

NAME = re.compile(r"([a-z][a-z0-9_.]*)-(?:\d{5}-)?([0-9a-f]{16})\.parquet")
"""The name of a table's file: the phase, a number if it is published, and the hash."""

HASH_DIGITS = 16  # of the SHA-256 in a name
REMEDY = "remove it, and run the same command again"

_known = OrderedDict[Path, tuple[tuple[int, ...], str | None, pa.Table]]()
"""The small files that this process has read or written last: version, key of the run, rows."""
_lock = threading.Lock()
_MOST_KNOWN, _MOST_BYTES, _MOST_KEPT = 64, 400_000, 50_000  # files; bytes and values of a file

# Values, and bytes of texts, that a file may hold when it is unpacked
_USUAL_VALUES, _USUAL_TEXT, _MOST_VALUES_A_BYTE = 10_000_000, 50_000_000, 100
_ROWS = 100_000  # whose texts are measured at once
_SHARED_BEGINNINGS = 7  # the encoding DELTA_BYTE_ARRAY
_LENGTHS = {1: 0, 2: 0, 3: 1, 7: 8}  # of true, false, a byte and a float in a page's header
_LONGEST_NAME = 64  # a search's name and a number of measurements
_NAME = re.compile(rf"[a-z][a-z0-9_]{{0,{_LONGEST_NAME - 1}}}")


def write_table(table: pa.Table, path: Path) -> None:
    """Write a table as a Parquet file.

    Only text has a dictionary, because numbers are seldom the same: one takes half of the time.
    """
    texts = [place for field in table.schema if (place := _place_of_text(field))]
    with pa.OSFile(os.fsencode(path), "wb") as file:
        pq.write_table(
            table, file, compression="zstd", write_page_checksum=True, use_dictionary=texts
        )


def _place_of_text(field: pa.Field) -> str:
    """The name in a file of a column of texts, or of lists of texts; empty for other columns."""
    is_list = pa.types.is_list(field.type)
    kind = field.type.value_type if is_list else field.type
    has_text = pa.types.is_string(kind) or pa.types.is_dictionary(kind)
    return f"{field.name}{'.list.element' * is_list}" if has_text else ""


def prepare_table(folder: Path, table: pa.Table) -> Prepared:
    """Write a table as a Parquet file to a folder, under a temporary name."""

    def write(path: Path) -> None:
        write_table(table, path)
        pa.default_memory_pool().release_unused()  # otherwise memory grows with each file

    return prepare(folder, write)


def name_table(prepared: Prepared, path: Path, table: pa.Table, run_key: str | None) -> None:
    """Give the file of a table its final name; this process need not read it then."""
    files.give_name(prepared, path)
    if table.nbytes <= _MOST_BYTES:
        if any(map(pa.types.is_nested, table.schema.types)):
            with pa.OSFile(os.fsencode(path)) as file:  # Parquet has other names in lists
                table = table.cast(pq.read_schema(file))
        sink = pa.BufferOutputStream()  # a copy, because the arrays of the rows may change
        with pa.ipc.new_stream(sink, table.schema) as stream:
            stream.write_table(table)
        _remember(path, stamp_of(path), run_key, pa.ipc.open_stream(sink.getvalue()).read_all())


def _remember(path: Path, version: tuple[int, ...], run_key: str | None, table: pa.Table) -> None:
    if table.nbytes <= _MOST_BYTES:
        with _lock:
            _known[path] = version, run_key, table
            while len(_known) > _MOST_KNOWN:
                _known.popitem(last=False)


def holds_table(path: Path, name: bytes) -> bool:
    """Whether a file is a Parquet file of a table with this name, by its metadata."""
    try:
        with pa.OSFile(os.fsencode(path)) as file:
            return bool((pq.read_schema(file).metadata or {}).get(b"table") == name)
    except pa.ArrowException:
        return False


def read_file(
    path: Path,
    run_key: str | None,
    columns: list[str] | None = None,
    filters: pc.Expression | None = None,
) -> pa.Table | None:
    """Columns and rows of a file, all of them by default; None if its name has another hash.

    This is the only function that reads files of tables. Nothing in a file is used before its hash
    is compared with that in its name. The table is that of the file's folder, and the file must
    belong to the run with this key; None: it must have no key. Raises `FileNotFoundError` if there
    is no such file. Raises `StoreError` if it cannot be read, has another schema version, or
    belongs to another run or table. A small file that has not changed since this process read it
    is not read again, but by a call without columns, which checks every byte.
    """
    named = NAME.fullmatch(path.name)
    with _reading(path):
        version, known = stamp_of(path), _known.get(path)
        if known is not None and known[:2] == (version, run_key) and columns != []:
            return _chosen(known[2], columns, filters)
        content = read_if_hashed(path, named[2]) if named else None
        if content is None:
            return None
        described = pq.read_metadata(pa.BufferReader(content))
        about = described.schema.to_arrow_schema()
        metadata, table = about.metadata or {}, path.parent.name
        check_schema_version(path, int(metadata.get(b"pfdist_schema_version", b"0")))
        for name, wanted in ((b"table", table), (RUN_KEY, run_key or "none")):
            if (got := metadata.get(name, b"none").decode(errors="replace")) != wanted:
                what = "table" if name == b"table" else "run"
                raise StoreError(
                    f"{path} belongs to another {what}: {wanted} was expected, got {got}; {REMEDY}"
                )
        if wrong := wrong_columns(about, table):
            raise StoreError(f"{path} {wrong}: the version of pfdist in run.json reads it")
        whole = unpacked(
            content,
            described,
            max(_USUAL_VALUES, _MOST_VALUES_A_BYTE * len(content)),
            max(_USUAL_TEXT, _MOST_VALUES_A_BYTE * len(content)),
            _MOST_KEPT,
        )
        if whole is None:
            return pq.read_table(  # each thread would keep its own memory
                pa.BufferReader(content), columns=columns, filters=filters, partitioning=None,
                use_threads=False,
            )  # fmt: skip
        whole = whole.cast(about)
        if columns != []:
            _remember(path, version, run_key, whole)
        return _chosen(whole, columns, filters)


def _chosen(table: pa.Table, columns: list[str] | None, filters: pc.Expression | None) -> pa.Table:
    rows = table if filters is None else table.filter(filters)
    return rows if columns is None else rows.select(columns)


def column_chunks(about: pq.FileMetaData) -> Iterator[pq.ColumnChunkMetaData]:
    """Describe each column of a Parquet file in each group of rows, before it is unpacked."""
    for group in map(about.row_group, range(about.num_row_groups)):
        yield from map(group.column, range(group.num_columns))


def size_of_pages(file: BinaryIO, chunks: Iterable[pq.ColumnChunkMetaData]) -> tuple[int, int]:
    """The bytes and values in the pages of some columns, for which pyarrow takes memory.

    The metadata of a forged file says less than the pages. Texts that share their beginnings count
    as if each had all bytes of its page. Raises a `ValueError` if a page cannot be read.
    """
    size = values = 0
    for chunk in chunks:
        start = min(filter(None, (chunk.dictionary_page_offset, chunk.data_page_offset)))
        file.seek(start)
        while file.tell() < start + chunk.total_compressed_size:
            page = _page_header(file)
            count = page.get((5, 1), 0) + page.get((8, 1), 0)
            if min(count, *(page.get((place,), -1) for place in (2, 3))) < 0:
                raise ValueError("a page has no size")
            shares_beginnings = _SHARED_BEGINNINGS in (page.get((5, 2)), page.get((8, 4)))
            size += page[2,] * (count if shares_beginnings else 1)
            values += count
            file.seek(page[3,], os.SEEK_CUR)
    return size, values


def _page_header(file: BinaryIO) -> dict[tuple[int, ...], int]:
    """The numbers in a page's header by their places in parquet.thrift.

    It is a struct in Thrift's compact protocol; numbers are cut to 32 bits, as pyarrow does it.
    """
    place, found = [0], dict[tuple[int, ...], int]()
    try:
        while place:
            step, kind = divmod(file.read(1)[0], 16)
            if not kind:  # the end of a struct
                place.pop()
                continue
            place[-1] = (place[-1] + step if step else _signed(_number(file))) & 0xFFFF
            if kind in (4, 5, 6):  # whole numbers of 16, 32 and 64 bits
                value = _signed(_number(file))
                if kind == 5 and len(place) < 3:
                    found[(*place,)] = value
            elif kind == 12:  # a struct
                place.append(0)
            else:
                file.seek(_number(file) if kind == 8 else _LENGTHS[kind], os.SEEK_CUR)
    except LookupError as error:
        raise ValueError("the header of a page cannot be read") from error
    return found


def _number(file: BinaryIO) -> int:
    value = shift = 0
    while (byte := file.read(1)[0]) > 127:
        value, shift = value | (byte & 127) << shift, shift + 7
    return (value | byte << shift) & 0xFFFFFFFF


def _signed(number: int) -> int:
    return number >> 1 ^ -(number & 1)


def unpacked(
    content: bytes, about: pq.FileMetaData, most_values: int, most_text: int, most_kept: int
) -> pa.Table | None:
    """The table in a Parquet file that memory can hold, else a `ValueError`; texts as dictionaries.

    It is None, and only texts are read, if there are more values than `most_kept`. Rows may share a
    text, so texts are measured in dictionary form, before they are repeated.
    """
    chunks, size = [*column_chunks(about)], f"{len(content):,} bytes"
    packed, values = size_of_pages(io.BytesIO(content), chunks)
    values = max(values, sum(chunk.num_values for chunk in chunks))
    if values > most_values:
        raise ValueError(f"{size} must not hold {values:,} values")
    texts = sorted({c.path_in_schema for c in chunks if "BYTE_ARRAY" in c.physical_type})
    total, table = max(0, packed - 8 * most_values), None
    with pq.ParquetFile(pa.BufferReader(content), metadata=about, read_dictionary=texts) as file:
        batches: Iterable[pa.RecordBatch] = ()
        if total <= most_text and values <= most_kept:
            table = file.read(use_threads=False)
            batches = table.to_batches()
        elif total <= most_text:
            batches = file.iter_batches(_ROWS, columns=texts)
        for batch in batches:
            for name, column in zip(batch.schema.names, batch.columns, strict=True):
                if any(f"{text}.".startswith(f"{name}.") for text in texts):
                    total += lengths_of_texts(column)[1]
    if total > most_text:
        raise ValueError(f"{size} must not hold {total:,} bytes of texts")
    return table


def lengths_of_texts(column: pa.Array) -> tuple[int, int]:
    """The bytes of the longest of a column's texts in dictionary form, and of all texts."""
    while pa.types.is_list(column.type):
        column = column.flatten()
    column = column.dictionary_encode()
    lengths = pc.cast(pc.binary_length(column.dictionary), pa.int64())
    longest, total = pc.max(lengths), pc.sum(lengths.take(column.indices))
    return longest.as_py() or 0, total.as_py() or 0


def signed(table: pa.Table, run_key: str | None) -> pa.Table:
    """A table with the key of its run in the metadata."""
    if run_key is None:
        return table
    metadata = table.schema.metadata or {}
    return table.replace_schema_metadata({**metadata, RUN_KEY: run_key.encode()})


def cut_rows(pieces: Iterable[pa.Table], count: int) -> Iterator[pa.Table]:
    """Yield a stream of tables as tables with a fixed number of rows; the last may be shorter."""
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
    """The first row of each key, sorted by key."""
    rows = pa.concat_tables(pieces, promote_options="default")  # others may have more columns
    rows = rows.sort_by([(name, "ascending") for name in key])  # a stable sort
    return rows.filter(pa.array(first_occurrences(*(rows[name].to_numpy() for name in key))))


def check_names(names: Iterable[object], where: Path) -> None:
    """Raise `StoreError` unless each name of a compared set is allowed in a job.

    `where` is the table in the error message.
    """
    for name in names:
        if not (isinstance(name, str) and _NAME.fullmatch(name)):
            raise StoreError(
                f"{where}: a name must be lower-case letters, digits and underscores, at most "
                f"{_LONGEST_NAME}, got {str(name)[:80]!r}"
            )


@contextlib.contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Turn errors inside a with statement into a `StoreError` that names the file."""
    try:
        yield
    except FileNotFoundError:
        raise
    except (OSError, ValueError, pa.ArrowException) as error:
        reason = str(error).splitlines()[0]
        raise StoreError(f"cannot read {path}: {reason}; if it is damaged, {REMEDY}") from error
