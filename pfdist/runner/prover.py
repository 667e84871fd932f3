"""The proof of a run's sets: the filters of the relaxation, of its guard, and of the sets alone."""

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pfdist.analysis import Run
from pfdist.bounds.gap import Gap, SetAlone, gap_of
from pfdist.bounds.guard import Falls, guarded
from pfdist.bounds.proof import CONFIDENCE, falls, prove
from pfdist.bounds.relaxation import relaxation_for
from pfdist.errors import JobError, ModelError
from pfdist.evaluation.compiling import compile_problem
from pfdist.evaluation.engines import ENGINES
from pfdist.evaluation.work import Estimation
from pfdist.kernels.estimators import FILTER_VARIANCE
from pfdist.runner.block_sums import BLOCK, GROUPS, BlockSums
from pfdist.runner.bound_settings import BoundSettings
from pfdist.runner.build import Built
from pfdist.runner.session import Session
from pfdist.runner.sets_alone import sets_alone, steps_of_sets
from pfdist.store import BOUND_PHASE, schema
from pfdist.times.constraints import Constraints
from pfdist.times.measurement_times import Times

_FINER = 4  # times the particles, for the guard
_GUARDED = 10  # groups of draws that the guard filters again

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Look:
    """The gaps after so many draws.

    Parameters
    ----------
    draws : int
        0 where the engine is exact.
    steps : int
        Particle-steps of the bound and its guard so far.
    gaps : list of Gap
        One for each compared set.
    """

    draws: int
    steps: int
    gaps: list[Gap]

    def is_within(self, limit: float, without: Collection[str]) -> bool:
        """Whether the limits of all gaps are at most so large, without those of some sets."""
        gaps = [gap for gap in self.gaps if gap.name not in without and not gap.reason]
        return all(gap.gap_at_most <= limit for gap in gaps)


