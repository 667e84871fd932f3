"""The windows of a proof: grown on draws of their own, along the sets that are best in them.

The bound then has fresh draws. If the same draws chose the windows and gave the bound, the bound
could lie above the truth: windows would be preferred that happen to have large errors.
"""

from collections.abc import Generator

import numpy as np

from pfdist.bounds.relaxation import Relaxation
from pfdist.common.streams import stream_of
from pfdist.evaluation.work import Estimation
from pfdist.runner.block_sums import GROUPS, BlockSums, Counted
from pfdist.runner.door import Batch, Session
from pfdist.runner.window_errors import evaluated_by_errors
from pfdist.search.state_space_relaxation import StateSpaceRelaxation

CHOICE_BLOCKS = GROUPS
"""Blocks of draws that choose windows."""


def grown(
    session: Session,
    optimiser: StateSpaceRelaxation,
    estimation: Estimation,
    most_steps: float,
    most_cells: int,
) -> Generator[Batch, None, tuple[Relaxation, float]]:
    """The relaxation that a search for windows ends with, and the particle-steps that it took.

    Parameters
    ----------
    session : Session
    optimiser : StateSpaceRelaxation
    estimation : Estimation
        An estimation by the variance of the particles.
    most_steps : float
        Particle-steps after which no window is added.
    most_cells : int
        Largest number of errors of a relaxation.

    Raises
    ------
    TaskError, PoolError, StoreError
        A task failed, no worker answers, or a file cannot be read or written.
    """
    built, reporter = session.built, session.reporter
    stream = stream_of("bound", built.job.seed, "windows")

    def sums_of(counted: Counted) -> BlockSums:
        return BlockSums(built, counted, (stream, stream), estimation)

    state, steps, rng = optimiser.init(), 0.0, np.random.default_rng(0)
    if not built.evaluator.exact:  # which takes no particle-steps
        reporter.begin("windows of the bound")
    start = reporter.progress.done
    relaxation = state.relaxation
    while not optimiser.done(state):
        asked = optimiser.ask(state, rng)
        evaluations, work = yield from evaluated_by_errors(
            asked, session, sums_of, CHOICE_BLOCKS, "bound"
        )
        steps += work
        if work:
            reporter.reach(start + steps)
        state = optimiser.tell(state, evaluations)
        if state.relaxation.offsets[-1] > most_cells:
            break
        relaxation = state.relaxation
        if steps >= most_steps:
            break
    return relaxation, steps
