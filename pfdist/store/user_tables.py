"""Tables of numbers from a user, in CSV or Parquet, and tables for the user."""

import csv
import math
import re
import stat
from collections import Counter, defaultdict
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from pfdist.common.nearest import must_be
from pfdist.common.parsing import as_text
from pfdist.errors import PfdistError, shown
from pfdist.store.files import begins_with, check_replaceable, write_file
from pfdist.store.tables import (
    column_chunks,
    holds_table,
    lengths_of_texts,
    size_of_pages,
    write_table,
)

Array = NDArray[np.float64]

MOST_BYTES = 200_000_000  # of a file: a million particles of ten components take 90 million
MOST_NUMBERS = 50_000_000  # of a table, which a small Parquet file may hold many times over
MOST_COLUMNS = 1000
_LONGEST_LINE, _LONGEST_TEXT = 1_000_000, 250  # of a header or comment; of a cell in Parquet
_CELLS = 1_000_000  # that are read at once
_NONE: Mapping[str, Sequence[str]] = {}  # no column holds texts
NO_READERS: Mapping[str, Callable[[str], Any]] = {}  # all numbers are written as numbers
NO_NAMES: Mapping[str, str] = {}  # all columns have the names that pfdist reads
_DECIMAL = r"[+-]?\d*[.,]\d+(?:[eE][+-]?\d+)?"  # a number with a decimal point or comma
_GROUPED = r"[+-]?[1-9]\d{0,2}[.,]\d{3}"  # such a number that may be a whole one, in thousands
_SPACES = r"\s+"  # between columns
_MISSING = ("", "nan", "na", "null")  # texts of a number that is missing, in lower case
SEPARATORS = (
    "columns must be separated by commas, semicolons, tabs, | or spaces; decimals have a point"
)
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?")
_BEGINS_A_FORMULA = tuple("=+-@\t")
_CODES = "problem.measurements.failed (no value came) or problem.measurements.missing (it was lost)"
_VALUE = re.compile(r"[<>]?\s*[+-]?[.\d][-+.,:/\deETZ ]*")  # a number, or a date


def read_user_table(
    source: Path | pd.DataFrame,
    check_header: Callable[[list[str]], Collection[str] | None],
    only: Collection[str] = (),
    names: Mapping[str, Sequence[str]] = _NONE,
    readers: Mapping[str, Callable[[str], Any]] = NO_READERS,
    most_rows: int = MOST_NUMBERS,
    renamed: Mapping[str, str] = NO_NAMES,
) -> dict[str, Any]:
    """The columns of a table of numbers by name; a missing number is NaN.

    `names` has the texts that some columns may hold; such a column becomes indices of its texts.
    `readers` has what reads the texts and dates of some columns, as numbers or as texts. `renamed`
    has the name in the table of columns that have another name there.

    A file is Parquet if its name ends in ``.parquet``, else CSV. The first line of CSV names the
    columns; lines before it that begin with ``#`` are comments. Columns are separated by commas,
    semicolons, tabs or ``|``, whichever the line of names has most of, or else by spaces; without
    commas between columns, decimals may have a comma, unless a number could be one of thousands. A
    row of units or formats is an error. The index of a table in memory counts as a column if it has
    a name. `check_header` raises an error if the names of the columns are wrong, and may return
    those that hold texts. With `only`, other columns are left out, and may hold anything. Errors
    count rows from 1, without the line of names and blank lines.

    The names of the columns, and of Parquet the types and sizes, are checked before any row is
    read. Rows become numbers a part at a time, so memory grows with the numbers alone.

    Raises `ValueError` if the file is too large, is not such a table, or holds anything but
    numbers. Raises `OSError` if it cannot be read.
    """
    any_text: Collection[str] = ()
    back = {column: name for name, column in renamed.items()}

    def wanted(header: list[str]) -> list[str]:
        nonlocal any_text
        for column in back:
            if column not in header:
                rule = f"columns of the table, {', '.join(header)}"
                raise ValueError(must_be("columns", rule, column, header))
        named = [back.get(column, column) for column in header]
        if len(header) > MOST_COLUMNS:
            rule = f"a table must have at most {MOST_COLUMNS:,} columns"
            raise ValueError(f"{rule}, got {len(header):,}")
        any_text = check_header(named) or ()
        for name, count in Counter(named).items():
            if count > 1 and (not only or name in only):
                rule = "the columns must have different names"
                raise ValueError(f"{rule}, got {shown(name)} twice")
        return [each for each in header if not only or back.get(each, each) in only]

    is_whole = isinstance(source, pd.DataFrame)
    columns, rows = defaultdict[Any, list[NDArray[Any]]](list), 0
    for part in _parts(source, wanted, most_rows):
        table = part.set_axis(pd.RangeIndex(rows, rows + len(part))).rename(columns=back)
        rows += len(table)
        # A CSV file is read only until it has too many.
        _check_rows(rows, table.shape[1], most_rows, f"{rows:,}" if is_whole else "more")
        for name in table.columns:
            columns[name].append(
                _texts(name, table[name])
                if name in any_text
                else _as_read(readers[name], table[name])
                if name in readers and table[name].dtype.kind not in "iuf"
                else _numbers(name, table[name], names.get(name, ()))
            )
    return {name: np.concatenate(columns.pop(name)) for name in [*columns]}


