"""Sums of the errors of a relaxed filter over blocks of draws.

There are too many states to store the errors of each draw. A task adds up the errors of one block
of draws, and the driver adds the blocks in their order. So any number of workers gives the same
bytes, and a later start goes on with the blocks that are committed.
"""

from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pfdist.bounds.relaxation import Relaxation
from pfdist.errors import ModelError
from pfdist.evaluation.estimate import BOUND
from pfdist.evaluation.work import Estimation, Result, Work
from pfdist.runner.build import Built
from pfdist.runner.session import Session
from pfdist.store import BOUND_PHASE, schema
from pfdist.times.measurement_times import Times

BLOCK = 24
"""Draws of a block. One task adds up a whole block, so results do not depend on the workers."""
GROUPS = 20
"""Groups of blocks; the jackknife leaves one group out. Block b belongs to group b modulo 20."""
_TABLE = "bound_sums"

Array = NDArray[np.float64]


class BlockSums:
    """The sums of the errors of all states of a relaxation, and of some sets, by the true model.

    Parameters
    ----------
    built : Built
    relaxation : Relaxation
    sets : sequence of tuples of int, (C,)
        Known sets, filtered on the same draws.
    estimation : Estimation
    groups : int
        Only the draws of the first groups are filtered.
    """

    def __init__(
        self,
        built: Built,
        relaxation: Relaxation,
        sets: Sequence[Times],
        estimation: Estimation,
        groups: int = GROUPS,
    ) -> None:
        self._groups, self._reported = groups, 0
        horizon, seed = built.problem.horizon, built.job.seed
        states = relaxation.states
        # Before the last measurement of a state, and after its end, no error of it counts.
        first = np.array([max(0, state.last) for state in states] + [0] * len(sets))
        last = np.array([*relaxation.ends, *(horizon,) * len(sets)])
        instants = np.arange(horizon + 1)
        self._counts = (first[:, None] <= instants) & (instants <= last[:, None])
        every, streams = (*relaxation.sets, *sets), ("filter", "draws")
        noise, draws = (BOUND.stream(seed, role) for role in streams)
        self._work = Work(
            measurement_times=every,
            ends=tuple(last.tolist()),
            filter_streams=(noise,) * len(every),
            draws_stream=draws,
            draws=(0, 0),
            estimation=estimation,
            ids=(built.source.truth.sums_id(every, last.tolist(), noise, estimation),),
            summed=True,
            knows_truth=True,
        )

    @property
    def phase(self) -> str:
        """Phase of the sums in the store."""
        (id_,) = self._work.ids
        return f"{BOUND_PHASE}.{id_}"

    def steps(self, blocks: int) -> int:
        """Particle-steps of the first blocks."""
        return len(self._wanted(blocks)) * BLOCK * self._work.steps_a_draw

    def fill(self, blocks: int, session: Session, title: str) -> None:
        """Filter those of the first blocks of draws that the store lacks.

        Parameters
        ----------
        blocks : int
            At least as many as at the last call.
        session : Session
        title : str
            Name of the work in the progress.

        Raises
        ------
        TaskError, PoolError, StoreError
            A task failed, no worker answers, or a file cannot be read or written.
        """
        wanted, reporter = self._wanted(blocks), session.reporter
        known = set(self._stored(blocks, session)["block"].to_pylist())
        a_block, done = BLOCK * self._work.steps_a_draw, len(known)
        start = reporter.progress.done - self._reported * a_block
        reporter.note(done=start + done * a_block)
        reporter.begin(title, evaluations=done * BLOCK)
        works = (self._block(block) for block in wanted if block not in known)
        with closing(session.collector.run(self.phase, _TABLE, works, self._rows)) as pieces:
            for _ in pieces:
                done += 1
                reporter.reach(start + done * a_block, evaluations=done * BLOCK)
        self._reported = done

    def by_group(self, blocks: int, session: Session) -> tuple[Array, Array]:
        """Sums and numbers of draws of each group, (G, S+C, T+1) and (G,), of the first blocks.

        Raises
        ------
        ModelError
            A draw is degenerate or infinite.
        StoreError
            A file cannot be read.
        """
        rows = self._stored(blocks, session)
        sums = np.zeros((self._groups, *self._counts.shape))
        draws = np.zeros(self._groups)
        for block, values in zip(rows["block"].to_pylist(), rows["sums"], strict=True):
            if not np.isfinite(errors := values.values.to_numpy()).all():
                raise ModelError(
                    f"a draw is degenerate or infinite with {self._work.estimation.particles} "
                    "particles of the true model; more particles may help"
                )
            sums[block % GROUPS, self._counts] += errors
            draws[block % GROUPS] += BLOCK
        return sums, draws

    def _wanted(self, blocks: int) -> list[int]:
        return [block for block in range(blocks) if block % GROUPS < self._groups]

    def _stored(self, blocks: int, session: Session) -> pa.Table:
        """Rows of the store for the blocks that are wanted, in their order."""
        (id_,) = self._work.ids
        rows = session.store.sums(id_, blocks)
        # A guard has the id of a bound of as many particles, which may hold blocks of all groups.
        return rows.filter(pa.array(np.isin(rows["block"].to_numpy(), self._wanted(blocks))))

    def _block(self, block: int) -> Work:
        return replace(self._work, draws=(block * BLOCK, (block + 1) * BLOCK))

    def _rows(self, work: Work, result: Result) -> pa.Table:
        (id_,), (first, _) = work.ids, work.draws
        row = {"evaluation": id_, "block": first // BLOCK, "sums": result.sums[self._counts]}
        return pa.Table.from_pylist([row], schema=schema(_TABLE))
