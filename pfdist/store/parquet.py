"""The store of one run: commit parts as they come, publish them as tables when a phase ends.

::

    parts/<table>/<phase>-<key>.parquet      committed one by one, gone when their phase is done
    tables/<table>/<phase>-00000.parquet     published: sorted, cut at fixed counts

A reader sees both as one. A phase may be published again and again with the same outcome, so a
process may die at any instant of it.
"""

import contextlib
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.dataset as ds
import pyarrow.parquet as pq
from numpy.typing import NDArray

from pfdist.errors import StoreError
from pfdist.store import files
from pfdist.store.schema import KEYS, SCHEMA_VERSION, schema

ROWS_IN_A_FILE = {"draws": 1_000_000, "comparison": 50_000}
_MANY = 1_000_000_000  # rows of the other tables: one file a phase
_ATTEMPTS = 5


class Store:
    """Tables of one run.

    Parameters
    ----------
    path : Path
        The run's folder.

    Every reading raises a `StoreError` where a file cannot be read or is of a newer schema.
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    # --- writing ------------------------------------------------------------------------------

    def sweep(self) -> None:
        """Remove what a killed process left half written."""
        files.sweep(self.path)

    def commit(self, table: str, phase: str, key: str, rows: pa.Table) -> None:
        """Commit rows of a phase; the same key again is a no-op.

        Parameters
        ----------
        table : str
        phase : str
        key : str
            Says what the rows are.
        rows : pyarrow.Table
        """
        path = self.path / "parts" / table / f"{phase}-{key}.parquet"
        files.write_table(path, rows)
        if table == "draws":
            self._index(path, rows)

    def publish(self, table: str, phase: str, pieces: Iterable[pa.Table]) -> None:
        """Write all rows of a phase as the files of its table; then its parts go.

        Cut short at any instant it leaves parts behind, and is to be called again: it gives the
        same files.

        Parameters
        ----------
        table : str
        phase : str
        pieces : iterable of pyarrow.Table
            All rows of the phase in their order, in pieces of any sizes.
        """
        for number, rows in enumerate(cut_rows(pieces, ROWS_IN_A_FILE.get(table, _MANY))):
            path = self.path / "tables" / table / f"{phase}-{number:05d}.parquet"
            files.write_table(path, rows.combine_chunks(), replace=True)
            if table == "draws":
                self._index(path, rows)
        for path in self._parts(table, phase):
            files.remove(path)
            if table == "draws":
                for holders in self._files_of_evaluation.values():
                    holders.discard(path)

    # --- reading ------------------------------------------------------------------------------

    def read(self, table: str) -> pd.DataFrame:
        """Read a whole table, parts and published files as one, sorted by key."""
        pieces = self._load(table)
        if not pieces:
            raise StoreError(f"the run {self.path} has no table {table!r} yet")
        frame: pd.DataFrame = pd.concat([piece.to_pandas() for piece in pieces])
        return frame.drop_duplicates(KEYS[table]).sort_values(KEYS[table], ignore_index=True)

    def has(self, table: str) -> bool:
        """Whether anything of a table was committed."""
        return bool(self._files(table))

    def has_parts(self, table: str = "*", phase: str = "*") -> bool:
        """Whether a phase, or the run, has rows that are not published yet."""
        return bool(self._parts(table, phase))

    def rows_between(self, table: str, column: str, first: int, last: int) -> pa.Table | None:
        """Rows, parts and published, whose column lies in first..last-1; sorted, each once."""
        paths = self._files(table)
        if not paths:
            return None
        bounds = (pc.field(column) >= first) & (pc.field(column) < last)
        found = _guarded(
            paths[0], lambda: ds.dataset([str(path) for path in paths]).to_table(filter=bounds)
        ).sort_by(column)
        values = found[column].to_numpy()
        keep = np.ones(len(values), bool)
        keep[1:] = values[1:] != values[:-1]
        return found.filter(pa.array(keep))

    def column(self, table: str, column: str) -> NDArray[np.int64]:
        """One integer column of all files of a table, in no order and perhaps repeated."""
        pieces = [piece[column].to_numpy() for piece in self._load(table, [column])]
        return np.concatenate([np.empty(0, np.int64), *pieces])

    def per_draw(self, evaluations: Sequence[str]) -> pa.Table:
        """Rows of the draws table of these evaluations, in their order and by draw, each once."""
        ids = list(evaluations)
        paths = set().union(*(self._files_of_evaluation.get(id_, set()) for id_ in ids))
        wanted = pc.field("evaluation").isin(ids)
        found = [_read_file(path, filters=wanted) for path in sorted(paths)]
        if not found:
            return schema("draws").empty_table()
        rows = pa.concat_tables(found)
        place = pc.index_in(rows["evaluation"], pa.array(ids)).to_numpy()
        draw = rows["draw"].to_numpy()
        order = np.lexsort((draw, place))
        first = np.ones(order.size, np.bool_)
        first[1:] = (np.diff(place[order]) != 0) | (np.diff(draw[order]) != 0)
        return rows.take(order[first])

    def _parts(self, table: str, phase: str) -> list[Path]:
        return sorted((self.path / "parts").glob(f"{table}/{phase}-*.parquet"))

    def _files(self, table: str) -> list[Path]:
        # Parts are listed first: a row that is published in between is then seen twice, not never.
        parts = sorted((self.path / "parts" / table).glob("[!.]*.parquet"))
        tables = sorted((self.path / "tables" / table).glob("[!.]*.parquet"))
        return tables + parts

    def _load(self, table: str, columns: list[str] | None = None) -> list[pa.Table]:
        """Read all files of a table, again from the start if one was published meanwhile."""
        for _ in range(_ATTEMPTS):
            with contextlib.suppress(FileNotFoundError):
                return [_read_file(path, columns) for path in self._files(table)]
        raise StoreError(f"the run {self.path} changes faster than it can be read: try again")

    @cached_property
    def _files_of_evaluation(self) -> dict[str, set[Path]]:
        """Where each evaluation's draws are, read once and then kept up to date."""
        index: dict[str, set[Path]] = defaultdict(set)
        for path in self._files("draws"):
            for id_ in _read_file(path, ["evaluation"])["evaluation"].unique().to_pylist():
                index[id_].add(path)
        return index

    def _index(self, path: Path, rows: pa.Table) -> None:
        for id_ in rows["evaluation"].unique().to_pylist():
            self._files_of_evaluation[id_].add(path)


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


def _guarded(path: Path, read: Callable[[], pa.Table]) -> pa.Table:
    try:
        return read()
    except FileNotFoundError:
        raise
    except (OSError, pa.ArrowInvalid) as error:
        reason = str(error).splitlines()[0]
        raise StoreError(f"cannot read {path}: {reason}") from error


def _read_file(
    path: Path, columns: list[str] | None = None, filters: pc.Expression | None = None
) -> pa.Table:
    table = _guarded(
        path, lambda: pq.read_table(path, columns=columns, filters=filters, partitioning=None)
    )
    version = int((table.schema.metadata or {}).get(b"pfdist_schema_version", b"0"))
    if version > SCHEMA_VERSION:
        raise StoreError(
            f"{path} is of schema version {version}; this pfdist reads up to {SCHEMA_VERSION}: "
            "use the newer pfdist that wrote it"
        )
    return table
