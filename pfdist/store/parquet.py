"""The store of one run: commit parts as they come, publish them as tables when a phase ends.

::

    parts/<table>/<phase>-<key>.<SHA-256>.parquet   committed one by one, gone when their phase ends
    tables/<table>/<phase>-00000.parquet            published: sorted, cut at fixed counts
    manifest                                        what published files must hold

A reader sees both as one. A phase may be published again and again with the same outcome, so a
process may die at any instant of it. A commit reads and lists nothing, so it costs the same however
much was committed before.
"""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
from numpy.typing import NDArray

from pfdist.errors import StoreError
from pfdist.store import files
from pfdist.store.about import run_key as folder_key
from pfdist.store.manifest import Manifest
from pfdist.store.schema import KEYS, QUESTIONS, ClockColumns, frame_of, keys_of, schema
from pfdist.store.tables import (
    check_names,
    cut_rows,
    first_occurrences,
    read_file,
    rows_and_run,
    signed,
    unique,
)

if TYPE_CHECKING:
    import pandas as pd

ROWS_IN_A_FILE = {"draws": 1_000_000, "comparison": 50_000, "error_sums": 200}
_MANY = 1_000_000_000  # rows of the other tables: one file a phase
_ATTEMPTS, _PAUSE_SECONDS = 50, 0.02  # another driver may be publishing the files that are read
Value = TypeVar("Value")