def is_parquet(path: Path) -> bool:
    """Whether a file's name ends like that of a Parquet file."""
    return path.suffix.lower() == ".parquet"


def _parts(
    source: Path | pd.DataFrame, wanted: Callable[[list[str]], list[str]], most_rows: int
) -> Iterator[pd.DataFrame]:
    """The wanted columns of a table, some rows at a time; `wanted` checks the names of all."""
    if isinstance(source, pd.DataFrame):
        table = source if source.index.name is None else source.reset_index()
        table = table.set_axis([*map(str, table.columns)], axis=1)
        yield table[wanted([*table.columns])]
        return
    about = source.stat()
    if not stat.S_ISREG(about.st_mode):  # a pipe might never end
        raise ValueError("a table must be a file, got a folder, a pipe or a device")
    if about.st_size > MOST_BYTES:
        raise ValueError(f"a table must have at most {MOST_BYTES:,} bytes, got {about.st_size:,}")
    try:
        if is_parquet(source):
            yield from _in_parquet(source, wanted, most_rows)
        else:
            yield from _in_csv(source, wanted)
    except UnicodeDecodeError as error:
        raise ValueError(
            "a CSV table must be UTF-8 text, got other bytes: save the sheet as CSV in UTF-8"
        ) from error
    except (csv.Error, pd.errors.ParserError, OverflowError) as error:
        reason = _first_line(error).rpartition("error: ")[2]
        raise ValueError(
            f"{SEPARATORS}; lines must have as many values as the first: {reason}"
        ) from error
    except pa.ArrowException as error:
        raise ValueError(
            f"must be a Parquet table, got an error: {shown(_first_line(error))}"
        ) from error


def _in_csv(path: Path, wanted: Callable[[list[str]], list[str]]) -> Iterator[pd.DataFrame]:
    with path.open(encoding="utf-8-sig", newline="") as file:
        lines = iter(partial(file.readline, _LONGEST_LINE), "")
        above, line = -1, "#"
        while line.startswith("#") or line.isspace():  # comments
            above, line = above + 1, next(lines, "")
        if len(line) == _LONGEST_LINE:
            raise ValueError(f"the first line must be shorter than {_LONGEST_LINE:,} letters")
        if not line:
            raise ValueError("a table must have a line that names the columns, got none")
        separator = max(",;\t|", key=line.count)
        if separator not in line and '"' not in line and len(line.split()) > 1:
            separator, names = _SPACES, line.split()
        else:
            names = next(csv.reader(chain([line], lines), delimiter=separator))
        header = [name.strip("\ufeff ") for name in names]
        kept, start, mark = wanted(header), 1, ""
        file.seek(0)
        for _ in range(above):
            file.readline(_LONGEST_LINE)
        # With a header, pandas would rename equal columns and make an index of further values; with
        # `usecols`, it would take lines of any length.
        with pd.read_csv(
            file, sep=separator, header=None, dtype=str, keep_default_na=False,
            chunksize=_CELLS // len(header),
        ) as parts:  # fmt: skip
            for part in parts:
                if separator == _SPACES and (part == "").any(axis=None):
                    raise ValueError(
                        "between spaces, each row must have as many values as the first: write nan "
                        "for a missing one, or commas between columns"
                    )
                if start and len(part) > 1:
                    _check_holds_values(part.iloc[1])
                table = part.set_axis(header, axis=1)[kept].iloc[start:]
                if separator != ",":
                    table, mark = _with_points(table, mark)
                yield table
                start = 0


