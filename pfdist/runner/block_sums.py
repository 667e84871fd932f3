"""Sums of the errors of sets over blocks of draws, for searches and proofs by windows.

There are too many windows to store the errors of each draw. A task adds up the errors of one block
of draws, and the driver adds the blocks in order. So the bytes do not depend on the workers.

The windows of a proof grow on separate draws, along the sets that look best. If the same draws
chose the windows and gave the bound, the bound could be too high: windows with accidentally large
errors would be preferred.
"""

from collections import deque
from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from functools import reduce
from operator import add
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.common.streams import stream_of
from pfdist.filters.estimate import Evaluation
from pfdist.filters.exact import exact_by_instant
from pfdist.filters.variants import for_estimation
from pfdist.filters.work import BLOCK, Estimation, FilterWork, Result
from pfdist.runner.build import Built
from pfdist.runner.door import RunSession, WorkBatch
from pfdist.runner.parts import Part
from pfdist.runner.row_formats import BLOCK_OF_SUMS
from pfdist.search import Candidate, Counted
from pfdist.search.relaxation import Relaxation
from pfdist.search.state_space_relaxation import StateSpaceRelaxation
from pfdist.store import BOUND_PHASE

GROUPS = 20
"""Number of groups of blocks."""

CHOICE_BLOCKS = GROUPS
"""Number of blocks of draws that choose windows."""

Array = NDArray[np.float64]
Add = Callable[[int, Array], object]