class Store:
    """Tables of one run, to be read and written.

    Every file must belong to the run with this key, or to that of the folder if no key is given.
    With a clock, callers hand over instants, and the tables hold times on the clock.

    Every reading raises a `StoreError` if a file cannot be read, has another schema version,
    belongs to another run, or is a published file without rows.
    """

    def __init__(
        self, path: Path, run_key: str | None = None, clock: ClockColumns | None = None
    ) -> None:
        self.path = path
        self._run_key = run_key or folder_key(path)
        self._clock = clock
        self.manifest = Manifest(path, self._run_key)
        # Files of the draws table by evaluation; None until they are needed.
        self._holders: dict[str, set[Path]] | None = None

    def timed(self, rows: pa.Table) -> pa.Table:
        """Rows with times on the clock of the run in place of instants."""
        return rows if self._clock is None else self._clock.table(rows)

    def own_schema(self, schema: pa.Schema) -> pa.Schema:
        """Schema that a table has in this store: with a clock, times are numbers."""
        return schema if self._clock is None else self._clock.schema(schema)

    def remove_unfinished(self) -> None:
        """Remove unfinished files of killed processes."""
        files.remove_unfinished(self.path)

    def commit(self, table: str, phase: str, key: str, rows: pa.Table) -> None:
        """Commit rows of a phase; committing the same rows again changes nothing.

        The key identifies the rows. The file gets its name in one step: before it nothing is
        committed, and after it all rows are.
        """
        folder = self.path / "parts" / table
        prepared = files.prepare_table(folder, self._prepared(rows))
        path = folder / f"{phase}-{key}.{prepared.sha256}.parquet"
        files.give_name(prepared, path)  # a file with this name has the same content
        if table == "draws":
            self._note_holder(path, rows)

    def publish(self, table: str, phase: str, pieces: Iterable[pa.Table]) -> None:
        """Write all rows of a phase as files of its table, and remove the phase's parts.

        The pieces have all rows of the phase in their order, in any sizes. If the process dies
        meanwhile, parts remain, and the next call writes the same files.
        """
        for number, rows in enumerate(cut_rows(pieces, ROWS_IN_A_FILE.get(table, _MANY))):
            path = self.path / "tables" / table / f"{phase}-{number:05d}.parquet"
            prepared = files.prepare_table(path.parent, self._prepared(rows.combine_chunks()))
            self.manifest.give_name(prepared, path)
            if table == "draws":
                self._note_holder(path, rows)
        # All files are there before the first part goes: every row is in a file at any instant.
        parts = self._parts(table, phase)
        for path in parts:
            files.remove(path)
        holders, gone = self._holders or {}, {*parts}
        for id_ in holders:
            holders[id_] -= gone.intersection(holders[id_])  # of all parts, few are holders

    def _prepared(self, rows: pa.Table) -> pa.Table:
        """Rows in the form in which files hold them."""
        return signed(self.timed(rows), self._run_key)

    def settle(self, table: str, phase: str) -> None:
        """Publish all committed rows of a phase, sorted by key, if it has parts."""
        if self.has_parts(table, phase):
            pieces = self._load(table, phase)
            self.publish(table, phase, [unique(pieces, keys_of(table, pieces[0].column_names))])

    def renew(self, table: str, phase: str, rows: pa.Table) -> None:
        """Publish rows beside the published rows of a phase; they replace rows of the same keys."""
        pieces = [self.timed(rows), *self._load(table, phase)]  # the first row of a key stays
        self.publish(table, phase, [unique(pieces, keys_of(table, rows.column_names))])

    def read(self, table: str, draws: int | None = None, phase: str = "") -> pd.DataFrame:
        """A table, parts and published files as one, sorted by key.

        It may be limited to the first draws, or to the rows of a phase.
        """
        import pandas as pd  # noqa: PLC0415  it loads when tables are made

        condition = None if draws is None else pc.field("draw") < draws
        pieces = self._load(table, phase, filters=condition)
        if not pieces:
            raise StoreError(f"the run {self.path} has no table {table!r} yet")
        frame: pd.DataFrame = pd.concat([frame_of(piece) for piece in pieces])
        keys = keys_of(table, [*frame.columns])
        return frame.drop_duplicates(keys).sort_values(keys, ignore_index=True)

    def compared(self) -> pd.DataFrame:
        """The table of the compared sets, whose names are checked.

        The names become parts of the names of columns and files. Raises `StoreError` if a name is
        not one that a job could have given.
        """
        rows = self.read("compared")
        check_names(rows["name"], self.path / "tables" / "compared")
        return rows

    def compared_sets(self) -> dict[str, tuple[int, ...]]:
        """The compared sets by name, the reference first; times are those of the clock."""
        rows = self.compared()
        times = [tuple(each.tolist()) for each in rows["measurement_times"]]
        return dict(zip(map(str, rows["name"]), times, strict=True))

    def has(self, table: str, phase: str = "") -> bool:
        """Whether rows of a table, or of a phase in it, were committed."""
        return bool(self._files(table, phase))

    def has_parts(self, table: str = "*", phase: str = "*", without: tuple[str, ...] = ()) -> bool:
        """Whether a phase, or the run without some phases, has rows that are not published yet."""
        parts = self._parts(table, phase)
        return any(not path.name.startswith(without) for path in parts)

    def lost(self) -> list[Path]:
        """Missing files that a run needs to be finished; those of `QUESTIONS` are left out."""
        return [path for path in self.manifest.lost() if not path.name.startswith(QUESTIONS)]

    def phases_of(self, table: str, start: str) -> list[str]:
        """Phases with parts of a table whose names begin so; these names have no hyphen."""
        parts = (self.path / "parts" / table).glob(f"{start}*.parquet")
        return sorted({path.name.partition("-")[0] for path in parts})

    def blocks(
        self, table: str, column: str, rows: int, last: int | None = None
    ) -> Iterator[pa.Table]:
        """Yield the rows whose column lies in 0..last-1, or all, in blocks of so many values.

        The rows of a block are sorted and unique; empty blocks are skipped. Only the files that
        reach into a block are read, so memory does not grow with the table.
        """
        spans: list[tuple[Path, int, int]] | None = None
        if last is None:
            spans = self._again(partial(self._spans, table, column))
            last = 1 + max((most for _, _, most in spans), default=-1)

        def look(first: int) -> pa.Table | None:
            nonlocal spans
            spans = self._spans(table, column) if spans is None else spans
            try:
                return self._between(spans, column, first, min(first + rows, last))
            except FileNotFoundError:
                spans = None
                raise

        for first in range(0, last, rows):
            block = self._again(partial(look, first))
            if block is not None:
                yield block

    def pieces(self, table: str, columns: list[str]) -> Iterator[pa.Table]:
        """Yield some columns of a table, a file at a time; rows may come twice."""
        for path in self._files(table):
            yield self._read(path, columns)

    def present(self, table: str, column: str, without: Container[Path] = ()) -> NDArray[np.bool_]:
        """Whether each value 0..largest occurs in a column of counts, in all files but some."""

        def look() -> NDArray[np.bool_]:
            occurs = np.zeros(0, np.bool_)
            for path in self._files(table):
                if path not in without:
                    values = self._read(path, [column])[column].to_numpy()
                    occurs = np.pad(
                        occurs, (0, max(0, int(values.max(initial=-1)) + 1 - occurs.size))
                    )
                    occurs[values] = True
            return occurs

        return self._again(look)

    def per_draw(self, evaluations: Sequence[str]) -> pa.Table:
        """Rows of the draws table of these evaluations, in their order and by draw, each once."""
        ids = list(evaluations)
        condition = pc.field("evaluation").isin(ids)

        def look() -> list[pa.Table]:
            paths = sorted(
                set[Path]().union(*(self._files_by_evaluation().get(id_, ()) for id_ in ids))
            )
            return [self._read(path, filters=condition) for path in paths]

        pieces = self._again(look)
        if not pieces:
            return schema("draws").empty_table()
        rows = pa.concat_tables(pieces)
        place = pc.index_in(rows["evaluation"], pa.array(ids)).to_numpy()
        draw = rows["draw"].to_numpy()
        order = np.lexsort((draw, place))
        return rows.take(order[first_occurrences(place[order], draw[order])])

    def evaluations(self, *tables: str) -> dict[str, int]:
        """Number of committed rows of each evaluation; a row in two files counts twice.

        By default, those of the tables ``draws`` and ``error_sums``.
        """

        def look() -> dict[str, int]:
            rows = Counter[str]()
            for table in tables or ("draws", "error_sums"):
                for piece in self.pieces(table, ["evaluation"]):
                    counted = piece["evaluation"].value_counts().to_pylist()
                    rows.update({each["values"]: each["counts"] for each in counted})
            return rows

        return self._again(look)

    def sums(self, evaluation: str, blocks: int) -> pa.Table:
        """Rows of the table of sums of one evaluation, for its first blocks of draws, in order."""
        condition = (pc.field("evaluation") == evaluation) & (pc.field("block") < blocks)
        pieces = [schema("error_sums").empty_table(), *self._load("error_sums", filters=condition)]
        return unique(pieces, KEYS["error_sums"])

    def _parts(self, table: str, phase: str) -> list[Path]:
        return sorted((self.path / "parts").glob(f"{table}/{phase}-*.parquet"))

    def _files(self, table: str, phase: str = "") -> list[Path]:
        pattern = f"{phase}-*.parquet" if phase else "[!.]*.parquet"
        # Parts are listed first: a row that is published meanwhile is read twice, never missed.
        parts = sorted((self.path / "parts" / table).glob(pattern))
        tables = sorted((self.path / "tables" / table).glob(pattern))
        return tables + parts

    def _load(
        self, table: str, phase: str = "", filters: pc.Expression | None = None
    ) -> list[pa.Table]:
        """Contents of all files of a table, or of those of one phase."""
        return self._again(
            lambda: [self._read(path, filters=filters) for path in self._files(table, phase)]
        )

    def _spans(self, table: str, column: str) -> list[tuple[Path, int, int]]:
        """Files of a table, and the smallest and largest value of a column in each."""
        spans = []
        for path in self._files(table):
            values = self._read(path, [column])[column].to_numpy()
            if values.size:
                spans.append((path, int(values.min()), int(values.max())))
        return spans

    def _again(self, look: Callable[[], Value]) -> Value:
        """The value of a function that reads files; it starts again if a file was published."""
        for _ in range(_ATTEMPTS):
            try:
                return look()
            except FileNotFoundError:
                self._holders = None
                time.sleep(_PAUSE_SECONDS)
        raise StoreError(f"the run {self.path} changes faster than it can be read: try again")

    def _between(
        self, spans: list[tuple[Path, int, int]], column: str, first: int, last: int
    ) -> pa.Table | None:
        """Sorted rows whose column lies in first..last-1, each once; None if there are none."""
        bounds = (pc.field(column) >= first) & (pc.field(column) < last)
        pieces = [
            # A file within the block is read as it is, which takes a third of the time.
            self._read(path, filters=None if first <= least and most < last else bounds)
            for path, least, most in spans
            if least < last and most >= first
        ]
        if not pieces:
            return None
        rows = pa.concat_tables(pieces).sort_by(column)
        return rows.filter(pa.array(first_occurrences(rows[column].to_numpy())))

    def _read(
        self, path: Path, columns: list[str] | None = None, filters: pc.Expression | None = None
    ) -> pa.Table:
        rows = read_file(path, columns, filters, self._run_key)
        if not rows.num_rows and path.parts[-3] == "tables" and not rows_and_run(path)[0]:
            raise StoreError(f"{path} has no rows; the job, run again, makes it anew")
        return rows

    def _files_by_evaluation(self) -> dict[str, set[Path]]:
        """Files of the draws table by evaluation, which are read when they are first needed."""
        if self._holders is None:
            self._holders = defaultdict(set)
            for path in self._files("draws"):
                self._note_holder(path, self._read(path, ["evaluation"]))
        return self._holders

    def _note_holder(self, path: Path, rows: pa.Table) -> None:
        """Note which evaluations a file of the draws table holds."""
        if self._holders is not None:
            for id_ in rows["evaluation"].unique().to_pylist():
                self._holders[id_].add(path)