def _check_holds_values(row: "pd.Series[Any]") -> None:
    """Raise ValueError if the first row has units or formats of columns, as agencies write them."""
    cells = [text for cell in row.dropna() if (text := cell.strip()).lower() not in _MISSING]
    if cells and not any(map(_VALUE.fullmatch, cells)):
        raise ValueError(
            f"the row below the names must hold values, got {shown(' '.join(cells))}: remove a row "
            "of units or formats"
        )


def _with_points(table: pd.DataFrame, mark: str) -> tuple[pd.DataFrame, str]:
    """Texts not between commas, with decimal points; and the mark of decimals, empty if unknown."""
    cells = pd.Series(table.to_numpy().ravel(), dtype=object).dropna().astype(str).str.strip()
    numbers = cells[cells.str.fullmatch(_DECIMAL)]
    marks = {*numbers.str.extract("([.,])")[0], *mark}
    if len(marks) > 1 or (marks and not mark and numbers.str.fullmatch(_GROUPED).all()):
        raise ValueError(
            "decimals must all have a comma or all a point, and one number must "
            f"show that it is not thousands, got {shown(', '.join(numbers.unique()[:2]))}: "
            f"{SEPARATORS}"
        )
    if "," in marks:
        table = table.replace(r"^\s*([+-]?\d*),(\d+(?:[eE][+-]?\d+)?)\s*$", r"\1.\2", regex=True)
    return table, next(iter(marks), "")


