"""The proof of a lower bound for a run's sets, by filters of the relaxation and of the sets."""

import math
from collections.abc import Collection, Generator, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
import pyarrow as pa

from pfdist.common.estimate import CONFIDENCE, Estimate
from pfdist.common.measurement_times import Times
from pfdist.common.percent import CHECK_FAILS
from pfdist.common.streams import stream_of
from pfdist.errors import JobError, ModelError
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.exact import exact_mse
from pfdist.filters.variants import knowing_truth, with_shares
from pfdist.filters.work import BLOCK, with_truth
from pfdist.problem.added_sections import has_amounts
from pfdist.problem.constraints import Constraints
from pfdist.problem.needs import BOUND
from pfdist.results import Run
from pfdist.results.criteria import other_criteria, samples_of
from pfdist.results.sets import recommended
from pfdist.results.stored_run import measured_of, values_of
from pfdist.runner.block_sums import (
    CHOICE_BLOCKS,
    GROUPS,
    Array,
    BlockSums,
    GroupSums,
    grown,
)
from pfdist.runner.bound_settings import BoundSettings
from pfdist.runner.build import Built
from pfdist.runner.by_instant import weighted_instants
from pfdist.runner.contract import looked
from pfdist.runner.door import RunSession, WorkBatch
from pfdist.runner.gap_terms import gap_terms, steps_of_sets
from pfdist.runner.likelihood import VALUES, likelihood
from pfdist.runner.proof import Gap, GapTerms, Sums, best_shares, consistent, gap_of, prove
from pfdist.runner.ranks import RankWork, wrong_likelihood
from pfdist.search import Counted
from pfdist.search.first_windows import WINDOW, relaxation_for
from pfdist.search.gaps import gaps_for
from pfdist.search.relaxation import Relaxation
from pfdist.search.state_space_relaxation import StateSpaceRelaxation
from pfdist.store import BOUND_PHASE, schema

_CHECKED = 200  # draws whose states check the likelihood
_ROUNDS = 1000  # of growing windows, at most
_PATHS = 16  # whose windows grow in a round
_THRESHOLD = 0.5  # of its resampling
_LINES = 1000  # particles of a bound for estimates that use later measurements, at least
_FEWER, _LEAST_GROWING = 4, 50  # particles while windows grow: a fourth of all, and at least
# Windows grow until the relaxed errors lie below those of the sets by so small a share:
_GROWN, _GROWN_EXACTLY = 1e-3, 1e-11


@dataclass(frozen=True)
class Look:
    """The gaps of the proved sets after so many draws."""

    draws: int  # 0 for an exact engine
    steps: float  # particle-steps of the windows and the bound so far
    gaps: list[Gap]  # one for each proved set

    def is_within(self, limit: float, without: Collection[str]) -> bool:
        """Whether the limits of all gaps are at most this large, except those of `without`."""
        gaps = [gap for gap in self.gaps if gap.name not in without and not gap.reason]
        return all(gap.gap_at_most <= limit for gap in gaps)


