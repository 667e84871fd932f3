"""Tables of numbers that a user brings, in CSV or Parquet, and tables that the user gets."""

import re
import stat
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from pfdist.common.nearest import did_you_mean
from pfdist.errors import shown
from pfdist.store.files import begins_with, check_replaceable, write_file
from pfdist.store.tables import holds_table, write_table

Array = NDArray[np.float64]
CheckHeader = Callable[[list[str]], None]
_Check = Callable[[list[str], int], None]  # of the names of the columns, and the number of rows
# The names of the columns, each column by its place, and the numbers of a column by its name.
_Columns = tuple[list[str], Callable[[int], Iterable[Any]], Callable[[str, Any], Array]]

MOST_BYTES = 200_000_000  # of a file: a million particles of ten components take 90 million
MOST_NUMBERS = 50_000_000  # of a table, which a small Parquet file may hold many times over
MOST_COLUMNS = 1000
_NONE: Mapping[str, Sequence[str]] = {}  # no column holds texts
_MISSING = ("", "nan", "na", "null")  # texts of a number that is missing, in lower case
_UNEQUAL = re.compile(r"Expected (\d+) fields in line (\d+), saw (\d+)")  # the words of pandas
SEPARATORS = "columns must be separated by commas; decimals have a point"


def read_user_table(
    path: Path | pd.DataFrame,
    check_header: CheckHeader,
    only: Collection[str] = (),
    names: Mapping[str, Sequence[str]] = _NONE,
) -> dict[str, Array]:
    """The columns of a table of numbers by their names; a missing number is NaN.

    `names` has the texts that some columns may hold; such a column gives the places of its texts.

    A file is Parquet if its name ends in ``.parquet``, else CSV, whose first line names the
    columns. The index of a table in memory counts as a column if it has a name. `check_header`
    raises an error if the names of the columns are wrong; it is called before any number is read.
    With `only`, other columns are left out, and may hold anything.

    Raises `ValueError` if the file is too large, is no such table, or holds other things than
    numbers. Raises `OSError` if it cannot be read.
    """

    def check(header: list[str], rows: int) -> None:
        _check_size(header, rows)
        check_header(header)

    if isinstance(path, pd.DataFrame):
        header, column, numbers = _in_memory(path, check)
    else:
        about = path.stat()
        if not stat.S_ISREG(about.st_mode):  # a pipe might never end
            raise ValueError("a table must be a file, got something else")
        if about.st_size > MOST_BYTES:
            raise ValueError(
                f"a table of at most {MOST_BYTES:,} bytes is read, got {about.st_size:,}"
            )
        header, column, numbers = (_in_parquet if is_parquet(path) else _in_csv)(path, check)
    return {
        name: _places(path, name, column(k), names[name])
        if name in names
        else numbers(name, column(k))
        for k, name in enumerate(header)
        if not only or name in only
    }


def is_parquet(path: Path) -> bool:
    """Whether a file's name is that of a Parquet file."""
    return path.suffix.lower() == ".parquet"


def row_in(table: Path | pd.DataFrame, row: int) -> str:
    """The place of a row, which counts from 0: the line of a CSV file, or the row of another table.

    The line that names the columns is line 1. Blank lines are no rows.
    """
    if isinstance(table, pd.DataFrame) or is_parquet(table):
        return f"row {row + 1}"
    with table.open(encoding="utf-8-sig", errors="replace") as file:
        lines = (number for number, line in enumerate(file, 1) if line.strip())
        return f"line {next(islice(lines, row + 1, None), row + 2)}"


def _places(
    path: Path | pd.DataFrame, name: str, texts: Iterable[Any], names: Sequence[str]
) -> Array:
    """The place of each text of a column among the names that it may hold."""
    entries = [str(text).strip() for text in texts]
    for row, text in enumerate(entries):
        if text not in names:
            raise ValueError(
                f"column {shown(name)} must hold {', '.join(names)}, got {shown(text)} in "
                f"{row_in(path, row)}{did_you_mean(text, names)}"
            )
    return np.array([names.index(text) for text in entries], np.float64)


def _in_memory(table: pd.DataFrame, check: _Check) -> _Columns:
    if table.index.name is not None:
        table = table.reset_index()
    header = list(map(str, table.columns))
    check(header, len(table))
    return header, lambda k: table.iloc[:, k], _from_memory