def _in_parquet(
    path: Path, wanted: Callable[[list[str]], list[str]], most_rows: int
) -> Iterator[pd.DataFrame]:
    with path.open("rb") as file:
        about = pq.read_metadata(file)
        schema = about.schema.to_arrow_schema()
        kept = wanted([*map(str, schema.names)])
        texts = [name for name in kept if _holds_texts(schema.field(name))]
        chunks = [each for each in column_chunks(about) if each.path_in_schema in kept]
        rows = sum(each.num_values for each in chunks) // len(kept)
        _check_rows(rows, len(kept), most_rows)
        size = size_of_pages(file, chunks)[0]
        if size > (most := 8 * MOST_NUMBERS):
            raise ValueError(f"a table must have at most {most:,} bytes unpacked, got {size:,}")
        yield schema.empty_table().select(kept).to_pandas(ignore_metadata=True)  # index: a column
        # A text that many rows share is unpacked once, and measured before it is repeated.
        with pq.ParquetFile(file, metadata=about, read_dictionary=texts) as table:
            for batch in table.iter_batches(_CELLS // len(kept), columns=kept):
                for name in texts:
                    if (longest := lengths_of_texts(batch.column(name))[0]) > _LONGEST_TEXT:
                        rule = f"a text must have at most {_LONGEST_TEXT} bytes, got {longest:,}"
                        raise ValueError(f"{rule} in column {shown(name)}")
                yield batch.to_pandas(ignore_metadata=True)


def _holds_texts(field: pa.Field) -> bool:
    """Whether a column of a Parquet file holds texts; a `ValueError` if it can hold no numbers."""
    kind = field.type.value_type if pa.types.is_dictionary(field.type) else field.type
    must = f"column {shown(field.name)} must"
    if pa.types.is_string(kind) or pa.types.is_large_string(kind):
        return True
    if not (pa.types.is_primitive(kind) or pa.types.is_decimal(kind) or pa.types.is_null(kind)):
        raise ValueError(f"{must} hold numbers, texts or dates, got {kind}")
    try:
        pa.array([], kind).to_pandas()
    except (pa.ArrowException, KeyError) as error:
        raise ValueError(f"{must} have a time zone that this machine knows, got {kind}") from error
    return False


def _first_line(error: Exception) -> str:
    return str(error).strip().partition("\n")[0]


def _check_rows(rows: int, columns: int, most_rows: int, got: str = "") -> None:
    if rows > (most := min(most_rows, MOST_NUMBERS // columns)):
        rule = f"a table of {columns} columns must have at most {most:,} rows"
        raise ValueError(f"{rule}, got {got or f'{rows:,}'}")


def _texts(name: str, column: "pd.Series[Any]") -> NDArray[Any]:
    """The texts of a column, none of which may be empty."""
    texts = column.astype(str).str.strip()
    for row in column.index[column.isna() | texts.str.lower().isin(_MISSING)][:1]:
        raise ValueError(f"column {shown(name)} must not be empty, got nothing in row {row + 1}")
    places, different = pd.factorize(texts)
    return different.to_numpy(object)[places]  # equal texts are one object


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
        for row in column.index[wrong][:1]:
            rule = f"one of {', '.join(names)}" if names else "a number"
            place = f"column {shown(name)} in row {row + 1}"
            is_word = re.search(r"\w", texts[row]) and not name.startswith("y")
            hint = "" if is_word else "; an empty cell is a missing number"
            if name.startswith("y"):
                hint = f"{hint}, as is one with a code of {_CODES}"
            if texts[row].startswith(("<", ">")):
                hint = "; problem.sensor.limit reads it"
            elif re.fullmatch(rf"{_GROUPED}.*", texts[row]):
                hint = "; thousands have no mark"
            raise ValueError(must_be(place, rule, texts[row], names) + hint * (not names))
    elif kind not in "iuf":
        raise ValueError(f"column {shown(name)} must hold numbers, got {column.dtype}")
    return numbers.to_numpy(np.float64, copy=True, na_value=np.nan)


def number_of_cell(text: str) -> float:
    """The number of a cell, NaN if it is empty; raises ValueError if it is anything else."""
    if text.lower() in _MISSING:
        return math.nan
    try:
        # as pandas has it, which takes neither 1_0 nor other digits
        return float(text if text.isascii() and "_" not in text else "")
    except ValueError as error:
        raise ValueError(f"a cell must be a number, got {shown(text)}; codes: {_CODES}") from error


def _as_read(read: Callable[[str], Any], column: "pd.Series[Any]") -> NDArray[Any]:
    """A column of texts or dates as it is read: numbers or texts."""
    numbers = list[Any]()
    for row, value in zip(column.index, column, strict=True):
        try:
            numbers.append(read(str(as_text(value)).strip()))
        except (PfdistError, ValueError) as error:
            raise ValueError(f"{error} (row {row + 1})") from error
    return np.array(numbers, object if isinstance(next(iter(numbers), 0.0), str) else np.float64)


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
            temporary.write_bytes(csv_of(table.to_pandas()))

    write_file(path, write)


def csv_of(frame: pd.DataFrame) -> bytes:
    """A table as CSV, whose texts are texts for a spreadsheet, too.

    A spreadsheet would compute what begins with ``=``, ``+``, ``-`` or ``@``, so such a text gets
    an apostrophe before it. Numbers stay as they are.
    """
    plain = frame.rename(columns=_as_plain_text)
    for name in plain:
        if not pd.api.types.is_numeric_dtype(plain[name]):
            cells = map(_as_plain_text, plain[name])
            plain[name] = pd.Series([*cells], plain.index, object)
    text: str = plain.to_csv(index=False, lineterminator="\n")
    return text.encode(errors="surrogateescape")  # paths need not be UTF-8


def _as_plain_text(cell: Any) -> Any:
    is_computed = isinstance(cell, str) and cell[:1] in _BEGINS_A_FORMULA
    return f"'{cell}" if is_computed and not _NUMBER.fullmatch(cell) else cell


def check_table_replaceable(path: Path, schema: pa.Schema) -> None:
    """Raise `StoreError` if a file exists that is not an earlier such table."""
    check_replaceable(path, partial(_is_earlier, schema))


def _is_earlier(schema: pa.Schema, path: Path) -> bool:
    if is_parquet(path):
        return holds_table(path, schema.metadata[b"table"])
    line = csv_of(schema.empty_table().to_pandas())
    return begins_with(path, line, len(line))
