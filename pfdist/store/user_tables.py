"""Tables of numbers from a user, in CSV or Parquet, and tables for the user."""

import stat
from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from pfdist.common.calendar import as_text
from pfdist.common.nearest import must_be
from pfdist.errors import PfdistError, shown
from pfdist.store.files import begins_with, check_replaceable, write_file
from pfdist.store.tables import holds_table, write_table

Array = NDArray[np.float64]

MOST_BYTES = 200_000_000  # of a file: a million particles of ten components take 90 million
MOST_NUMBERS = 50_000_000  # of a table, which a small Parquet file may hold many times over
MOST_COLUMNS = 1000
_NONE: Mapping[str, Sequence[str]] = {}  # no column holds texts
_NO_READERS: Mapping[str, Callable[[str], float]] = {}  # all numbers are written as numbers
_MISSING = ("", "nan", "na", "null")  # texts of a number that is missing, in lower case
SEPARATORS = "columns must be separated by commas; decimals have a point"


def read_user_table(
    source: Path | pd.DataFrame,
    check_header: Callable[[list[str]], Collection[str] | None],
    only: Collection[str] = (),
    names: Mapping[str, Sequence[str]] = _NONE,
    readers: Mapping[str, Callable[[str], float]] = _NO_READERS,
) -> dict[str, Any]:
    """The columns of a table of numbers by name; a missing number is NaN.

    `names` has the texts that some columns may hold; such a column becomes indices of its texts.
    `readers` has what reads the texts and dates of some columns as numbers.

    A file is Parquet if its name ends in ``.parquet``, else CSV. The first line of CSV names the
    columns; lines before it that begin with ``#`` are comments. The index of a table in memory
    counts as a column if it has a name. `check_header` raises an error if the names of the columns
    are wrong, and may return those that hold texts. With `only`, other columns are left out, and
    may hold anything. Errors count rows from 1, without the line of names and blank lines.

    Raises `ValueError` if the file is too large, is not such a table, or holds anything but
    numbers. Raises `OSError` if it cannot be read.
    """
    if isinstance(source, pd.DataFrame):
        table = source if source.index.name is None else source.reset_index()
        header = list(map(str, table.columns))
        _check_size(header, len(table))
    else:
        header, table = _read(source)
    any_text = check_header(header) or ()
    return {
        name: _texts(name, table.iloc[:, place])
        if name in any_text
        else _as_read(readers[name], table.iloc[:, place])
        if name in readers and table.iloc[:, place].dtype.kind not in "iuf"
        else _numbers(name, table.iloc[:, place], names.get(name, ()))
        for place, name in enumerate(header)
        if not only or name in only
    }


def is_parquet(path: Path) -> bool:
    """Whether a file's name ends like that of a Parquet file."""
    return path.suffix.lower() == ".parquet"


def _read(path: Path) -> tuple[list[str], pd.DataFrame]:
    """The names of a file's columns, and its rows."""
    about = path.stat()
    if not stat.S_ISREG(about.st_mode):  # a pipe might never end
        raise ValueError("a table must be a file, got a folder, a pipe or a device")
    if about.st_size > MOST_BYTES:
        raise ValueError(f"a table must have at most {MOST_BYTES:,} bytes, got {about.st_size:,}")
    try:
        return _in_parquet(path) if is_parquet(path) else _in_csv(path)
    except UnicodeDecodeError as error:
        raise ValueError(
            "a CSV table must be UTF-8 text, got other bytes: save the sheet as CSV in UTF-8"
        ) from error
    except pd.errors.EmptyDataError as error:
        raise ValueError("a table must have a line that names the columns, got none") from error
    except (pd.errors.ParserError, OverflowError) as error:
        reason = _first_line(error).rpartition("error: ")[2]
        raise ValueError(
            f"{SEPARATORS}; lines must have as many values as the first: {reason}"
        ) from error
    except pa.ArrowException as error:
        raise ValueError(
            f"must be a Parquet table, got an error: {shown(_first_line(error))}"
        ) from error