def _from_memory(name: str, column: "pd.Series[Any]") -> Array:
    """A column of a DataFrame as numbers."""
    try:
        numbers = pd.to_numeric(column)
        if numbers.dtype.kind not in "biuf":
            raise TypeError(f"got {numbers.dtype}")
        return numbers.to_numpy(np.float64, copy=True)
    except (TypeError, ValueError) as error:
        reason = str(error).partition("\n")[0]
        raise ValueError(f"column {shown(name)} must hold numbers: {reason}") from error


def _in_csv(path: Path, check: _Check) -> _Columns:
    with path.open(encoding="utf-8-sig", newline="") as file:
        try:
            text = pd.read_csv(file, header=None, dtype=str, keep_default_na=False, low_memory=True)
        except UnicodeDecodeError as error:
            raise ValueError(
                "a CSV table must be UTF-8 text, got other bytes: save the sheet as CSV in UTF-8"
            ) from error
        except pd.errors.EmptyDataError as error:
            raise ValueError("a table must have a line that names the columns, got none") from error
        except (pd.errors.ParserError, OverflowError) as error:
            reason = str(error).strip().partition("\n")[0].rpartition("error: ")[2]
            if unequal := _UNEQUAL.search(reason):
                expected, line, seen = unequal.groups()
                reason = f"got {seen} values in line {line}, {expected} in the first"
            raise ValueError(
                f"{SEPARATORS}; lines must have as many values as the first: {reason}"
            ) from error
    text = text.fillna("")
    header = [str(name).strip() for name in text.iloc[0]]
    check(header, len(text) - 1)
    values = text.iloc[1:]
    return header, lambda k: values.iloc[:, k].str.strip(), partial(_numbers, path)


def _numbers(path: Path, name: str, text: "pd.Series[str]") -> Array:
    """A column of a CSV file as numbers."""
    missing = text.str.lower().isin(_MISSING).to_numpy(dtype=bool)
    numbers: Array = pd.to_numeric(text, errors="coerce").to_numpy(np.float64, copy=True)
    wrong = np.flatnonzero(np.isnan(numbers) & ~missing)
    if wrong.size:
        row = int(wrong[0])
        raise ValueError(
            f"column {shown(name)} must hold numbers, got {shown(text.iloc[row])} in "
            f"{row_in(path, row)}"
        )
    numbers[missing] = np.nan
    return numbers


def _in_parquet(path: Path, check: _Check) -> _Columns:
    try:
        with path.open("rb") as file, pq.ParquetFile(file) as table:
            header = list(map(str, table.schema_arrow.names))
            check(header, int(table.metadata.num_rows))
            columns = table.read()
    except (pa.ArrowException, pa.ArrowInvalid) as error:
        reason = str(error).partition("\n")[0]
        raise ValueError(f"a Parquet table was expected, got {shown(reason)}") from error
    return header, columns.column, _values


def _values(name: str, column: pa.ChunkedArray) -> Array:
    """A column of a Parquet file as numbers."""
    kind = column.type
    if not (pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_null(kind)):
        raise ValueError(f"column {shown(name)} must hold numbers, got {shown(str(kind))}")
    return np.array(column.cast(pa.float64(), safe=False).to_numpy(), np.float64)


def _check_size(header: list[str], rows: int) -> None:
    if len(header) > MOST_COLUMNS:
        raise ValueError(f"a table must have at most {MOST_COLUMNS:,} columns, got {len(header):,}")
    if rows * len(header) > MOST_NUMBERS:
        raise ValueError(
            f"a table must have at most {MOST_NUMBERS:,} numbers, got {rows:,} rows of "
            f"{len(header)} columns"
        )
    for column, name in enumerate(header):
        if name in header[:column]:
            raise ValueError(f"the columns must have different names, got {shown(name)} twice")


def write_user_table(path: Path, table: pa.Table) -> None:
    """Write a table for a user atomically: Parquet if the name ends in ``.parquet``, else CSV.

    It replaces an earlier table of the same kind, and no other file. The table has a schema of
    `pfdist.store.schema`, which says its kind. Raises `StoreError` if the file cannot be written,
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
    """Raise a `StoreError` unless a file is missing, or is an earlier such table."""
    check_replaceable(path, partial(_is_earlier, schema))


def _is_earlier(schema: pa.Schema, path: Path) -> bool:
    if is_parquet(path):
        return holds_table(path, schema.metadata[b"table"])
    line = ",".join(schema.names).encode() + b"\n"
    return begins_with(path, line, len(line))
