"""The proof for the information: an upper bound of what any other times can give.

Measurements are independent given the path, so the information about the path and all that is
learned, I(A), is monotone and submodular in the set A of measurements. So any N measurements give
at most I(S) and the N largest gains I(S + j) - I(S), for every set S, and at most I(all). S is a
found set here. The gains use the upper side of I(S + j) and the lower side of I(S), see
`pfdist.kernels.estimators`, so the bound holds for any number of particles. The largest of noisy
gains are too large on average, which is safe.

Source: Krause, Guestrin, "Near-optimal nonmyopic value of information in graphical models", UAI
2005. Nemhauser, Wolsey, Fisher, "An analysis of approximations for maximizing submodular set
functions", Mathematical Programming 14, 1978.
"""

import math
from collections.abc import Generator
from dataclasses import replace

import numpy as np

from pfdist.common.estimate import Estimate
from pfdist.common.measurement_times import Times
from pfdist.filters.criteria.information import GAP, LOWER_SIDE
from pfdist.filters.variants import of_information
from pfdist.filters.work import BLOCK, Estimation, control_of
from pfdist.results import Run
from pfdist.results.criteria import samples_of
from pfdist.results.stored_run import measured_of
from pfdist.runner.block_sums import Array, BlockSums, GroupSums
from pfdist.runner.bound_settings import BoundSettings
from pfdist.runner.build import Built
from pfdist.runner.door import RunSession, WorkBatch
from pfdist.runner.proof import Gap, jackknifed, resampled
from pfdist.runner.prover import Look, Prover, satisfies
from pfdist.search import Counted


class InformationProver(Prover):
    """A proof, for the sets of a run, of how much more information other times can give.

    The table ``bound`` has the numbers that are minimised: negative information.
    """

    def __init__(self, built: Built, settings: BoundSettings) -> None:
        self.begin(built, settings, settings.particles or built.job.filter.particles)
        feasible, points = built.job.problem.feasible, built.job.problem.points
        self._possible = tuple(sorted({*range(points.number)} - {*feasible.forbidden}))
        self._most = feasible.measurement_budget or len(self._possible)
        for estimation in self._estimations:  # before the first task, whose time is limited
            of_information(built.evaluator).compile(estimation)

    @property
    def sizes(self) -> dict[str, int]:
        """There are no windows."""
        return {"windows": 0, "longest_gap": 0}

    @property
    def most_steps(self) -> float:
        """No window grows."""
        return 0.0

    @property
    def rank_steps(self) -> float:
        """Values of the check of the likelihood, which is not checked by ranks."""
        return self._check_values

    @property
    def steps(self) -> float:
        """Particle-steps of the proof."""
        found = len(self._built.searches) or len(self._built.names)
        regular = self._built.job.problem.feasible.regular()
        return found * sum(each.steps(self._blocks[-1]) for each in self._sums_of(regular))

    def _looks(self, session: RunSession, run: Run) -> Generator[WorkBatch, None, list[Look]]:
        """The gaps of all sets, after all draws."""
        sets, gaps = self._built.study.proved(measured_of(run)), list[Gap]()
        wrong, steps = self._fails_check(session), 0.0
        known = {
            name: Estimate.of_mean(s.values_of(LOWER_SIDE)) for name, s in samples_of(run).items()
        }
        session.reporter.begin("upper bound")
        for name, times in sets.items():
            own = known[name].times(-1.0)
            own = own if math.isfinite(own.degrees) else replace(own, standard_error=0.0)
            is_feasible = satisfies(self._built.study.widest, times)
            reason = wrong or "the set is not feasible" * (not is_feasible)
            if not reason:
                means = yield from self._means(session, times)
                steps += sum(each.steps(self._blocks[-1]) for each in self._sums_of(times))
                gaps.append(self._gap(name, times, own, means))
            else:
                gaps.append(Gap(name, times, own, reason))
        return [Look(self._blocks[-1] * BLOCK, steps, gaps)]

    def _sets(self, times: Times) -> tuple[Times, ...]:
        """The set, the sets with one more measurement, and that of all possible measurements."""
        others = [each for each in self._possible if each not in times]
        return (times, *(tuple(sorted((*times, each))) for each in others), self._possible)

    def _sums_of(self, times: Times) -> list[BlockSums]:
        """Sums of minus the information, of the log evidence, and of that beside the truth."""
        counted = self._counted_sets(self._sets(times))
        return [BlockSums(self._built, counted, self._streams, each) for each in self._estimations]

    @property
    def _estimations(self) -> list[Estimation]:
        own = Estimation(max(1, self.particles))
        evidence = GAP.estimation(own)
        sides = [evidence, control_of(evidence)] if self.particles else []
        return [LOWER_SIDE.estimation(own), *sides]

    def _counted_sets(self, sets: tuple[Times, ...]) -> Counted:
        first = np.zeros(len(sets), np.int64)
        return Counted(sets, first, first + self._built.evaluator.horizon)

    def _means(
        self, session: RunSession, times: Times
    ) -> Generator[WorkBatch, None, tuple[Array, Array]]:
        """Lower and upper side of the information of each of K sets, (1 + G, K).

        The first row is that of all draws; each other row leaves out a group of draws.
        """
        sides, count = list[Array](), len(self._sets(times))
        for sums in self._sums_of(times):
            if not self.particles:
                exact = yield from sums.means(0, session)
                of_sets = exact.reshape(count, -1)
                information = -np.array([each.sum() for each in of_sets])[None] / of_sets.shape[1]
                return information, information
            groups = GroupSums(self._counted_sets(self._sets(times)))
            a_block = sums.steps(1)

            def add(
                block: int, errors: Array, groups: GroupSums = groups, work: int = a_block
            ) -> None:
                groups.add(block, errors)
                session.reporter.advance(work)

            yield from sums.added(session, range(self._blocks[-1]), add)
            per_set = groups.sums.reshape(len(groups.draws), count, -1).mean(axis=2)
            sides.append(resampled(per_set, groups.draws))
        information, evidence, beside = sides
        return -information, -information + beside - evidence

    def _gap(self, name: str, times: Times, own: Estimate, means: tuple[Array, Array]) -> Gap:
        """The gap of a feasible set, from both sides of the information."""
        (information, *_), low, high = means[0].T, *means
        extra = self._most - len({*self._built.job.problem.feasible.required} & {*times})
        gains = np.sort(high[:, 1:-1] - low[:, :1], axis=1)[:, ::-1][:, :extra]
        by_gains, by_all = information + gains.sum(axis=1), high[:, -1]
        bounds = by_gains if by_gains[0] <= by_all[0] else by_all
        bound, more = jackknifed(bounds), jackknifed(bounds - information)
        if not math.isfinite(bound.value):
            return Gap(name, times, own, "a measurement tells infinitely much to so few particles")
        if not own.value:
            return Gap(name, times, own, "its measurements tell nothing")
        scale = 1 / -own.value
        spent = self._built.job.problem.feasible.measurement_budget or 0
        gap, at_most = more.value * scale, more.at_most(self.confidence) * scale
        return Gap(
            name, times, own, "", spent, bound.times(-1.0), (), gap, at_most,
            relaxation=more, estimate=Estimate(0.0), filter_model=Estimate(0.0),
        )  # fmt: skip
