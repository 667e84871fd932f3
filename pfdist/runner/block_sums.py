"""Sums of the errors of sets over blocks of draws.

There are too many windows to store the errors of each draw. A task adds up the errors of one block
of draws, and the driver adds the blocks in their order. So any number of workers gives the same
bytes, and a later start goes on with the blocks that are committed.
"""

from collections.abc import Generator, Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pfdist.evaluation.work import BLOCK, Estimation, Result, Work
from pfdist.runner.build import Built
from pfdist.runner.claims import Wanted
from pfdist.runner.collect import Collector
from pfdist.store import BOUND_PHASE, Store, schema
from pfdist.times.measurement_times import Times

GROUPS = 20
"""Groups of blocks; the jackknife leaves one group out. Block b belongs to group b modulo 20."""
_TABLE = "error_sums"

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Counted:
    """Sets of times, and the instants at which the errors of each count.

    Parameters
    ----------
    sets : tuple of tuples of int, (S,)
    first, ends : array of int, (S,)
        First and last instant of each set.
    """

    sets: tuple[Times, ...]
    first: NDArray[np.int64]
    ends: NDArray[np.int64]

    def at(self, horizon: int) -> NDArray[np.bool_]:
        """Give whether the error of each set counts at each instant, (S, T+1)."""
        t = np.arange(horizon + 1)
        return (self.first[:, None] <= t) & (t <= self.ends[:, None])


class BlockSums:
    """The sums of the errors of sets over blocks of draws, at the instants that count.

    Parameters
    ----------
    built : Built
    counted : Counted
    streams : (int, int)
        Keys of the filters' noise and of the draws.
    estimation : Estimation
    knows_truth : bool
        Whether the filter uses the true model.
    phase : str
        Phase of the sums in the store; by default a phase of the bound for these sums alone.

    Attributes
    ----------
    id : str
        Id of the sums in the store.
    """

    def __init__(
        self,
        built: Built,
        counted: Counted,
        streams: tuple[int, int],
        estimation: Estimation,
        *,
        knows_truth: bool = True,
        phase: str = "",
    ) -> None:
        sets = counted.sets
        since, ends = tuple(counted.first.tolist()), tuple(counted.ends.tolist())
        noise, draws = streams
        source = built.source.truth if knows_truth else built.source
        self.id = source.sums_id(sets, tuple(zip(since, ends, strict=True)), noise, estimation)
        self._phase = phase or f"{BOUND_PHASE}.{self.id}"
        self._mask = counted.at(built.evaluator.horizon)
        self._work = Work(
            measurement_times=sets,
            ends=ends,
            filter_streams=(noise,) * len(sets),
            draws_stream=draws,
            draws=(0, 0),
            estimation=estimation,
            ids=(self.id,),
            since=since,
            knows_truth=knows_truth,
        )

    def steps(self, blocks: int) -> int:
        """Particle-steps of the first blocks."""
        return blocks * BLOCK * self._work.steps_a_draw

    def known(self, blocks: int, store: Store) -> Iterator[tuple[int, Array]]:
        """Yield those of the first blocks that the store has, with their sums, in their order.

        Raises
        ------
        StoreError
            A file cannot be read.
        """
        rows = store.sums(self.id, blocks)
        for block, sums in zip(rows["block"].to_pylist(), rows["sums"], strict=True):
            yield block, sums.values.to_numpy()

    def fill(
        self, blocks: int, collector: Collector, known: set[int], *, more_follows: bool = False
    ) -> Generator[tuple[int, Array]]:
        """Filter those of the first blocks of draws that are not known, and yield their sums.

        Raises
        ------
        TaskError, PoolError, StoreError
            A task failed, no worker answers, or a file cannot be read or written.
        """
        works = (
            replace(self._work, draws=(block * BLOCK, (block + 1) * BLOCK))
            for block in range(blocks)
            if block not in known
        )
        run = collector.run(self._phase, _TABLE, works, self._rows, more_follows=more_follows)
        with closing(run) as pieces:
            for work, result in pieces:
                yield work.draws[0] // BLOCK, result.sums

    def by_group(self, blocks: int, store: Store) -> tuple[Array, Array]:
        """Sums and numbers of draws of each group, (G, E) and (G,), of the first blocks.

        Raises
        ------
        StoreError
            A file cannot be read.
        """
        sums, draws = np.zeros((GROUPS, int(self._mask.sum()))), np.zeros(GROUPS)
        for block, errors in self.known(blocks, store):
            sums[block % GROUPS] += errors
            draws[block % GROUPS] += BLOCK
        return sums, draws

    def means(self, blocks: int, collector: Collector) -> Array:
        """Mean errors of each set at each instant, (S, T+1), over the first blocks.

        They are 0 where no error counts. The blocks in which a set has a degenerate draw are left
        out. A set has NaN if all blocks are.

        Raises
        ------
        TaskError, PoolError, StoreError
            A task failed, no worker answers, or a file cannot be read or written.
        """
        found = dict(self.known(blocks, collector.store)) if collector.resumed else {}
        shared = Wanted(self.id, self.id, blocks)
        if collector.claims.claim([shared]):
            collector.flush()  # others may wait for what is claimed here
            store = collector.claims.stores_of([shared])[shared]
            self._take(blocks, store, found, collector)
        found.update(self.fill(blocks, collector, set(found), more_follows=True))
        collector.later(partial(collector.claims.settle, [shared]))
        sums, usable = np.zeros(self._mask.shape), np.zeros(len(self._mask))
        for _, errors in sorted(found.items()):
            spread = np.zeros(self._mask.shape)
            spread[self._mask] = errors
            finite = np.isfinite(spread).all(axis=1)
            sums[finite] += spread[finite]
            usable += finite
        with np.errstate(invalid="ignore"):
            means: Array = np.where(usable > 0, sums.T / (BLOCK * usable), np.nan).T
        return means

    def _take(
        self, blocks: int, store: Store, found: dict[int, Array], collector: Collector
    ) -> None:
        """Take the sums that another run has computed, and commit them here, too."""
        for block, sums in self.known(blocks, store):
            if block not in found:
                found[block] = sums
                rows = self._row(block, sums)
                collector.keep(self._phase, _TABLE, f"{self.id}-{block}", rows)

    def _rows(self, work: Work, result: Result) -> pa.Table:
        return self._row(work.draws[0] // BLOCK, result.sums)

    def _row(self, block: int, sums: Array) -> pa.Table:
        row = {"evaluation": self.id, "block": block, "sums": sums}
        return pa.Table.from_pylist([row], schema=schema(_TABLE))
