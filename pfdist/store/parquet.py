"""The store of one run: parts are committed at once, and published as tables after a phase.

::

    parts/<table>/<phase>-<hash>.parquet            committed one by one, gone when their phase ends
    tables/<table>/<phase>-<number>-<hash>.parquet  published: sorted, cut at fixed counts
    files.json                                      the published files; see `pfdist.store.listing`

A reader sees both as one. It reads the files in ``tables/`` that are listed, and those in
``parts/`` whose content has the hash in their name. Publishing a phase again has the same outcome,
so a process may die at any time. A commit reads and lists nothing, so its cost does not grow.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
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
from pfdist.store.listing import change_listing, read_listing
from pfdist.store.schema import KEYS, QUESTIONS, TimeColumns, frame_of, keys_of, schema
from pfdist.store.tables import (
    HASH_DIGITS,
    NAME,
    REMEDY,
    check_names,
    cut_rows,
    first_occurrences,
    name_table,
    prepare_table,
    read_file,
    signed,
    unique,
)

if TYPE_CHECKING:
    import pandas as pd

ROWS_IN_A_FILE = {"draws": 1_000_000, "comparison": 50_000, "error_sums": 200}
_MANY = 1_000_000_000  # rows of the other tables: one file a phase
_ATTEMPTS, _PAUSE_SECONDS = 50, 0.02  # another driver may be publishing the files that are read
_Value = TypeVar("_Value")
_Change = tuple[set[Path], set[Path], list[Path]]  # files that are new, files and parts that go


class Store:
    """The tables of one run, for reading and writing.

    Every file must belong to the run with this key, by default to the run in the folder. With
    `columns`, callers write instants, and the tables hold times.

    Every method that reads raises `StoreError` if a file is damaged, cannot be read, has another
    schema version, or belongs to another run.
    """

    def __init__(
        self, path: Path, run_key: str | None = None, columns: TimeColumns | None = None
    ) -> None:
        self.path = path
        self._run_key = run_key or folder_key(path)
        self._columns = columns
        # Files of the draws table by evaluation; None until they are needed.
        self._holders: dict[str, set[Path]] | None = None
        self._unlisted: list[_Change] | None = None  # see `together`

    def timed(self, rows: pa.Table) -> pa.Table:
        """Rows with times in place of instants, if the run has times."""
        return rows if self._columns is None else self._columns.table(rows)

    def recover(self) -> None:
        """Remove leftovers of killed processes, and mark a run that has lost a file as unfinished.

        Its published files become parts, which the driver publishes once it has computed the
        missing rows. The same happens to a run that has lost files.json. Answers to questions stay
        published, because a run is finished without them. A kill at any point is harmless: the next
        start does the rest.
        """
        files.remove_unfinished(self.path)
        listing, there = read_listing(self.path), self._published()
        known = there if listing is None else {self.path / name for name in listing.files}
        lost = {path for path in known - there if not path.name.startswith(QUESTIONS)}
        stays = known & there
        if lost or listing is None:
            # First the files, then the list: after a kill in between, the list lacks a file again.
            for path in [path for path in stays if not path.name.startswith(QUESTIONS)]:
                phase, hash_ = NAME.fullmatch(path.name).groups()  # type: ignore[union-attr]
                part = self.path / "parts" / path.parent.name / f"{phase}-{hash_}.parquet"
                files.make_folder(part.parent)
                files.give_name(files.Prepared(path, hash_), part)
                stays.remove(path)
        if stays != known or listing is None:
            self._list(stays)
        for path in there - known:
            files.remove(path)
        for path in self._parts("*", "*"):  # lost parts are no damage: they are computed again
            if path.is_file() and not self._read(path, []):
                files.remove(path)

    def commit(self, table: str, phase: str, rows: pa.Table) -> None:
        """Commit rows of a phase; a repeated commit changes nothing.

        The file gets its name in one step: before it nothing is committed, and after it all rows
        are.
        """
        self._write(self.path / "parts" / table, phase, rows)

    def publish(self, table: str, phase: str, pieces: Iterable[pa.Table]) -> None:
        """Write all rows of a phase to files of its table, and remove the phase's parts.

        The pieces have all rows of the phase in order, in any sizes. If the process dies meanwhile,
        parts remain, and the next call writes the same files.
        """
        self.publish_together(phase, {table: pieces})

    def publish_frame(self, table: str, phase: str, frame: pd.DataFrame, schema: pa.Schema) -> None:
        """Publish all rows of a phase as they were read; the schema is that of written rows."""
        own = self.timed(schema.empty_table()).schema
        self.publish(table, phase, [pa.Table.from_pandas(frame, schema=own, preserve_index=False)])

    def publish_together(self, phase: str, pieces: Mapping[str, Iterable[pa.Table]]) -> None:
        """Publish a phase in several tables, by name; a reader sees all of them or none."""
        written, old, parts = set[Path](), set[Path](), list[Path]()
        for table, stream in pieces.items():
            folder, length = self.path / "tables" / table, ROWS_IN_A_FILE.get(table, _MANY)
            for number, rows in enumerate(cut_rows(stream, length)):
                written.add(self._write(folder, f"{phase}-{number:05d}", rows.combine_chunks()))
            former = self._published(table) | self._listed(table)
            old |= {path for path in former if path.name.startswith(f"{phase}-")}
            parts += self._parts(table, phase)
        if self._unlisted is None:
            self._replace([(written, old, parts)])
        else:
            self._unlisted.append((written, old, parts))

    @contextlib.contextmanager
    def together(self) -> Iterator[None]:
        """A context in which tables are published together: they are listed once, at its end.

        After an error in it none is listed, so their parts stay, and the next start publishes them.
        """
        self._unlisted = unlisted = list[_Change]()
        try:
            yield
        finally:
            self._unlisted = None
        if unlisted:
            self._replace(unlisted)

    def _replace(self, changes: Iterable[_Change]) -> None:
        """List files that were written, no longer list old ones, and remove these, then parts."""
        # The list comes after all files and before the first part goes: at any instant every row is
        # in a part or in a file that is listed. Parts go last: they show that this was cut short.
        listed = self._listed()
        for written, old, _ in changes:
            listed = listed - old | written
        self._list(listed)
        gone = [path for written, old, parts in changes for path in (*(old - written), *parts)]
        for path in gone:
            files.remove(path)
        holders = self._holders or {}
        for id_ in holders:
            holders[id_] -= holders[id_].intersection(gone)  # of all parts, few are holders

    def _write(self, folder: Path, start: str, rows: pa.Table) -> Path:
        """Write rows, in the form in which files hold them, to a file whose name begins so."""
        own = signed(self.timed(rows), self._run_key)
        prepared = prepare_table(folder, own)
        path = folder / f"{start}-{prepared.sha256[:HASH_DIGITS]}.parquet"
        name_table(prepared, path, own, self._run_key)  # one with this name has the same content
        if folder.name == "draws":
            self._note_holder(path, rows)
        return path

    def settle(self, table: str, phase: str) -> None:
        """Publish all committed rows of a phase, sorted by key, if it has parts.

        Sums of single draws go: those of their blocks are there, or the search needs them no more.
        """
        if self.has_parts(table, phase):
            whole = pc.field("block") >= 0 if table == "error_sums" else None
            pieces = self._load(table, phase, filters=whole)
            self.publish(table, phase, [unique(pieces, keys_of(table, pieces[0].column_names))])

    def renew(self, table: str, phase: str, rows: pa.Table) -> None:
        """Publish rows in addition to those of a phase; they replace rows with the same keys."""
        pieces = [self.timed(rows), *self._load(table, phase)]  # the first row of a key stays
        self.publish(table, phase, [unique(pieces, keys_of(table, rows.column_names))])

    def read(self, table: str, draws: int | None = None, phase: str = "") -> pd.DataFrame:
        """A table as `rows` gives it, as a DataFrame."""
        return frame_of(self.rows(table, draws, phase))

    def rows(self, table: str, draws: int | None = None, phase: str = "") -> pa.Table:
        """A table, parts and published files as one, sorted by key.

        It may be limited to the first draws, or to the rows of a phase.
        """
        condition = None if draws is None else pc.field("draw") < draws
        pieces = self._load(table, phase, filters=condition)
        if not pieces:
            raise StoreError(
                f"the run {self.path} has no table {table!r} yet, or its parts are damaged: run "
                "the same command again"
            )
        return unique(pieces, keys_of(table, pieces[0].column_names))

    def compared(self) -> pd.DataFrame:
        """The table of the compared sets, with checked names.

        Names of columns and files contain these names. Raises `StoreError` if a name is not allowed
        in a job.
        """
        rows = self.read("compared")
        check_names(rows["name"], self.path / "tables" / "compared")
        return rows

    def compared_sets(self) -> dict[str, tuple[int, ...]]:
        """The compared sets by name, the reference first, with their times."""
        rows = self.compared()
        times = [tuple(each.tolist()) for each in rows["measurement_times"]]
        return dict(zip(map(str, rows["name"]), times, strict=True))

    @property
    def tables(self) -> set[str]:
        """Names of the tables with committed rows."""
        parts = self._parts("*", "*")  # first, see `_files`
        return {path.parent.name for path in (*parts, *self._listed())}

    def has(self, table: str, phase: str = "") -> bool:
        """Whether a table, or a phase in it, has committed rows."""
        return bool(self._files(table, phase))

    def has_parts(self, table: str = "*", phase: str = "*", without: tuple[str, ...] = ()) -> bool:
        """Whether a phase, or the run without some phases, has unpublished rows."""
        parts = self._parts(table, phase)
        return any(not path.name.startswith(without) for path in parts)

    def check_published(self) -> None:
        """Read every published file; raises a `StoreError` that names the first damaged one."""
        for fault in self.damages():
            raise StoreError(fault)

    def damages(self) -> Iterator[str]:
        """The faults of published files, one line each; every byte is read."""
        for path in sorted(self._listed()):
            try:
                self._read(path, [])
            except FileNotFoundError:
                yield f"{path} is missing: run the same command again to compute its rows"
            except StoreError as error:
                yield str(error)

    def strangers(self) -> Iterator[Path]:
        """The files among the published ones that are not listed and that no kill can have left."""
        listed, parts = self._listed(), self._parts("*", "*")
        begun = {(part.parent.name, part.name.partition("-")[0]) for part in parts}
        for path in sorted((self.path / "tables").glob("*/[!.]*")):
            is_left = (path.parent.name, path.name.partition("-")[0]) in begun
            if path not in listed and not is_left and not path.name.startswith(QUESTIONS):
                yield path

    def phases_of(self, table: str, start: str) -> list[str]:
        """Phases with parts of a table whose names begin like this, without a hyphen."""
        parts = (self.path / "parts" / table).glob(f"{start}*.parquet")
        return sorted({path.name.partition("-")[0] for path in parts})

    def blocks(self, table: str, draws: int, last: int | None = None) -> Iterator[pa.Table]:
        """Yield the rows of the draws 0..last-1, or of all draws, in blocks of so many draws.

        The rows of a block are sorted and unique; empty blocks are skipped. Only the files that
        overlap a block are read, so memory does not grow with the table.
        """
        places = self._places(table, draws)

        def look(number: int) -> pa.Table:
            nonlocal places
            first, end = number * draws, (number + 1) * draws
            end, draw = end if last is None else min(end, last), pc.field("draw")
            try:
                paths = [path for path in places if number in places[path]]
                return self._by_draw(paths, (draw >= first) & (draw < end))
            except FileNotFoundError:
                places = self._places(table, draws)
                raise

        for number in sorted(set[int]().union(*(numbers.tolist() for numbers in places.values()))):
            if last is None or number * draws < last:
                yield self._again(partial(look, number))

    def pieces(self, table: str, columns: list[str]) -> Iterator[pa.Table]:
        """Yield some columns of a table, a file at a time; rows may come twice."""
        for path in self._files(table):
            yield from self._read(path, columns)

    def draws(self, table: str) -> list[range]:
        """The draws with rows in a table, alone or in ranges, as ascending disjoint ranges.

        Usually this is one range, so memory does not grow with the number of draws.
        """

        def look() -> list[range]:
            columns = [name for name in KEYS[table] if name in ("draw", "draws")]
            pieces = (
                [piece[name].to_numpy() for name in columns]
                for piece in self.pieces(table, columns)
            )
            return _merged(each for piece in pieces for each in _ranges(*piece))

        return self._again(look)

    def per_draw(self, evaluations: Sequence[str]) -> pa.Table:
        """Rows of the table ``draws`` of these evaluations, in order and by draw, each once."""
        ids = list(evaluations)
        condition = pc.field("evaluation").isin(ids)

        def look() -> list[pa.Table]:
            paths = sorted(
                set[Path]().union(*(self._files_by_evaluation().get(id_, ()) for id_ in ids))
            )
            return [piece for path in paths for piece in self._read(path, filters=condition)]

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
        """Rows of the table ``error_sums`` of one evaluation, for its first blocks, in order."""
        condition = (pc.field("evaluation") == evaluation) & (pc.field("block") < blocks)
        pieces = [schema("error_sums").empty_table(), *self._load("error_sums", filters=condition)]
        return unique(pieces, KEYS["error_sums"])

    def _parts(self, table: str, phase: str) -> list[Path]:
        start = "" if phase == "*" else f"{phase}-"
        return sorted(_files_in(self.path / "parts", table, start))

    def _published(self, table: str = "*") -> set[Path]:
        """Files with names of published files, whether they are listed or not."""
        found = _files_in(self.path / "tables", table)
        return {path for path in found if path.name.count("-") > 1}

    def _listed(self, table: str = "") -> set[Path]:
        """Published files of a table, or of all, as files.json lists them."""
        listing, start = read_listing(self.path), f"tables/{table}/" if table else ""
        names = () if listing is None else listing.files
        return {self.path / name for name in names if name.startswith(start)}

    def _list(self, paths: Iterable[Path]) -> None:
        names = sorted(path.relative_to(self.path).as_posix() for path in paths)
        change_listing(self.path, self._run_key, files=tuple(names))

    def _files(self, table: str, phase: str = "") -> list[Path]:
        # Parts are listed first: a row that is published meanwhile is read twice, never missed.
        parts = self._parts(table, phase or "*")
        listed, start = self._listed(table), f"{phase}-" if phase else ""
        return [*sorted(path for path in listed if path.name.startswith(start)), *parts]

    def _load(
        self, table: str, phase: str = "", filters: pc.Expression | None = None
    ) -> list[pa.Table]:
        """Contents of all files of a table, or of those of one phase."""
        return self._again(
            lambda: [
                piece
                for path in self._files(table, phase)
                for piece in self._read(path, filters=filters)
            ]
        )

    def _places(self, table: str, draws: int) -> dict[Path, NDArray[np.int64]]:
        """For each file of a table, the blocks of so many draws that it reaches."""

        def look() -> dict[Path, NDArray[np.int64]]:
            return {
                path: np.unique(piece["draw"].to_numpy() // draws)
                for path in self._files(table)
                for piece in self._read(path, ["draw"])
            }

        return self._again(look)

    def _again(self, look: Callable[[], _Value]) -> _Value:
        """The value of a function that reads files; it starts again if a file was published."""
        for _ in range(_ATTEMPTS):
            try:
                return look()
            except FileNotFoundError as error:
                path = Path(str(error.filename))
                if path in self._listed():
                    raise StoreError(
                        f"{path} is missing: run the same command again to compute its rows"
                    ) from error
                self._holders = None
                time.sleep(_PAUSE_SECONDS)
        raise StoreError(f"the run {self.path} changes faster than it can be read: try again")

    def _by_draw(self, paths: Iterable[Path], filters: pc.Expression) -> pa.Table:
        """Some rows of files, sorted by draw, each once."""
        pieces = [piece for path in paths for piece in self._read(path, filters=filters)]
        rows = pa.concat_tables(pieces).sort_by("draw")
        return rows.filter(pa.array(first_occurrences(rows["draw"].to_numpy())))

    def _read(
        self, path: Path, columns: list[str] | None = None, filters: pc.Expression | None = None
    ) -> list[pa.Table]:
        """Rows of a file in a list, which is empty for a part with another hash than its name's."""
        rows = read_file(path, self._run_key, columns, filters)
        if rows is None and path.parent.parent.name == "tables":
            raise StoreError(f"{path} is damaged: its name has another hash; {REMEDY}")
        return [] if rows is None else [rows]

    def _files_by_evaluation(self) -> dict[str, set[Path]]:
        """Files of the draws table by evaluation, which are read when they are first needed."""
        if self._holders is None:
            self._holders = defaultdict(set)
            for path in self._files("draws"):
                for rows in self._read(path, ["evaluation"]):
                    self._note_holder(path, rows)
        return self._holders

    def _note_holder(self, path: Path, rows: pa.Table) -> None:
        """Note which evaluations a file of the draws table holds."""
        if self._holders is not None:
            for id_ in rows["evaluation"].unique().to_pylist():
                self._holders[id_].add(path)


