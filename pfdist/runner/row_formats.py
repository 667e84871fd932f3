"""Formats in which results become rows of a table, and rows become results again.

Each class is a `pfdist.runner.door.RowFormat`. A shared format names all rows by an id of
everything on which they depend, so runs may use each other's rows. The same work gives the same
rows with the same key. So rows that are committed twice, by two drivers or after a kill, count
once.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import compress

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pfdist.filters.work import BLOCK as SUMMED
from pfdist.filters.work import FilterWork, Result, cut, whole_block
from pfdist.results import BLOCK
from pfdist.runner.door import StoredResults
from pfdist.store import Store, schema


class PerDraw:
    """Rows of the table ``draws``: the MSE of each draw, by the id of the evaluation."""

    table, is_shared = "draws", True

    def look_up(
        self, store: Store, works: list[FilterWork]
    ) -> tuple[list[FilterWork], StoredResults]:
        """The works that a store lacks, and the results that it has.

        A kill may leave only some draws of some sets. Sets that lack the same draws stay together
        in one work, so common prefixes are still filtered once.
        """
        ids = list(dict.fromkeys(id_ for work in works for id_ in work.ids))
        rows = store.per_draw(ids)
        if not rows.num_rows:
            return works, iter(())
        known = {
            str(id_): [rows_of_id[name].to_numpy() for name in ("draw", "mse", "degenerate")]
            for id_, rows_of_id in rows.to_pandas().groupby("evaluation")
        }
        lacking, stored = list[FilterWork](), list[tuple[FilterWork, Result]]()
        for work in works:
            first, last = work.draws
            present = np.zeros((last - first, len(work.ids)), np.bool_)
            mse, degenerate = np.full(present.shape, np.nan), np.zeros_like(present)
            for place, id_ in enumerate(work.ids):
                draws, values, flags = known.get(id_, np.empty((3, 0), np.int64))
                within = (first <= draws) & (draws < last)
                rows_here = draws[within] - first
                present[rows_here, place] = True
                mse[rows_here, place], degenerate[rows_here, place] = values[within], flags[within]
            for mask, places in _alike(present):
                for piece in cut(first + np.flatnonzero(~mask), last):
                    lacking.append(work.piece(piece, places))
                for piece in cut(first + np.flatnonzero(mask), last):
                    at = slice(piece[0] - first, piece[1] - first), places
                    result = Result(mse[at], degenerate=degenerate[at])
                    stored.append((work.piece(piece, places), result))
        return lacking, iter(stored)

    def rows(self, work: FilterWork, result: Result) -> pa.Table:
        """Rows of the table ``draws``: the MSE of every set of a work for every draw."""
        evaluation = np.repeat(np.arange(len(work.ids)), len(result.mse))
        columns = [
            pa.array(work.ids, pa.string()).take(evaluation),
            pa.array(np.tile(np.arange(*work.draws), len(work.ids))),
            pa.array(result.mse.T.ravel(), from_pandas=True),
            pa.array(result.degenerate.T.ravel()),
        ]
        return pa.Table.from_arrays(columns, schema=schema(self.table))


class BlockOfSums:
    """Rows of the table ``error_sums``: the summed errors of sets over whole blocks of draws.

    There are too many windows to store the errors of each draw. If a model is slow, those of the
    draws of unfinished blocks are stored: draw d has the number -1 - d, and goes when the table is
    published.
    """

    table, is_shared = "error_sums", True

    def look_up(
        self, store: Store, works: list[FilterWork]
    ) -> tuple[list[FilterWork], StoredResults]:
        """The draws that a store lacks, and the sums that it has; each work is within one block."""
        blocks = 1 + max(_block(work) for work in works)
        sums = dict[tuple[str, int], NDArray[np.float64]]()
        for id_ in dict.fromkeys(work.ids[0] for work in works):
            rows = store.sums(id_, blocks)
            for block, values in zip(rows["block"].to_pylist(), rows["sums"], strict=True):
                sums[id_, block] = values.values.to_numpy()
        lacking, stored = list[FilterWork](), list[FilterWork]()
        for work in works:
            whole = work.piece(whole_block(work.draws[0]))
            if _key(whole) in sums:
                stored.append(whole)
                continue
            singles = [work.piece((draw, draw + 1)) for draw in range(*work.draws)]
            there = [_key(single) in sums for single in singles]
            stored += compress(singles, there)
            missing = np.flatnonzero(np.logical_not(there)) + work.draws[0]
            lacking += [work.piece(piece) for piece in cut(missing, SUMMED)]
        return lacking, ((work, Result(np.empty(0), sums=sums[_key(work)])) for work in stored)

    def rows(self, work: FilterWork, result: Result) -> pa.Table:
        """One row of the table ``error_sums``: the sums of a block, or of one draw."""
        sums = pa.ListArray.from_arrays([0, result.sums.size], result.sums)
        columns = [*([each] for each in _key(work)), sums]
        return pa.Table.from_arrays([*map(pa.array, columns)], schema=schema(self.table))


@dataclass(eq=False)
class RowsByDraw:
    """Rows of a table of one run, identified by the number of the draw.

    `rows` makes the rows of a work and its result. `results` makes a result of rows, for drivers
    that need the results that the store has; other drivers only need that these rows are there.
    Draws that a table `beside` lacks are computed again.
    """

    table: str
    rows: Callable[[FilterWork, Result], pa.Table]
    results: Callable[[pa.Table], Result] | None = None
    is_shared: bool = False
    beside: tuple[str, ...] = ()

    def look_up(
        self, store: Store, works: list[FilterWork]
    ) -> tuple[list[FilterWork], StoredResults]:
        """The works that a store lacks, and the results that it has.

        Works need not be cut as before. So a comparison with more draws than before continues where
        it ended.
        """
        most = max((work.draws[1] for work in works), default=0)
        present = np.ones(most, np.bool_)
        for table in (self.table, *self.beside):
            there = np.zeros(most, np.bool_)
            for committed in store.draws(table):
                there[committed.start : committed.stop] = True
            present &= there
        lacking = list[FilterWork]()
        for work in works:
            first, last = work.draws
            pieces = cut(first + np.flatnonzero(~present[first:last]), last)
            lacking += [work.piece(piece) for piece in pieces]
        return lacking, self._stored_results(store, works, present)

    def _stored_results(
        self, store: Store, works: list[FilterWork], present: NDArray[np.bool_]
    ) -> StoredResults:
        if self.results is None or not works:
            return
        # Read block by block when the driver learns, so memory does not grow with the table.
        for rows in store.blocks(self.table, BLOCK, present.size):
            draws = rows["draw"].to_numpy()
            for first, last in cut(draws[present[draws]], BLOCK):
                place = int(np.searchsorted(draws, first))
                result = self.results(rows.slice(place, last - first))
                yield works[0].piece((first, last)), result


PER_DRAW, BLOCK_OF_SUMS = PerDraw(), BlockOfSums()


def _block(work: FilterWork) -> int:
    return work.draws[0] // SUMMED


def _key(work: FilterWork) -> tuple[str, int]:
    return work.ids[0], -1 - work.draws[0] if work.is_part_of_block else _block(work)


def _alike(present: NDArray[np.bool_]) -> Iterator[tuple[NDArray[np.bool_], list[int]]]:
    """Yield each different column, with the places of all columns that equal it."""
    places = dict[bytes, list[int]]()
    for place, column in enumerate(present.T):
        places.setdefault(column.tobytes(), []).append(place)
    for alike in places.values():
        yield present[:, alike[0]], alike
