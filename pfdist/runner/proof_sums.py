"""The sums of errors behind a bound: with the bound's particles, and with more for the guard."""

import math
from contextlib import closing
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.bounds.proof import Sums
from pfdist.bounds.relaxation import Relaxation, Window
from pfdist.errors import ModelError
from pfdist.evaluation.estimate import BOUND
from pfdist.evaluation.work import BLOCK, Estimation
from pfdist.runner.block_sums import GROUPS, BlockSums, Counted
from pfdist.runner.build import Built
from pfdist.runner.session import Session
from pfdist.times.measurement_times import Times

FINER = 4
"""The guard has so many times the particles."""

GUARDED = 10
"""Groups of draws that the guard filters again."""

Array = NDArray[np.float64]


class Estimated(NamedTuple):
    """The sums of the windows that have no degenerate draw.

    Parameters
    ----------
    relaxation : Relaxation
        The relaxation that knows these windows alone.
    coarse, fine : Sums
        Sums of the bound, and those of the guard.
    """

    relaxation: Relaxation
    coarse: Sums
    fine: Sums


class ProofSums:
    """The sums of the errors of all windows of a relaxation, and of known sets.

    Parameters
    ----------
    built : Built
    relaxation : Relaxation
    known : tuple of tuples of int, (C,)
        Sets that are filtered on the same draws.
    estimation : Estimation
        An estimation by the variance of the particles.
    """

    def __init__(
        self,
        built: Built,
        relaxation: Relaxation,
        known: tuple[Times, ...],
        estimation: Estimation,
    ) -> None:
        self._built, self._relaxation, self._known = built, relaxation, known
        self._done = dict[str, int]()  # blocks, by the title of their work
        if built.evaluator.exact:
            return
        every = np.zeros(len(known), np.int64)
        counted = Counted(
            (*relaxation.sets, *known),
            np.concatenate([relaxation.first, every]),
            np.concatenate([relaxation.ends, every + built.evaluator.horizon]),
        )
        noise, draws = (BOUND.stream(built.job.seed, role) for role in ("filter", "draws"))
        finer = replace(estimation, particles=FINER * estimation.particles)
        self._coarse = BlockSums(built, counted, (noise, draws), estimation)
        self._fine = BlockSums(built, counted, (noise, draws), finer, groups=GUARDED)

    def steps(self, blocks: int) -> int:
        """Particle-steps of the first blocks of draws, with those of the guard."""
        if self._built.evaluator.exact:
            return 0
        return self._coarse.steps(blocks) + self._fine.steps(blocks)

    def steps_without_guard(self, blocks: int) -> float:
        """Particle-steps of the first blocks of draws; infinite where the engine is exact."""
        return math.inf if self._built.evaluator.exact else float(self._coarse.steps(blocks))

    def exact(self) -> Sums:
        """Give the exact errors, as the sums of one group of one draw."""
        relaxation, evaluator = self._relaxation, self._built.evaluator
        counted = Counted(tuple(relaxation.sets), relaxation.first, relaxation.ends)
        relaxed = evaluator.expected_errors(counted.sets)[counted.at(evaluator.horizon)]
        return Sums(relaxed[None], evaluator.expected_errors(self._known)[None], np.ones(1))

    def estimated(self, blocks: int, session: Session) -> Estimated:
        """Give the sums of the first blocks of draws, and those of the guard.

        Windows of two measurements or more that have a degenerate draw are left out. The shorter
        windows that take their places have measured more.

        Raises
        ------
        ModelError
            A draw is degenerate with a known set, or with a window that has to be known.
        TaskError, PoolError, StoreError
            A task failed, no worker answers, or a file cannot be read or written.
        """
        self._fill(self._coarse, blocks, session, "lower bound")
        self._fill(self._fine, blocks, session, "guard of the bound")
        relaxation, both = self._relaxation, (self._coarse, self._fine)
        found = [(sums, *sums.by_group(blocks, session.store)) for sums in both]
        bad = set[Window]()
        for sums, errors, _ in found:
            bad |= self._degenerate(errors, sums.particles)
        kept = relaxation.without(bad)
        known = np.array([window in kept.index for window in relaxation.windows])
        cells = np.repeat(known, np.diff(relaxation.offsets))
        return Estimated(kept, *(self._sums(errors, draws, cells) for _, errors, draws in found))

    def _fill(self, sums: BlockSums, blocks: int, session: Session, title: str) -> None:
        """Filter those of the first blocks of draws that the store lacks."""
        reporter = session.reporter
        known = {block for block, _ in sums.known(blocks, session.store)}
        a_block = sums.steps(GROUPS) // len(sums.wanted(GROUPS))
        start = reporter.progress.done - self._done.get(title, 0) * a_block
        done = len(known)
        reporter.note(done=start + done * a_block)
        reporter.begin(title, evaluations=done * BLOCK)
        with closing(sums.fill(blocks, session.collector, known)) as filled:
            for _ in filled:
                done += 1
                reporter.reach(start + done * a_block, evaluations=done * BLOCK)
        self._done[title] = done

    def _degenerate(self, errors: Array, particles: int) -> set[Window]:
        """Give the windows with a degenerate or infinite draw.

        Raises
        ------
        ModelError
            There is such a draw with a known set, or with a window that has to be known.
        """
        relaxation = self._relaxation
        finite = np.isfinite(errors).all(axis=0)
        windows, own = np.split(finite, [relaxation.offsets[-1]])
        of_windows = np.logical_and.reduceat(windows, relaxation.offsets[:-1])
        bad = {relaxation.windows[number] for number in np.flatnonzero(~of_windows)}
        if not own.all() or any(len(window) == 1 for window in bad):
            raise ModelError(
                f"a draw is degenerate or infinite with {particles} particles of the true model; "
                "more particles may help"
            )
        return bad

    def _sums(self, errors: Array, draws: Array, cells: NDArray[np.bool_]) -> Sums:
        """Give the sums of some errors of windows, and of all known sets."""
        relaxed, own = errors[:, : cells.size].compress(cells, axis=1), errors[:, cells.size :]
        return Sums(relaxed, own.reshape(len(own), -1, self._built.evaluator.horizon + 1), draws)
