"""Sums of the errors of sets over blocks of draws, for searches and proofs by windows.

There are too many windows to store the errors of each draw. A task adds up the errors of one block
of draws, and the driver adds the blocks in their order. So any number of workers gives the same
bytes.

The windows of a proof are grown on draws of their own, along the sets that are best in them. If the
same draws chose the windows and gave the bound, the bound could lie above the truth: windows would
be preferred that happen to have large errors.
"""

from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pfdist.bounds.relaxation import Relaxation
from pfdist.common.streams import stream_of
from pfdist.evaluation.estimate import Evaluation
from pfdist.evaluation.work import BLOCK, Estimation, Result, Work
from pfdist.runner.build import Built
from pfdist.runner.door import Batch, Learn, Session
from pfdist.runner.kept import BLOCK_OF_SUMS
from pfdist.search.base import Candidate
from pfdist.search.state_space_relaxation import StateSpaceRelaxation
from pfdist.store import BOUND_PHASE, Store
from pfdist.times.measurement_times import Times

GROUPS = 20
"""Groups of blocks; the jackknife leaves one group out. Block b belongs to group b modulo 20."""

CHOICE_BLOCKS = GROUPS
"""Blocks of draws that choose windows."""

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
        evaluator = built.evaluator.truth if knows_truth else built.evaluator
        self.id = evaluator.sums_id(sets, tuple(zip(since, ends, strict=True)), noise, estimation)
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

    def batch(self, session: Session, blocks: range, learn: Learn, *, more_follows: bool) -> Batch:
        """A batch of the sums of some blocks."""
        works = [
            replace(self._work, draws=(block * BLOCK, (block + 1) * BLOCK)) for block in blocks
        ]
        return Batch(session, self._phase, works, BLOCK_OF_SUMS, learn, more_follows=more_follows)

    def by_group(self, blocks: int, store: Store) -> tuple[Array, Array]:
        """Sums and numbers of draws of each group, (G, E) and (G,), of the first blocks.

        Raises
        ------
        StoreError
            A file cannot be read.
        """
        sums, draws = np.zeros((GROUPS, int(self._mask.sum()))), np.zeros(GROUPS)
        rows = store.sums(self.id, blocks)
        for block, errors in zip(rows["block"].to_pylist(), rows["sums"], strict=True):
            sums[block % GROUPS] += errors.values.to_numpy()
            draws[block % GROUPS] += BLOCK
        return sums, draws

    def means(self, blocks: int, session: Session) -> Generator[Batch, None, Array]:
        """Mean errors of each set at each instant, (S, T+1), over the first blocks.

        They are 0 where no error counts. The blocks in which a set has a degenerate draw are left
        out. A set has NaN if all blocks are.

        Raises
        ------
        TaskError, PoolError, StoreError
            A task failed, no worker answers, or a file cannot be read or written.
        """
        found: dict[int, Array] = {}

        def learn(work: Work, result: Result) -> None:
            found[work.draws[0] // BLOCK] = result.sums

        yield self.batch(session, range(blocks), learn, more_follows=True)
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


def evaluated_by_errors(
    asked: Sequence[Candidate],
    session: Session,
    sums_of: Callable[[Counted], BlockSums],
    blocks: int,
    purpose: str,
) -> Generator[Batch, None, tuple[list[Evaluation], float]]:
    """Evaluations of candidates, and the particle-steps that they take.

    Errors are 0 before the instant from which they are wanted, and behind the candidate's end.

    Parameters
    ----------
    asked : sequence of Candidate
    session : Session
    sums_of : callable
        Gives the sums over blocks of draws; exact engines need none.
    blocks : int
        Number of blocks of draws.
    purpose : str
        Purpose of the draws.

    Raises
    ------
    TaskError, PoolError, StoreError
        A task failed, no worker answers, or a file cannot be read or written.
    """
    evaluator = session.built.evaluator
    exact, horizon, steps = evaluator.exact, evaluator.horizon, 0.0
    sets = tuple(candidate.measurement_times for candidate in asked)
    first = np.array([candidate.since or 0 for candidate in asked])
    ends = np.array([horizon if each.end is None else each.end for each in asked])
    counted = Counted(sets, first, ends)
    if exact:
        errors = np.where(counted.at(horizon), evaluator.expected_errors(sets), 0.0)
    else:
        sums = sums_of(counted)
        errors, steps = (yield from sums.means(blocks, session)), sums.steps(blocks)
    costs = errors.sum(axis=1) / (horizon + 1)
    evaluations = [
        Evaluation(
            candidate.measurement_times,
            cost[None],
            exact=float(cost) if exact else None,
            end=candidate.end,
            errors=row,
            purpose=purpose,
        )
        for candidate, row, cost in zip(asked, errors, costs, strict=True)
    ]
    return evaluations, steps


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