class Prover:
    """A proof, for the sets of a run, of how much lower the expected MSE of other times can be.

    Before a proof, `relaxation` is the one from which its windows grow; afterwards the final one.
    `particles` is 0 for an exact engine. `confidence` is that of the limit of a gap: 95 %, or more
    if the proof may end after several numbers of draws. `shares` are those of the scenarios or
    instants in the bound, if the worst of them decides. `ignored` are the sets that a required gap
    ignores: all others, if a set beats those of the searches. Raises `JobError` or `ModelError` if
    no bound is known for the job's problem, or if its relaxation is too large.
    """

    def __init__(self, built: Built, settings: BoundSettings) -> None:
        if built.job.criterion.bound == "none":
            label = built.job.criterion.label
            raise JobError(f"no bound is known for the {label}: it is no mean of errors")
        # The relaxation filters with the true model, so the bound holds for a filter of any model.
        lag, count = built.evaluator.lag, settings.particles or built.job.filter.particles
        if lag and not settings.particles:  # few lines are left after all measurements of a gap
            count = max(count, _LINES)
        own = built.job.filter.proposal
        self._estimation = with_truth(count, own)
        if lag and not built.evaluator.model.sensors:
            # Fewer resamplings after a gap leave more lines. The truth counts in the decision, too.
            self._estimation = replace(self._estimation, threshold=_THRESHOLD)
        # The windows to grow along are found with fewer particles; the bound does not trust them.
        self._growing = with_truth(max(count // _FEWER, min(count, _LEAST_GROWING)), own)
        truth = knowing_truth(built.evaluator)
        BOUND.check("a bound", built.job, truth)
        truth.compile(self._estimation)  # before the first task, whose time is limited
        self.begin(built, settings, count)
        feasible, usual, cells = built.study.widest, built.study.usual, settings.most_cells
        self.relaxation = (
            gaps_for(feasible, usual, lag, cells)
            if lag
            else relaxation_for(feasible, settings.window, usual, cells)
        )

    def begin(self, built: Built, settings: BoundSettings, particles: int) -> None:
        """Take the settings of a proof with so many particles."""
        self._given = self._built = built
        self.settings = settings
        self.shares: tuple[float, ...] = ()
        self.ignored = built.unjudged
        self.particles = particles if built.evaluator.has_particles else 0
        self._blocks = _doubled(math.ceil(settings.most_draws / BLOCK)) if self.particles else [0]
        looks = 1 if settings.within is None else len(self._blocks)
        self.confidence = 1 - (1 - CONFIDENCE) / looks

    @property
    def sizes(self) -> dict[str, int]:
        """The number of windows, and the longest gap for which the error of a window counts."""
        return {"windows": len(self.relaxation.windows), "longest_gap": self.relaxation.longest_gap}

    @property
    def steps(self) -> float:
        """Approximate upper limit of the proof's particle-steps, with windows that grow."""
        draws = self._blocks[-1] * BLOCK
        sets = steps_of_sets(self._built, len(self._built.names), self._estimation, draws)
        return sets + self._steps_of_windows

    @property
    def rank_steps(self) -> float:
        """Particle-steps of the checks of the likelihood, by formulas and by ranks."""
        instants = len(self._built.names) * (self._built.evaluator.horizon + 1)
        return self._blocks[-1] * BLOCK * instants * self.particles + self._check_values

    @property
    def _check_values(self) -> float:
        """Values of formulas by which `check-model` checks the likelihood."""
        truth = knowing_truth(self._built.evaluator)
        parts = sum(len(each.model.ways) for each in truth.of_scenarios or (truth,))
        return float(VALUES * parts * bool(self.particles))

    @property
    def _steps_of_windows(self) -> float:
        """Foreseen particle-steps of windows: first they grow, then the first ones are filtered."""
        growth = self.most_steps if self.particles else 0.0
        return growth + self._steps((), self._blocks[-1])

    def prove(self, session: RunSession, run: Run) -> Generator[WorkBatch, None, Look]:
        """Prove bounds for the sets of a finished run, and write the table ``bound``."""
        # The sums are published before the table of the bound, which marks the proof as done. A
        # kill in between errors no filter: the next proof finds all sums by their ids. If it is
        # stopped, the sums stay parts, because those of single draws are not published.
        built, tables = self._built, ["draws", "timings"]
        if not has_amounts(run.job) and (best := recommended(run)).beats_search:
            self.ignored = run.sets.keys() - {best.name}
        try:
            looks = yield from self._looks(session, run)
            tables = ["error_sums", *tables]
        finally:  # also if the driver is closed early: rows that still wait are committed
            session.built = self._built = built
            session.commit()
            for table in tables:
                for phase in session.store.phases_of(table, BOUND_PHASE):
                    session.store.settle(table, phase)
        session.store.renew("bound", BOUND_PHASE, self._rows(looks, run.draws_compared))
        return looks[-1]

    def has_proved(self, run: Run) -> bool:
        """Whether the table ``bound`` has this proof, for all draws that the run now compares."""
        if "bound" not in run.tables:
            return False
        rows = run.table("bound")
        enough = rows["draws"] >= self._blocks[-1] * BLOCK
        for key, value in self._columns(run.draws_compared).items():
            enough &= rows[key] == value
        return bool(enough.any())

    def _looks(self, session: RunSession, run: Run) -> Generator[WorkBatch, None, list[Look]]:
        """The gaps after more and more draws, until they are small enough or draws run out."""
        constraints = self._built.study.widest
        sets = self._built.study.proved(measured_of(run))
        feasible = {name: times for name, times in sets.items() if satisfies(constraints, times)}
        wrong = self._fails_check(session)
        if feasible and self._built.job.criterion.bound == "mixture" and not wrong:
            yield from self._weigh(session, max(self._spent(feasible)))
        parts = yield from self._parts(session, run, sets)
        if wrong:
            gaps = [Gap(name, sets[name], parts[name].expected_mse, wrong) for name in sets]
            return [Look(self._blocks[-1] * BLOCK, 0.0, gaps)]
        looks = yield from self._looks_of(session, sets, feasible, parts)
        if wrong := (yield from self._misplaces_truth(session, feasible.values(), looks[-1])):
            looks = [replace(each, gaps=[g.refused(wrong) for g in each.gaps]) for each in looks]
        return looks

    def _looks_of(
        self,
        session: RunSession,
        sets: Mapping[str, Times],
        feasible: Mapping[str, Times],
        parts: Mapping[str, GapTerms],
    ) -> Generator[WorkBatch, None, list[Look]]:
        """The gaps of sets, some of which are feasible, by a likelihood that is right."""
        feasible_times = tuple(feasible.values())
        spent = self._spent(feasible)
        foreseen, growth = self._steps_of_windows, 0.0
        if feasible and self.most_steps > 0:
            self.relaxation, growth = yield from self._grown(session, feasible_times, spent)
        steps = self._steps(feasible_times, self._blocks[-1])
        session.reporter.foresee(growth + steps - foreseen)
        looks, before, groups = list[Look](), 0, GroupSums(self._counted(feasible_times))
        within = self.settings.within
        if self.particles:
            session.reporter.begin("proof, step 3 of 3")
        for blocks in self._blocks:
            later = steps - self._steps(feasible_times, blocks)  # `within` may leave it out
            session.reporter.note(optional=later * (within is not None))
            reason, sums = "", None
            try:
                if feasible:
                    some = range(before, blocks)
                    sums = yield from self._sums(session, feasible_times, some, groups)
                before = blocks
                gaps = self._gaps(feasible, parts, sums) if sums else {}
            except ModelError as error:
                reason, gaps = str(error), {}
            for name in sets.keys() - gaps.keys():
                why = reason if name in feasible else "the set is not feasible"
                gaps[name] = Gap(name, sets[name], parts[name].expected_mse, why)
            gaps_in_order = [gaps[name] for name in sets]
            looks.append(
                Look(blocks * BLOCK, growth + self._steps(feasible_times, blocks), gaps_in_order)
            )
            if reason:  # more draws would not help
                break
            if within is not None and looks[-1].is_within(within, self.ignored):
                break
        return looks

    def _fails_check(self, session: RunSession) -> str:
        """Why `check-model` finds that a likelihood is wrong; empty if it does not."""
        if not self.particles:
            return ""
        session.count_exact(BOUND_PHASE, "likelihood", int(self._check_values))
        evaluator = knowing_truth(self._built.evaluator)
        for each in evaluator.of_scenarios or (evaluator,):
            draws = each.draws(range(_CHECKED), 0)
            for way in each.model.ways:
                own = replace(draws, model=way.model, y=draws.y[..., way.y])
                state, text = looked(likelihood, way.model, own)
                if state == "wrong":
                    return f"{CHECK_FAILS}: {text}"
        return ""

    def _misplaces_truth(
        self, session: RunSession, sets: Iterable[Times], look: Look
    ) -> Generator[WorkBatch, None, str]:
        """Why the likelihood must be wrong, by the truth among the particles of the sets alone."""
        measured, proves = tuple(filter(None, sets)), any(not gap.reason for gap in look.gaps)
        if not (self.particles and measured and proves):
            return ""
        first = np.zeros(len(measured), np.int64)
        whole = Counted(measured, first, first + self.relaxation.horizon)
        ranks = BlockSums(
            self._built, whole, self._streams, self._estimation, kind=RankWork, part="likelihood"
        )
        sums = yield from ranks.total(look.draws // BLOCK, session)
        return wrong_likelihood(sums, look.draws)

    def _parts(
        self, session: RunSession, run: Run, sets: Mapping[str, Times]
    ) -> Generator[WorkBatch, None, dict[str, GapTerms]]:
        """The value of each set, by the job's criterion, and gap parts."""
        most = self._blocks[-1] * BLOCK
        parts = yield from gap_terms(session, run, sets, self._estimation, most)
        if not self.shares:
            return parts
        for name, value in self._values(run, sets).items():
            weighting = value.plus(parts[name].expected_mse.times(-1.0))
            parts[name] = replace(parts[name], expected_mse=value, weighting=weighting)
        return parts

    def _weigh(self, session: RunSession, spent: int) -> Generator[WorkBatch, None, None]:
        """Give the scenarios, or the instants, the shares for which the bound is largest.

        The largest of several errors is at least their mean with any shares. Separate draws choose
        these.
        """
        built, evaluator = self._built, self._built.evaluator
        session.reporter.begin("weights of the bound")
        if built.job.criterion.by_instant:
            windows = partial(self._windows, session)
            weighted = yield from weighted_instants(self.relaxation, spent, evaluator, windows)
            self.shares = weighted.weights or ()
        else:
            errors = yield from self._of_scenarios(session)
            self.shares = best_shares(self.relaxation, errors, spent)
            weighted = with_shares(evaluator, self.shares)
        session.built = self._built = replace(built, evaluator=weighted)

    def _of_scenarios(self, session: RunSession) -> Generator[WorkBatch, None, Array]:
        """The errors of all windows in each scenario, (C, E)."""
        evaluator, errors = self._built.evaluator, list[Array]()
        blocks = math.ceil(CHOICE_BLOCKS / len(evaluator.scenarios))
        for shares in np.eye(len(evaluator.scenarios)).tolist():
            errors.append(
                (yield from self._windows(session, with_shares(evaluator, shares), blocks))
            )
        return np.stack(errors)

    def _windows(
        self, session: RunSession, evaluator: Evaluator, blocks: int
    ) -> Generator[WorkBatch, None, Array]:
        """The errors of all windows on separate draws, (E,)."""
        session.built = replace(self._built, evaluator=evaluator)
        stream = stream_of("bound", self._built.job.seed, "weights")
        sums = BlockSums(session.built, self._counted(()), (stream, stream), self._growing)
        return (yield from sums.means(blocks, session))

    def _values(self, run: Run, sets: Mapping[str, Times]) -> dict[str, Estimate]:
        """The criterion's value for each set, exact or of the comparison."""
        built = self._given
        exact = exact_mse(built.evaluator, [*sets.values()], criterion=built.job.criterion)
        if exact is not None:
            return dict(zip(sets, map(Estimate, exact.tolist()), strict=True))
        if not built.job.criterion.by_instant:
            values = values_of(run)
            return {name: values[name] for name in sets}
        criterion, samples = other_criteria(run)[built.job.criterion.name], samples_of(run)
        judged = {name: criterion.of_sample(samples[name]) for name in sets}
        return {name: Estimate(each.value, each.standard_error) for name, each in judged.items()}

    def _spent(self, sets: Mapping[str, Times]) -> list[int]:
        """The sum of the bound for each set."""
        study = self._built.study
        return [study.spent(self.relaxation, name, times) for name, times in sets.items()]

    def _grown(
        self, session: RunSession, sets: tuple[Times, ...], spent: list[int]
    ) -> Generator[WorkBatch, None, tuple[Relaxation, float]]:
        """The relaxation with longer windows along the sets, and the particle-steps spent."""
        optimiser = StateSpaceRelaxation(
            self._built.study.widest,
            paths=_PATHS,
            rounds=_ROUNDS,
            sought=tuple(sorted({*spent})),
            known_sets=sets,
            gap=_GROWN if self.particles else _GROWN_EXACTLY,
            start=self.relaxation,
            most_grown=self.settings.most_windows,
            lag=self._built.evaluator.lag,
        )
        return (
            yield from grown(
                session, optimiser, self._growing, self.most_steps, self.settings.most_cells
            )
        )

    @cached_property
    def most_steps(self) -> float:
        """Particle-steps after which no window grows; by default twice those of the first.

        The errors of gaps gain less by growth.
        """
        if self.settings.work is not None:
            return self.settings.work
        times = 1.0 if self._built.evaluator.lag else 2.0
        return times * self._steps((), GROUPS) if self.particles else math.inf

    def _gaps(
        self, sets: Mapping[str, Times], parts: Mapping[str, GapTerms], sums: Sums
    ) -> dict[str, Gap]:
        """The gaps of feasible sets that follow from sums of errors."""
        spent = self._spent(sets)
        proof = prove(self.relaxation, sums, tuple(sets.values()), max(spent), spent)
        gaps = {
            name: gap_of(name, times, parts[name], proof, place, self.confidence)
            for place, (name, times) in enumerate(sets.items())
        }
        return consistent(gaps) if self.particles else gaps

    def _sums(
        self, session: RunSession, sets: tuple[Times, ...], blocks: range, groups: GroupSums
    ) -> Generator[WorkBatch, None, Sums]:
        """Sums of the errors of all windows and of C sets, when some blocks are added to groups.

        Raises `ModelError` if a draw is degenerate or infinite.
        """
        reporter, sums = session.reporter, self._block_sums(sets)
        a_block = sums.steps(1)

        def add(block: int, errors: Array) -> None:
            groups.add(block, errors)
            reporter.advance(a_block, BLOCK)

        if self.particles:
            yield from sums.added(session, blocks, add)
            errors, draws = groups.sums, groups.draws
        else:
            means = yield from sums.means(0, session)
            errors, draws = means[None], np.ones(1)
        if not np.isfinite(errors).all():
            raise ModelError(
                "a draw is degenerate or infinite although a particle has its true state: "
                "log_likelihood must be finite at the state that made the measurement"
            )
        windows, of_sets = np.split(errors, [self.relaxation.offsets[-1]], axis=1)
        return Sums(windows, of_sets.reshape(len(draws), len(sets), -1), draws)

    def _steps(self, sets: tuple[Times, ...], blocks: int) -> float:
        """Particle-steps of windows and sets on the first blocks of draws."""
        return float(self._block_sums(sets).steps(blocks))

    def _counted(self, sets: tuple[Times, ...]) -> Counted:
        """The errors of all windows, and of sets at all instants."""
        every = np.zeros(len(sets), np.int64)
        relaxation, of_sets = self.relaxation, Counted(sets, every, every + self.relaxation.horizon)
        return relaxation.counted(range(len(relaxation.windows))) + of_sets

    def _block_sums(self, sets: tuple[Times, ...]) -> BlockSums:
        """Sums of the errors of all windows, and of sets at all instants."""
        return BlockSums(self._built, self._counted(sets), self._streams, self._estimation)

    @property
    def _streams(self) -> tuple[int, int]:
        seed = self._built.job.seed
        return stream_of("bound", seed, "filter"), stream_of("bound", seed, "draws")

    def _columns(self, compared_draws: int) -> dict[str, Any]:
        return {
            "window": WINDOW if self._built.evaluator.lag else self.settings.window,
            "work": self.most_steps,
            "memory": self.settings.memory,
            "particles": self.particles,
            "confidence": self.confidence,
            "compared_draws": compared_draws,
        }

    def _rows(self, looks: list[Look], compared_draws: int) -> pa.Table:
        shares = {"shares": self.shares} if self.shares else {}
        rows = [
            {"position": position, "draws": look.draws, "steps": look.steps}
            | self._columns(compared_draws)
            | self.sizes
            | shares
            | gap.columns()
            for look in looks
            for position, gap in enumerate(look.gaps)
        ]
        return pa.Table.from_pylist(rows, schema=schema("bound", *shares))


def _doubled(blocks: int) -> list[int]:
    """Numbers of blocks after which the gaps are computed: each twice the one before."""
    looks = [GROUPS]
    while looks[-1] < blocks:
        looks.append(min(2 * looks[-1], blocks))
    return looks


def satisfies(constraints: Constraints, times: Times) -> bool:
    """Whether times satisfy all constraints except that on their number."""
    paid = constraints.counted or constraints.spent(times) <= constraints.total
    return paid and constraints.compatible(times) and {*constraints.required}.issubset(times)