class BlockSums:
    """The sums of the errors of sets over blocks of draws, at the instants that count.

    The streams are the keys of the filters' noise and of the draws. Without a phase, the rows
    belong to a phase of the bound for these sums only. `id` identifies the sums in the store. A
    `kind` of work other than `FilterWork` computes other sums over the draws of a block. An exact
    engine needs no draws and no particle-steps.
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
        kind: type[FilterWork] = FilterWork,
        part: Part = "proof",
    ) -> None:
        sets = counted.sets
        since, ends = tuple(counted.first.tolist()), tuple(counted.ends.tolist())
        noise, draws = streams
        evaluator = for_estimation(built.evaluator, estimation, knows_truth=knows_truth)
        instants = tuple(zip(since, ends, strict=True))
        # A hash of everything on which the sums depend but their draws.
        name = "sums" if kind is FilterWork else kind.__name__
        self.id = evaluator.id_of(estimation, sets, instants, noise, name)
        self._phase, self._part = phase or f"{BOUND_PHASE}.{self.id}", part
        self._phase_of_all = phase or BOUND_PHASE
        self._evaluator, self._counted = evaluator, counted
        work = evaluator.work(
            sets,
            noise,
            draws,
            (0, 0),
            estimation,
            ends=ends,
            since=since,
            ids=(self.id,),
            knows_truth=knows_truth,
        )
        self._work = kind(**vars(work))

    def steps(self, blocks: int) -> int:
        """Particle-steps of the first blocks of draws."""
        return blocks * BLOCK * self._work.steps_a_draw * self._evaluator.has_particles

    def added(
        self, session: RunSession, blocks: range, add: Add, *, more_follows: bool = False
    ) -> Generator[WorkBatch, None, None]:
        """Sum the errors over some blocks, and add the sum of each, (E,), in the order of blocks.

        Tasks end in any order, and rounding depends on the order of a sum.
        """
        waiting, order = dict[int, Array](), deque(blocks)

        def learn(work: FilterWork, result: Result) -> None:
            waiting[work.draws[0] // BLOCK] = result.sums
            while order and order[0] in waiting:
                add(order[0], waiting.pop(order.popleft()))

        works = [
            replace(self._work, draws=(block * BLOCK, (block + 1) * BLOCK)) for block in blocks
        ]
        yield WorkBatch(
            session, self._phase, works, BLOCK_OF_SUMS, learn, more_follows=more_follows,
            part=self._part,
        )  # fmt: skip

    def total(self, blocks: int, session: RunSession) -> Generator[WorkBatch, None, Array]:
        """The sums over the first blocks, (E,)."""
        sums = list[Array]()
        yield from self.added(session, range(blocks), lambda _block, each: sums.append(each))
        total: Array = np.sum(sums, axis=0)
        return total

    def means(self, blocks: int, session: RunSession) -> Generator[WorkBatch, None, Array]:
        """Mean errors of the sets at the instants that count, (E,), over the first blocks.

        A set with an infinite draw has NaN.
        """
        exact = exact_by_instant(self._evaluator, self._counted.sets, weighted=True)
        if exact is not None:
            session.count_exact(self._phase_of_all, self._part, exact.size)
            return self._counted.of_instants(exact)
        sums = np.zeros(self._counted.set_of.size)

        def add(block: int, errors: Array) -> None:
            sums[:] += errors

        yield from self.added(session, range(blocks), add, more_follows=True)
        return sums / (BLOCK * blocks)


class GroupSums:
    """Sums over groups of blocks; the jackknife leaves one out. Block b is in group b modulo 20."""

    def __init__(self, counted: Counted) -> None:
        self.sums, self.draws = np.zeros((GROUPS, counted.set_of.size)), np.zeros(GROUPS)

    def add(self, block: int, errors: Array) -> None:
        """Add the sums of a block, (E,)."""
        self.sums[block % GROUPS] += errors
        self.draws[block % GROUPS] += BLOCK


def evaluated_by_errors(
    candidates: Sequence[Candidate],
    session: RunSession,
    sums_of: Callable[[Counted], BlockSums],
    blocks: int,
    purpose: str,
) -> Generator[WorkBatch, None, tuple[list[Evaluation], float]]:
    """Evaluations of candidates from expected errors of instants, and the particle-steps spent.

    A candidate with filters comes first; its evaluation has their errors, one filter after another.
    """
    evaluator, others = session.built.evaluator, dict[str, Any]()
    horizon = evaluator.horizon
    whole = [each for each in candidates if each.counted is None]
    ends = np.array([horizon if each.end is None else each.end for each in whole], np.int64)
    of_whole = Counted(tuple(each.measurement_times for each in whole), np.zeros_like(ends), ends)
    filters = [each.counted for each in candidates if each.counted is not None]
    counted = reduce(add, filters + [of_whole] * bool(whole))
    starts = np.cumsum([*(each.set_of.size for each in filters), *(ends + 1)])[:-1]
    sums = sums_of(counted)
    errors = yield from sums.means(blocks, session)
    evaluations = list[Evaluation]()
    for candidate, own in zip(candidates, np.split(errors, starts), strict=True):
        times, mean = candidate.measurement_times, float(own.sum() / (horizon + 1))
        others = {"end": candidate.end, "errors": own, "purpose": purpose}
        evaluations.append(
            Evaluation.exactly(times, mean, **others)
            if evaluator.exact
            else Evaluation(times, np.array([mean]), **others)
        )
    return evaluations, sums.steps(blocks)


def grown(
    session: RunSession,
    optimiser: StateSpaceRelaxation,
    estimation: Estimation,
    most_steps: float,
    most_cells: int,
) -> Generator[WorkBatch, None, tuple[Relaxation, float]]:
    """The final relaxation of a search for windows, and the particle-steps spent.

    The estimation uses the variance of the particles. No window is added after `most_steps`
    particle-steps, and a relaxation has at most `most_cells` errors.
    """
    built, reporter = session.built, session.reporter
    stream = stream_of("bound", built.job.seed, "windows")

    def sums_of(counted: Counted) -> BlockSums:
        return BlockSums(built, counted, (stream, stream), estimation)

    state, steps, rng = optimiser.init(), 0.0, np.random.default_rng(0)
    if built.evaluator.has_particles:
        reporter.begin("proof, step 2 of 3")
    start = reporter.progress.done
    relaxation = state.relaxation
    # Each round first filters the windows that the last round added, then adds windows. Both limits
    # count cells and particle-steps, never seconds, and steps that the store already has count too.
    # So a proof that was killed grows the same windows again, and finds their sums by their ids.
    while not optimiser.done(state):
        candidates = optimiser.ask(state, rng)
        evaluations, work = yield from evaluated_by_errors(
            candidates, session, sums_of, CHOICE_BLOCKS, "bound"
        )
        steps += work
        if work:
            reporter.reach(start + steps)
        state = optimiser.tell(state, evaluations)
        if state.relaxation.offsets[-1] > most_cells:
            break  # too large: the relaxation before it is the result
        # The newest windows were not filtered yet. The bound does this, on fresh draws.
        relaxation = state.relaxation
        if steps >= most_steps:
            break
    return relaxation, steps