def _files_in(folder: Path, table: str, start: str = "") -> Iterator[Path]:
    """Files of a table, or of all (``*``), by their names; other files belong to the user."""
    for name in _names_in(folder) if table == "*" else [table]:
        for file in _names_in(folder / name) if name in KEYS else ():
            if file.startswith(start) and NAME.fullmatch(file):
                yield folder / name / file


def _names_in(folder: Path) -> list[str]:
    with contextlib.suppress(OSError):
        return os.listdir(folder)
    return []


def _ranges(values: NDArray[np.int64], lengths: NDArray[np.int64] | None = None) -> Iterator[range]:
    """The values of an array as ranges; with lengths, each value begins a range."""
    if lengths is not None:
        yield from map(range, values.tolist(), (values + lengths).tolist())
        return
    values = np.sort(values)
    ends = np.flatnonzero(np.diff(values) > 1)
    if values.size:
        firsts, lasts = values[[0, *(ends + 1)]], values[[*ends, -1]]
        yield from map(range, firsts.tolist(), (lasts + 1).tolist())


def _merged(ranges: Iterable[range]) -> list[range]:
    """Ranges in ascending order; those that touch or overlap are one."""
    merged = list[range]()
    for each in sorted(ranges, key=lambda each: each.start):
        if merged and each.start <= merged[-1].stop:
            merged[-1] = range(merged[-1].start, max(merged[-1].stop, each.stop))
        else:
            merged.append(each)
    return merged
