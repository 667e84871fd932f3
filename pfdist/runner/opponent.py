"""The opponent of a plan: the best evenly spaced set, and the best of all opponents.

The first programme of the relaxation ranks all evenly spaced sets by the sums of their windows, for
the work of some eighty evaluations. Its windows are short, so an evaluation from coarse to fine
adds other sets; it is alone where no relaxation adds up the errors of instants. A race on fresh
draws decides between the best of both: neither knows more than the best hundred, so it begins with
many sets and few draws. With exact errors there is no race. The particle-steps of all this are at
most a twentieth of those of search and comparison, at any horizon and number; small jobs may take
`_LEAST_STEPS`.
"""

import math
from collections.abc import Generator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain
from types import MappingProxyType

import numpy as np

from pfdist.common.measurement_times import MOST_REGULAR, Times
from pfdist.errors import JobError
from pfdist.filters.estimate import Evaluation
from pfdist.filters.exact import exact_mse
from pfdist.filters.work import BLOCK
from pfdist.kernels.estimators import FILTER_VARIANCE, TWO_CLOUDS
from pfdist.models.batched import BatchedModel
from pfdist.problem.even_sets import EvenSets, even_sets
from pfdist.problem.feasible import Feasible
from pfdist.problem.search_section import CommonNoiseSettings
from pfdist.runner.build import Built
from pfdist.runner.comparison_phase import comparison_steps
from pfdist.runner.door import RunSession, WorkBatch
from pfdist.runner.phase import Phase, run_phase
from pfdist.runner.search_phase import search_steps
from pfdist.runner.searches import RANKING, Settings, coarse_of, shortlist_of
from pfdist.search import Race, Refine
from pfdist.search.programme import Programme
from pfdist.search.state_space_relaxation import first_relaxation

SHARE = 0.05
"""Largest share of the particle-steps of search, comparison and proof, for each further answer."""
_LEAST_STEPS = 2e8  # a second or two: in a small job a share found opponents with 3 % more error

_RANKED = 150_000  # lines of a ranking; the 39,627 sets of the paper's problem have 113,778
_EXACTLY = 200_000, 20, 1000  # instants of the sets with exact errors; least and most sets
_NEAR, _LEVELS = 16, 3  # lines near which others are ranked, and how often, if not all are
_RANKING_DRAWS = 2 * BLOCK
_RACING, _FIRST = 96, 96  # sets of a race, and draws of its first round
_KEPT, _UNTIL = 12, 600  # sets that are kept until so many draws
_WHOLE_RACE = 23_000  # draws of all sets of such a race, about; they share much
_COARSE_DRAWS = BLOCK  # of an evaluation from coarse to fine
_OF_RANKING, _OF_REFINING = 0.35, 0.4  # of the work, at most; the race takes what is left
_GAPS = 2  # mean gaps that must be known, if errors in longer ones count as less than they are
_LEAST_SPREAD, _MOST_SPREAD = 16, 400  # sets with which an evaluation from coarse to fine begins


@dataclass(frozen=True)
class Opponent:
    """The best evenly spaced set that was found, and the best of all opponents."""

    times: Times
    tried: int  # number of evenly spaced sets that were looked at; 0: all that there are
    best: str  # name of the best opponent
    evaluation: Evaluation | None = None  # of the best opponent, on draws that chose it


