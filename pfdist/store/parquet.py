"""The store of one run: commit parts as they come, publish them as tables when a phase ends.

::

    parts/<table>/<phase>-<key>.<rows>-<SHA-256>.parquet
                                             committed one by one, gone when their phase is done
    tables/<table>/<phase>-00000.parquet     published: sorted, cut at fixed counts
    manifest/tables/<table>/<phase>-00000.parquet/<rows>-<SHA-256>
                                             what a published file must hold

A reader sees both as one. A phase may be published again and again with the same outcome, so a
process may die at any instant of it.
"""

from collections.abc import Iterable
from pathlib import Path

import pyarrow as pa

from pfdist.store import files
from pfdist.store.clock_columns import ClockColumns
from pfdist.store.reader import Reader
from pfdist.store.schema import KEYS
from pfdist.store.tables import cut_rows, signed, unique

ROWS_IN_A_FILE = {"draws": 1_000_000, "comparison": 50_000, "error_sums": 200}
_MANY = 1_000_000_000  # rows of the other tables: one file a phase


class Store(Reader):
    """Tables of one run, to be read and written.

    Parameters
    ----------
    path : Path
    run_key : str, optional
        As of `Reader`.
    clock : ClockColumns, optional
        The clock of the run. Callers hand over instants, and the tables hold times on the clock.
    """

    def __init__(
        self, path: Path, run_key: str | None = None, clock: ClockColumns | None = None
    ) -> None:
        super().__init__(path, run_key)
        self._clock = clock

    def timed(self, rows: pa.Table) -> pa.Table:
        """Give rows with times on the clock of the run in the place of instants."""
        return rows if self._clock is None else self._clock.table(rows)

    def own_schema(self, schema: pa.Schema) -> pa.Schema:
        """Give the schema that a table has in this store: with a clock, times are numbers."""
        return schema if self._clock is None else self._clock.schema(schema)

    def sweep(self) -> None:
        """Remove unfinished files of killed processes."""
        files.sweep(self.path)

    def commit(self, table: str, phase: str, key: str, rows: pa.Table) -> None:
        """Commit rows of a phase; committing the same key again does nothing.

        Parameters
        ----------
        table : str
        phase : str
        key : str
            Identifies the rows.
        rows : pyarrow.Table
        """
        folder = self.path / "parts" / table
        path = next(folder.glob(f"{phase}-{key}.*.parquet"), None)
        if path is None:
            prepared = files.prepare_table(folder, self._prepared(rows))
            path = folder / f"{phase}-{key}.{prepared.stamp}.parquet"
            files.give_name(prepared, path, replace=False)
        if table == "draws":  # even if it was there: another driver may have committed it
            self._draw_files.add(path, rows["evaluation"])

    def publish(self, table: str, phase: str, pieces: Iterable[pa.Table]) -> None:
        """Write all rows of a phase as files of its table, and remove the phase's parts.

        If the process dies meanwhile, parts remain, and the next call writes the same files.

        Parameters
        ----------
        table : str
        phase : str
        pieces : iterable of pyarrow.Table
            All rows of the phase in their order, in pieces of any sizes.
        """
        settled = []
        for number, rows in enumerate(cut_rows(pieces, ROWS_IN_A_FILE.get(table, _MANY))):
            path = self.path / "tables" / table / f"{phase}-{number:05d}.parquet"
            prepared = files.prepare_table(path.parent, self._prepared(rows.combine_chunks()))
            before = self.manifest.expect(path, prepared.stamp)
            files.give_name(prepared, path, replace=True)
            settled.append((path, prepared.stamp, before))
            if table == "draws":
                self._draw_files.add(path, rows["evaluation"])
        for path, stamp, before in settled:
            self.manifest.settle(path, stamp, before)
        gone = self._parts(table, phase)
        for path in gone:
            files.remove(path)
        self._draw_files.remove(gone)

    def _prepared(self, rows: pa.Table) -> pa.Table:
        """Give rows as files hold them."""
        return signed(self.timed(rows), self._run_key)

    def settle(self, table: str, phase: str) -> None:
        """Publish all rows that a phase has committed so far, sorted by key, if it has parts."""
        if self.has_parts(table, phase):
            self.publish(table, phase, [unique(self._load(table, phase), KEYS[table])])

    def renew(self, table: str, phase: str, rows: pa.Table) -> None:
        """Publish rows beside the published rows of a phase, and in the place of the same keys."""
        pieces = [self.timed(rows), *self._load(table, phase)]
        self.publish(table, phase, [unique(pieces, KEYS[table])])