def _in_csv(path: Path) -> tuple[list[str], pd.DataFrame]:
    with path.open(encoding="utf-8-sig", newline="") as file:
        start = 0
        while file.readline().startswith("#"):  # comments
            start = file.tell()
        file.seek(start)
        # With a header, pandas would rename equal columns and make an index of further values.
        lines = pd.read_csv(file, header=None, dtype=str, keep_default_na=False)
    header = [str(name).strip() for name in lines.iloc[0]]
    _check_size(header, len(lines) - 1)
    return header, lines.iloc[1:]


def _in_parquet(path: Path) -> tuple[list[str], pd.DataFrame]:
    with path.open("rb") as file, pq.ParquetFile(file) as table:
        header = list(map(str, table.schema_arrow.names))
        _check_size(header, table.metadata.num_rows)  # before the table is unpacked
        return header, table.read().to_pandas(ignore_metadata=True)  # an index is a column


def _first_line(error: Exception) -> str:
    return str(error).strip().partition("\n")[0]


def _check_size(header: list[str], rows: int) -> None:
    if len(header) > MOST_COLUMNS:
        raise ValueError(f"a table must have at most {MOST_COLUMNS:,} columns, got {len(header):,}")
    if rows * len(header) > MOST_NUMBERS:
        raise ValueError(
            f"a table must have at most {MOST_NUMBERS:,} numbers, got {rows:,} rows of "
            f"{len(header)} columns"
        )
    for name, count in Counter(header).items():
        if count > 1:
            raise ValueError(f"the columns must have different names, got {shown(name)} twice")


def _texts(name: str, column: "pd.Series[Any]") -> NDArray[Any]:
    """The texts of a column, none of which may be empty."""
    texts = column.astype(str).str.strip()
    for row in np.flatnonzero(column.isna() | texts.str.lower().isin(_MISSING))[:1]:
        raise ValueError(f"column {shown(name)} must not be empty, got nothing in row {row + 1}")
    return texts.to_numpy()


def _numbers(name: str, column: "pd.Series[Any]", names: Sequence[str]) -> Array:
    """The numbers of a column, also if they are texts, or the places of its texts among names."""
    numbers, kind = column, column.dtype.kind
    if names or kind == "O":
        texts = column.astype(str).str.strip()
        if names:
            numbers = texts.map({text: place for place, text in enumerate(names)})
            wrong = numbers.isna()
        else:
            numbers = pd.to_numeric(texts, errors="coerce")
            wrong = numbers.isna() & column.notna() & ~texts.str.lower().isin(_MISSING)
        for row in np.flatnonzero(wrong)[:1]:
            rule = f"one of {', '.join(names)}" if names else "a number"
            place = f"column {shown(name)} in row {row + 1}"
            raise ValueError(must_be(place, rule, texts.iloc[row], names))
    elif kind not in "iuf":
        raise ValueError(f"column {shown(name)} must hold numbers, got {column.dtype}")
    return numbers.to_numpy(np.float64, copy=True, na_value=np.nan)


def _as_read(read: Callable[[str], float], column: "pd.Series[Any]") -> Array:
    """The numbers of a column of texts or dates."""
    numbers = list[float]()
    for row, value in enumerate(column, 1):
        try:
            numbers.append(read(str(as_text(value)).strip()))
        except PfdistError as error:
            raise ValueError(f"{error} (row {row})") from error
    return np.array(numbers, np.float64)


def write_user_table(path: Path, table: pa.Table) -> None:
    """Write a user's table atomically: as Parquet if the name ends in ``.parquet``, else as CSV.

    It replaces only an earlier table of the same kind. The table has a schema of
    `pfdist.store.schema`, which names its kind. Raises `StoreError` if the file cannot be written,
    or if another file has this name.
    """
    check_table_replaceable(path, table.schema)

    def write(temporary: Path) -> None:
        if is_parquet(path):
            write_table(table, temporary)
        else:
            with temporary.open("w", encoding="utf-8", newline="") as file:
                table.to_pandas().to_csv(file, index=False, lineterminator="\n")

    write_file(path, write)


def check_table_replaceable(path: Path, schema: pa.Schema) -> None:
    """Raise `StoreError` if a file exists that is not an earlier such table."""
    check_replaceable(path, partial(_is_earlier, schema))


def _is_earlier(schema: pa.Schema, path: Path) -> bool:
    if is_parquet(path):
        return holds_table(path, schema.metadata[b"table"])
    line = ",".join(schema.names).encode() + b"\n"
    return begins_with(path, line, len(line))