@dataclass(frozen=True)
class EvenSearch:
    """The search for the best of the evenly spaced sets of some feasible sets."""

    built: Built
    name: str  # of the opponent
    feasible: Feasible
    given: Mapping[str, Times]  # the user's own opponents, by name; they take part in the race

    @cached_property
    def even(self) -> EvenSets:
        """All candidates."""
        return even_sets(self.feasible)

    @property
    def steps(self) -> float:
        """The most particle-steps that the search may take."""
        return most_steps(self.built) / len(self.built.study.each)

    @cached_property
    def phase(self) -> Phase:
        """The phase of the race, whose sets are still open."""
        settings, built = settings_of(self.built), self.built
        return Phase(
            shortlist_of(self.name), Race((), _FIRST), "shortlist", settings, built,
            built.job.criterion, part="opponent",
        )  # fmt: skip

    @property
    def _a_draw(self) -> float:
        """Particle-steps of a set in a draw."""
        steps = self.phase.settings.estimation.steps_an_instant * (self.feasible.horizon + 1)
        return steps * self.phase.criterion.scenario_count

    def best(self, session: RunSession) -> Generator[WorkBatch, None, Opponent]:
        """The best of the candidates and the given sets, by a race on draws of its own."""
        given, tried, spent = dict.fromkeys(self.given.values()), 0, 0.0
        is_single = not self.built.job.amounts and self.feasible.counted
        if is_single and self.feasible.total <= MOST_REGULAR:
            ranked = [self.feasible.regular()]  # every set is evenly spaced
        elif self._is_exact:
            ranked, tried = yield from self._candidates(session)
        else:
            ranked, tried, spent = yield from self._finalists(session)
        ranked = ranked or [self.feasible.regular()]
        order, raced = [*dict.fromkeys((*given, *ranked))], list[Evaluation]()
        if len(order) > 1:
            raced = yield from self._raced(session, order, len(given), spent)
            order = [each.measurement_times for each in raced]
        even = next(times for times in order if times in {*ranked})
        names = (name for name, times in self.given.items() if times == order[0] != even)
        return Opponent(even, tried, next(names, self.name), next(iter(raced), None))

    @property
    def _is_exact(self) -> bool:
        return self.built.evaluator.exact and not self.built.job.criterion.needs_draws

    def _raced(
        self, session: RunSession, sets: list[Times], given: int, spent: float
    ) -> Generator[WorkBatch, None, list[Evaluation]]:
        """The best of the sets, the best first: by exact errors, or by a race of the first ones."""
        criterion = self.built.job.criterion
        errors = exact_mse(self.built.evaluator, sets, criterion=criterion)
        if errors is not None:
            instants = len(sets) * (self.feasible.horizon + 1)
            session.count_exact(self.phase.name, "opponent", instants)
            order = np.argsort(errors, kind="stable").tolist()
            return [Evaluation.exactly(sets[k], float(errors[k]), criterion) for k in order]
        scale, draws, most = self._racing(spent)
        race = Race(tuple(sets[: given + most]), draws, _KEPT, math.ceil(scale * _UNTIL))
        raced = yield from run_phase(self._with(race, draws), session)
        return [*raced]

    def _racing(self, spent: float) -> tuple[float, int, int]:
        """The share of a whole race that is left, draws of its first round, and most sets."""
        scale = min(1.0, max(0.0, self.steps / self._a_draw - spent) / _WHOLE_RACE)
        draws = max(BLOCK, self.phase.criterion.fewest, math.ceil(scale * _FIRST))
        return scale, draws, max(2, min(_RACING, int(scale * _RACING * _FIRST / draws)))

    def _candidates(
        self, session: RunSession
    ) -> Generator[WorkBatch, None, tuple[list[Times], int]]:
        """The candidates for exact errors, and their number: all, or the best of the ranking."""
        most = most_if_exact(self.feasible)
        lines = self.even.lines(most * 10)
        sets = [] if any(line.distance for line in lines) else [*self.even.sets_of(lines)]
        if 0 < len(sets) <= most:
            return sets, 0
        ranked, tried, _ = yield from self._finalists(session)
        return ranked[:most], tried

    def _finalists(
        self, session: RunSession
    ) -> Generator[WorkBatch, None, tuple[list[Times], int, float]]:
        """Candidates, the best first, how many were looked at, and the work in draws of a set.

        Windows are short. Where a system remembers longer, their sums rank good sets too low: so
        every other candidate is from an evaluation from coarse to fine.
        """
        programme = yield from self.programme(session)
        ranked, tried, spent = list[Times](), 1, 0.0
        if programme is not None:
            ranked, tried = ranking(self.even, programme, _RANKED)
            numbers = len(self.built.study.each) * (self.feasible.horizon + 1)
            spent = _RANKING_DRAWS * programme.errors.size / numbers
        spread = int(_OF_REFINING * self.steps / (_COARSE_DRAWS * self._a_draw * 2.5))
        if ranked and (self._is_exact or spread < _LEAST_SPREAD):
            return ranked, tried, spent
        if spread < _LEAST_SPREAD and not self._is_exact:  # a few sets race
            most = max(2, self._racing(spent)[-1] // 2)
            sets = [*self.even.sets_of(self.even.lines(_RACING))]
            spread_sets = [self.feasible.regular(), *sets[:: max(1, len(sets) // most)]]
            few = [*dict.fromkeys(spread_sets)][:most]
            return few, len(few), spent
        refine = Refine(self.even, max(_LEAST_SPREAD, min(spread, _MOST_SPREAD)))
        draws = max(_COARSE_DRAWS, self.phase.criterion.fewest)
        coarse = replace(self._with(refine, draws), name=coarse_of(self.name))
        found = yield from run_phase(coarse, session)
        refined = [each.measurement_times for each in found]
        by_turns = chain.from_iterable(zip(ranked, refined, strict=False))
        tried = tried if ranked else len(refined)
        return [*by_turns, *refined, *ranked], tried, spent + draws * len(refined)

    def programme(self, session: RunSession) -> Generator[WorkBatch, None, Programme | None]:
        """The first programme of the relaxation; None if there is none, or it takes too long."""
        built, study = self.built, self.built.study
        phase, feasible = replace(self.phase, name=RANKING), study.widest
        if phase.name in session.programmes:
            return session.programmes[phase.name]
        if not built.job.criterion.additive or built.job.criterion.by_instant:
            return None
        blocks = _RANKING_DRAWS // BLOCK
        a_draw = _RANKING_DRAWS * self._a_draw / (feasible.horizon + 1)
        allowed = most_steps(built)  # for all numbers of measurements
        most = int(_OF_RANKING * allowed / a_draw)
        try:
            relaxation = first_relaxation(feasible, study.usual, built.evaluator.lag, most)
        except JobError:
            return None
        is_large = relaxation.offsets[-1] > most and not built.evaluator.exact
        usual_gap = (feasible.horizon + 1) / (study.usual + 1)
        if is_large or (built.evaluator.lag and relaxation.longest_gap < _GAPS * usual_gap):
            return None
        counted = np.flatnonzero(np.diff(relaxation.offsets)).tolist()
        errors = yield from phase.sums(relaxation.counted(counted)).means(blocks, session)
        session.later(partial(session.store.settle, "error_sums", phase.name))
        if_all = errors[: relaxation.offsets[1]]  # of a smoother with everything measured
        if built.evaluator.lag and not np.isfinite(if_all).all():
            return None
        programme = Programme(relaxation, np.nan_to_num(errors, nan=np.inf), relaxation.total)
        session.programmes[phase.name] = programme
        return programme

    def _with(self, optimiser: Race | Refine, draws: int) -> Phase:
        return replace(
            self.phase, optimiser=optimiser, settings=replace(self.phase.settings, draws=draws)
        )


def most_if_exact(feasible: Feasible) -> int:
    """The number of sets whose exact errors are compared."""
    instants, least, most = _EXACTLY
    return min(most, max(least, instants // (feasible.horizon + 1)))


def ranking(even: EvenSets, programme: Programme, most: int) -> tuple[list[Times], int]:
    """The sets of all lines or of most lines near good ones, the best first, and their number."""
    lines = even.lines(most)
    found, errors = even.sets_of(lines), dict[Times, float]()
    for level in range(1 + _LEVELS):
        new = [times for times in found if times not in errors]
        errors.update(zip(new, programme.of_sets(new).tolist(), strict=True))
        best = sorted(found, key=errors.__getitem__)[:_NEAR]
        near = [each for times in best for each in even.near(found[times])]
        if not near or level == _LEVELS:
            break
        found = {**even.sets_of(near), **found}
    ranked = sorted(errors, key=errors.__getitem__)
    return ranked, len(ranked) if any(line.distance for line in lines) else 0


def settings_of(built: Built) -> Settings:
    """The settings of the race: those by which a search polishes its plan."""
    job = built.job
    by_variance = built.evaluator.variance_is_error and not job.criterion.needs_draws
    settings = Settings.from_job(job, CommonNoiseSettings(draws=_FIRST), by_variance)
    estimator = settings.estimation.estimator
    if estimator == FILTER_VARIANCE.name:  # it does not see that a cloud collapses
        estimator = TWO_CLOUDS.name
    return replace(
        settings,
        common_noise=True,
        degenerate_policy="continue",
        estimation=replace(settings.estimation, estimator=estimator),
    )


def most_steps(built: Built) -> float:
    """The most particle-steps of all opponents: their share, or so many as a small job may take.

    Results of a run do not depend on whether a proof follows: its work does not count here. A
    batched model may be slow, and keeps to the share.
    """
    planned = sum(search_steps(built, search) for search in built.searches)
    is_slow = isinstance(built.evaluator.model, BatchedModel)
    share = SHARE * (planned + comparison_steps(built))
    return share if is_slow else max(share, _LEAST_STEPS)


def opponent_steps(built: Built) -> float:
    """Approximate number of particle-steps of all opponents."""
    has_any = built.study.even and built.evaluator.has_particles
    return most_steps(built) if has_any else 0.0


def best_evenly_spaced(
    session: RunSession, name: str, others: Mapping[str, Times] = MappingProxyType({})
) -> Generator[WorkBatch, None, Opponent]:
    """The best evenly spaced set of this name, and the best of it and other sets."""
    job, feasible = session.built.job, session.built.study.even[name]
    sets = others if job.amounts else job.given_sets
    given = {
        each: times for each, times in sets.items() if times is not None and feasible.allows(times)
    }
    return (yield from EvenSearch(session.built, name, feasible, given).best(session))