class Prover:
    """Proves how much lower the expected MSE of other times can be, for the sets of a run.

    Parameters
    ----------
    built : Built
    settings : BoundSettings

    Attributes
    ----------
    relaxation : Relaxation
    particles : int
        Particles of the bound's filter; 0 where the engine is exact.
    confidence : float
        Confidence of the limit of a gap: 95 %, or more if the proof may end after several numbers
        of draws.

    Raises
    ------
    JobError, ModelError
        No bound is known for the job's problem, or its relaxation is too large.
    """

    def __init__(self, built: Built, settings: BoundSettings) -> None:
        self._built, self._constraints = built, built.job.problem.feasible
        if not self._constraints.counted:
            raise JobError("measurements have costs, and no lower bound is known for them yet")
        self.relaxation = relaxation_for(self._constraints, settings.window, built.study.fewest)
        # The relaxation filters with the truth's model: a bound for the filter of any model.
        count = settings.particles or built.job.filter.particles
        self._estimation = Estimation(count, "systematic", FILTER_VARIANCE.name)
        truth = built.problem.truth
        truth.check(self._estimation)
        if ENGINES[built.source.engine].compiled:  # before the first task, whose time is limited
            compile_problem(truth, self._estimation)
        self.particles = 0 if built.problem.exact else count
        self._blocks = _doubled(math.ceil(settings.most_draws / BLOCK)) if self.particles else [0]
        self._within = settings.within
        looks = 1 if self._within is None else len(self._blocks)
        self.confidence = 1 - (1 - CONFIDENCE) / looks

    @property
    def steps(self) -> int:
        """About how many particle-steps the proof takes, before the sets are known."""
        sets = steps_of_sets(self._built, len(self._built.names), self._estimation)
        return sets + _steps(self._sums(()), self._blocks[-1])

    def prove(self, session: Session, run: Run) -> Look:
        """Prove the sets of a run, and write the table ``bound``.

        Parameters
        ----------
        session : Session
        run : Run
            A finished run.

        Raises
        ------
        TaskError, PoolError, StoreError
            A task failed, no worker answers, or a file cannot be read or written.
        """
        looks = list[Look]()
        try:
            for look in self._looks(session, run):
                looks.append(look)
                references = self._built.study.references
                if self._within is not None and look.is_within(self._within, references):
                    break
        finally:
            session.collector.flush()
            for table in ("bound_sums", "draws", "timings"):
                for phase in session.store.phases_of(table, BOUND_PHASE):
                    session.store.settle(table, phase)
        session.store.renew("bound", BOUND_PHASE, self._rows(looks, run.draws_compared))
        session.store.manifest.forget_lost()  # all that a bound needs is there again
        return looks[-1]

    def has_proved(self, run: Run) -> bool:
        """Whether the table ``bound`` has this proof, for all draws that the run compares now."""
        if not run.has("bound"):
            return False
        rows = run.bounds()
        own = (rows["window"] == self.relaxation.window) & (rows["particles"] == self.particles)
        enough = rows["draws"] >= self._blocks[-1] * BLOCK
        return bool((own & enough & (rows["compared_draws"] == run.draws_compared)).any())

    def _looks(self, session: Session, run: Run) -> Iterator[Look]:
        """Yield the gaps after more and more draws."""
        sets, constraints = run.sets(), self._constraints
        alone = sets_alone(session, run, sets, self._estimation)
        feasible = {name: times for name, times in sets.items() if _satisfies(constraints, times)}
        sums, most = self._sums(tuple(feasible.values())), self._blocks[-1]
        session.reporter.foresee(_steps(sums, most) - _steps(self._sums(()), most))
        for blocks in self._blocks:
            reason = ""
            try:
                gaps = self._gaps(session, blocks, feasible, alone, sums) if feasible else {}
            except ModelError as error:  # a draw is degenerate
                reason, gaps = str(error), {}
            for name in sets.keys() - gaps.keys():
                why = reason if name in feasible else "the set is not feasible"
                gaps[name] = Gap(name, sets[name], alone[name].expected_mse, why)
            found = [gaps[name] for name in sets]
            yield Look(blocks * BLOCK, _steps(sums, blocks), found)
            if reason:  # more draws do not help
                return

    def _gaps(
        self,
        session: Session,
        blocks: int,
        sets: Mapping[str, Times],
        alone: Mapping[str, SetAlone],
        block_sums: Sequence[BlockSums],
    ) -> dict[str, Gap]:
        """Give the gaps of feasible sets after so many blocks of draws.

        Raises
        ------
        ModelError
            A draw is degenerate.
        """
        known, most = tuple(sets.values()), max(map(len, sets.values()))
        if block_sums:
            coarse, fine = block_sums
            coarse.fill(blocks, session, "lower bound")
            fine.fill(blocks, session, "guard of the bound")
            sums, draws = coarse.by_group(blocks, session)
        else:
            every = (*self.relaxation.sets, *known)
            sums, draws = self._built.problem.expected_errors(every)[None], np.ones(1)
        proof = prove(self.relaxation, sums, draws, known, most)
        gaps = {
            name: gap_of(name, times, alone[name], proof, slack, self.confidence)
            for (name, times), slack in zip(sets.items(), proof.slack, strict=True)
        }
        if not block_sums:
            return gaps
        finer, counts = fine.by_group(blocks, session)
        pair = falls(self.relaxation, sums[:_GUARDED], finer, counts, most)
        particles = f"{_FINER * self.particles} particles in the place of {self.particles}"
        return guarded(gaps, Falls(*pair, particles))

    def _sums(self, known: tuple[Times, ...]) -> list[BlockSums]:
        """The sums of the bound, and those of the guard; none where the engine is exact."""
        if not self.particles:
            return []
        finer = replace(self._estimation, particles=_FINER * self._estimation.particles)
        return [
            BlockSums(self._built, self.relaxation, known, self._estimation),
            BlockSums(self._built, self.relaxation, known, finer, _GUARDED),
        ]

    def _rows(self, looks: list[Look], compared_draws: int) -> pa.Table:
        """Rows of the table ``bound``."""
        settings = {
            "window": self.relaxation.window,
            "longest_gap": self.relaxation.longest_gap,
            "particles": self.particles,
            "confidence": self.confidence,
            "compared_draws": compared_draws,
        }
        rows = [
            {"position": position, "draws": look.draws, "steps": look.steps}
            | settings
            | gap.columns()
            for look in looks
            for position, gap in enumerate(look.gaps)
        ]
        return pa.Table.from_pylist(rows, schema=schema("bound"))


def _steps(sums: Iterable[BlockSums], blocks: int) -> int:
    """Particle-steps of the first blocks of draws."""
    return sum(block_sums.steps(blocks) for block_sums in sums)


def _doubled(blocks: int) -> list[int]:
    """Numbers of blocks after which the gaps are computed."""
    looks = [GROUPS]
    while looks[-1] < blocks:
        looks.append(min(2 * looks[-1], blocks))
    return looks


def _satisfies(constraints: Constraints, times: Times) -> bool:
    """Whether times satisfy all constraints but that on their number."""
    return constraints.compatible(times) and set(constraints.required).issubset(times)
