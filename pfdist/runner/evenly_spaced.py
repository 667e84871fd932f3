"""The best evenly spaced sets: the opponent of a plan, and how many of them do as well.

The first programme of the relaxation ranks all evenly spaced sets by the sums of their windows, for
the work of some eighty evaluations. A race on fresh draws decides between the best of this ranking.
Where no relaxation adds up the errors of instants, sets are evaluated from coarse to fine. With
exact errors there is no race. Particle-steps are limited, at any horizon and number.
"""

import math
from collections.abc import Generator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pfdist.common.estimate import CONFIDENCE, Estimate
from pfdist.common.measurement_times import EVEN, MOST_REGULAR, REGULAR, Times
from pfdist.common.streams import stream_of
from pfdist.errors import JobError
from pfdist.filters.work import BLOCK, FilterWork, Result
from pfdist.kernels.estimators import FILTER_VARIANCE, TWO_CLOUDS
from pfdist.problem.even_sets import EvenSets
from pfdist.problem.feasible import Feasible
from pfdist.problem.search_section import CommonNoiseSettings
from pfdist.results import Run
from pfdist.results.evenly_spaced import AS_WELL, sign_of
from pfdist.results.moments import controlled_mse
from pfdist.results.stored_run import measured_of
from pfdist.runner.block_sums import evaluated_by_errors
from pfdist.runner.build import Built
from pfdist.runner.comparison_phase import comparison_steps
from pfdist.runner.door import RunSession, WorkBatch
from pfdist.runner.phase import Phase, run_phase
from pfdist.runner.progress import Detail
from pfdist.runner.search_phase import search_steps
from pfdist.runner.searches import Settings, coarse_of, shortlist_of
from pfdist.search import Candidate, Race, Refine
from pfdist.search.programme import Programme
from pfdist.search.state_space_relaxation import first_relaxation
from pfdist.store import EVEN_PHASE, schema

SHARE = 0.05
"""Largest share of the particle-steps of search, comparison and proof, for each of two answers."""
_PROVED = 2  # with a proof, all of them take about so many times the search and the comparison

_RANKED = 100_000  # lines of a ranking; the paper's problem has 39,627 sets
_EXACTLY = 200_000, 20, 1000  # instants of the sets with exact errors; least and most sets
_NEAR, _LEVELS = 16, 3  # lines near which others are ranked, and how often, if not all are
_RANKING_DRAWS = 2 * BLOCK
_RACING, _KEPT, _UNTIL, _FIRST = 20, 12, 600, 150  # sets of a race; those kept until so many draws
_ROUNDS = 2.4  # the work of a whole race, over that of `_KEPT` sets on `_UNTIL` draws
_COARSE_DRAWS = BLOCK  # of an evaluation from coarse to fine


# --- the opponent ---------------------------------------------------------------------------------


@dataclass(frozen=True)
class Opponent:
    """The best evenly spaced set that was found, and the best of all opponents."""

    times: Times
    tried: int  # number of evenly spaced sets that were looked at; 0: all that there are
    best: str  # name of the best opponent


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
        return EvenSets(self.feasible)

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
        instants = self.feasible.horizon + 1
        return (
            self.phase.settings.estimation.steps_an_instant * instants * self.phase.criterion.apart
        )

    def best(self, session: RunSession) -> Generator[WorkBatch, None, Opponent]:
        """The best of the candidates and the given sets, by a race on draws of its own."""
        given, tried = dict.fromkeys(self.given.values()), 0
        is_single = self.built.job.budget is None and self.feasible.counted
        if is_single and self.feasible.total <= MOST_REGULAR:
            ranked = [self.feasible.regular()]  # every set is evenly spaced
        elif self.built.evaluator.exact:
            ranked, tried = yield from self._candidates(session)
        else:
            ranked, tried = yield from self._ranked(session)
            ranked = ranked[:_RACING]
        ranked = ranked or [self.feasible.regular()]
        order = [*dict.fromkeys((*given, *ranked))]
        if len(order) > 1:
            order = yield from self._raced(session, order)
        even = next(times for times in order if times in {*ranked})
        names = (name for name, times in self.given.items() if times == order[0] != even)
        return Opponent(even, tried, next(names, self.name))

    def _raced(
        self, session: RunSession, sets: list[Times]
    ) -> Generator[WorkBatch, None, list[Times]]:
        """The sets, the best first: by exact errors, or by a race."""
        errors = self.built.evaluator.expected_mse(sets, criterion=self.built.job.criterion)
        if errors is not None:
            instants = len(sets) * (self.feasible.horizon + 1)
            session.count_exact(self.phase.name, "opponent", instants)
            return [sets[place] for place in np.argsort(errors, kind="stable").tolist()]
        scale = min(1.0, self.steps / 2 / (_ROUNDS * _KEPT * _UNTIL * self._a_draw))
        draws = max(BLOCK, self.phase.criterion.fewest, math.ceil(scale * _FIRST))
        race = Race(tuple(sets), draws, _KEPT, math.ceil(scale * _UNTIL))
        raced = yield from run_phase(self._with(race, race.draws), session)
        return [each.measurement_times for each in raced]

    def _candidates(
        self, session: RunSession
    ) -> Generator[WorkBatch, None, tuple[list[Times], int]]:
        """The candidates for exact errors, and their number: all, or the best of the ranking."""
        most = most_if_exact(self.feasible)
        lines = self.even.lines(most * 10)
        sets = [] if any(line.apart for line in lines) else [*self.even.of(lines)]
        if 0 < len(sets) <= most:
            return sets, 0
        ranked, tried = yield from self._ranked(session)
        return ranked[:most], tried

    def _ranked(self, session: RunSession) -> Generator[WorkBatch, None, tuple[list[Times], int]]:
        """Candidates, the best first, and how many there were; 0 if these are all."""
        programme = yield from self.programme(session)
        if programme is not None:
            return ranking(self.even, programme, _RANKED)
        spread = int(self.steps / 2 / (_COARSE_DRAWS * self._a_draw * 2.5))
        refine = Refine(self.even, max(8, min(spread, 60)))
        draws = max(_COARSE_DRAWS, self.phase.criterion.fewest)
        coarse = replace(self._with(refine, draws), name=coarse_of(self.name))
        found = yield from run_phase(coarse, session)
        return [each.measurement_times for each in found], len(found)

    def programme(self, session: RunSession) -> Generator[WorkBatch, None, Programme | None]:
        """The first programme of the relaxation; None if there is none, or it takes too long."""
        built, phase, feasible = self.built, self.phase, self.feasible
        if phase.name in session.known:
            return session.known[phase.name]
        if not built.job.criterion.additive or built.job.criterion.by_instant:
            return None
        blocks = _RANKING_DRAWS // BLOCK
        most = int(self.steps / 2 / (_RANKING_DRAWS * self._a_draw) * (feasible.horizon + 1))
        try:
            relaxation = first_relaxation(
                feasible, feasible.measurements, built.evaluator.lag, most
            )
        except JobError:
            return None
        if relaxation.offsets[-1] > most and not built.evaluator.exact:
            return None
        counted = np.flatnonzero(np.diff(relaxation.offsets)).tolist()
        windows = [
            Candidate(
                relaxation.filtered(relaxation.windows[number]),
                int(relaxation.ends[number]),
                since=int(relaxation.first[number]),
            )
            for number in counted
        ]
        evaluations, _ = yield from evaluated_by_errors(
            windows, session, phase.sums, blocks, phase.purpose
        )
        errors = np.concatenate([each.errors_of_instants for each in evaluations])
        session.later(partial(session.store.settle, "error_sums", phase.name))
        programme = Programme(relaxation, np.nan_to_num(errors, nan=np.inf), relaxation.total)
        session.known[phase.name] = programme
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
    found, errors = even.of(lines), dict[Times, float]()
    for level in range(1 + _LEVELS):
        new = [times for times in found if times not in errors]
        errors.update(zip(new, programme.of_sets(new).tolist(), strict=True))
        best = sorted(found, key=errors.__getitem__)[:_NEAR]
        near = [each for times in best for each in even.near(found[times])]
        if not near or level == _LEVELS:
            break
        found = {**even.of(near), **found}
    ranked = sorted(errors, key=errors.__getitem__)
    return ranked, len(ranked) if any(line.apart for line in lines) else 0


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
    """The most particle-steps of the opponents; the scan of numbers may take as many again."""
    planned = sum(search_steps(built, search) for search in built.searches)
    proved = _PROVED if built.job.criterion.bound != "none" else 1
    return SHARE * proved * (planned + comparison_steps(built))


def opponent_steps(built: Built) -> float:
    """Approximate number of particle-steps of all opponents."""
    return most_steps(built) if built.study.even and built.evaluator.has_particles else 0.0


def best_evenly_spaced(session: RunSession, name: str) -> Generator[WorkBatch, None, Opponent]:
    """The best evenly spaced set of this name."""
    return (yield from _search_of(session.built, name).best(session))


def _search_of(built: Built, name: str) -> EvenSearch:
    given = {
        each: times
        for each, times in built.job.given_sets.items()
        if times is not None and built.study.even[name].allows(times)
    }
    return EvenSearch(built, name, built.study.even[name], {} if built.job.budget else given)


# --- how many do as well --------------------------------------------------------------------------

DRAWS, _WITH_CONTROL = 1000, 400  # at most: the first of the comparison
_FEW = 250  # of a look; they also judge, if the difference is so clear
_LEAST = 0.25  # of these numbers of draws, which a limit of work may reduce
_CLEAR = 0.999
_LOOKED = 3  # sets of a number that a look filters, on as few draws
_LINES, _FEW_LINES = 1000, 300  # of a number; fewer, if it is only looked up in the ranking
_NEXT, _FAR = 40, 12  # numbers after N that are looked up, one by one and then further apart
_JUDGED = 4  # numbers on the draws of the comparison, at most
_TOO_LONG = (
    "How many evenly spaced measurements do as well is not estimated: it would take more than 5 % "
    "of the work."
)


def is_known(built: Built) -> bool:
    """Whether a run has a single plan, and any number of its measurements can be evenly spaced."""
    problem, is_alone = built.job.problem, len(built.searches) == 1 and built.job.budget is None
    is_free = problem.feasible.counted and not problem.is_constrained
    return is_alone and is_free and problem.points.ways == 1 and built.job.criterion.is_mean


def compare_evenly_spaced(session: RunSession, run: Run) -> Generator[WorkBatch, None, None]:
    """Find how many evenly spaced measurements do as well, and write the table ``evenly_spaced``.

    Looks on separate draws bisect the numbers. On the draws of the comparison, the smallest number
    that does as well and the one below it are judged, each with independent filter noise, then
    larger numbers until one does as well. Nothing is written if the plan's error is not finite, or
    if the looks would take too long.
    """
    built, name = session.built, session.built.searches[0].name
    measured, feasible = measured_of(run), built.feasible
    session.reporter.begin("evenly spaced times")
    scale = _scale_of(built)
    if scale < _LEAST:
        session.say(Detail(_TOO_LONG))
        return
    error = controlled_mse(run.table("comparison", _draws_of(built, scale)), name)
    exact = built.evaluator.expected_mse([measured[name]])
    mean = float(np.nanmean(error) if exact is None else exact[0])
    if not math.isfinite(mean):
        return
    scan = _Scan(session, measured[name], error, mean, math.ceil(scale * _FEW))
    if (given := built.job.comparison.reference_name) in (EVEN, REGULAR):
        scan.ranked[feasible.measurements] = [measured[given]]
    scan.programme = yield from EvenSearch(built, EVEN, feasible, {}).programme(session)
    yield from scan.judge()
    rows = [
        {
            "measurements": number,
            "measurement_times": scan.sets[number],
            "draws": 0 if exact is not None else int(difference.degrees) + 1,
            "difference": difference.value,
            "difference_error": difference.standard_error,
            "plan_mse": mean,
        }
        for number, difference in sorted(scan.judged.items())
    ]
    table = pa.Table.from_pylist(rows, schema=schema("evenly_spaced", "plan_mse"))
    session.store.renew("evenly_spaced", EVEN_PHASE, table)


def _draws_of(built: Built, scale: float) -> int:
    """The number of draws that judge a number: fewer with a control, whose variance is lower."""
    return math.ceil(scale * (_WITH_CONTROL if built.job.comparison.control else DRAWS))


def _scale_of(built: Built) -> float:
    """The share of the usual numbers of draws that the limit of work allows, at most 1."""
    if built.evaluator.exact:
        return 1.0
    feasible, looking = built.feasible, settings_of(built).estimation
    looks = math.log2(2 + feasible.horizon - feasible.measurements) * (1 + _LOOKED) * _FEW
    judged = 2 * _draws_of(built, 1.0) * built.comparing.particles
    judged *= 1 + bool(built.job.comparison.control)
    steps = (looks * looking.steps_an_instant + judged) * (feasible.horizon + 1)
    return min(1.0, most_steps(built) / steps)


class _Scan:
    """Looks at evenly spaced sets of several numbers, and what they have found so far."""

    def __init__(
        self,
        session: RunSession,
        plan: Times,
        errors: NDArray[np.float64],
        mean: float,
        draws: int,
    ) -> None:
        self.session, self.built, self.plan = session, session.built, plan
        self.errors, self.mean, self.draws = errors, mean, draws  # draws of a look
        self.programme: Programme | None = None
        self.ranked = dict[int, list[Times]]()  # the best sets of a number by the programme
        self.sets = dict[int, Times]()  # the best set of a number that was looked at
        self.looked, self.judged = dict[int, Estimate](), dict[int, Estimate]()
        self.first, self.last = self.built.feasible.measurements, self.built.feasible.horizon + 1

    @property
    def _numbers(self) -> list[int]:
        """Numbers from N up to all instants: the next ones, and some of those beyond."""
        near = min(self.last, self.first + _NEXT)
        far = np.geomspace(near, self.last, _FAR).round().astype(int).tolist()
        return sorted({*range(self.first, near + 1), *far})

    def judge(self) -> Generator[WorkBatch, None, None]:
        """Judge the smallest number that does as well, those beside it, and suspicious others.

        A bisection supposes that more measurements do better. The ranking has the numbers that
        do not: smaller ones that look as good, and larger ones that look worse. With exact errors
        all numbers are judged.
        """
        if self.built.evaluator.exact:
            for number in self._numbers:
                yield from self._judge(number)
            return
        low, high = self.first - 1, self.last  # one does worse, and one as well
        at = self.first
        while high - low > 1:
            looked = yield from self._look(at)
            low, high = (low, at) if looked.value <= AS_WELL * self.mean else (at, high)
            at = (low + high) // 2
        ranked = {number: self._relaxed(number) for number in self._numbers}
        limit = self._relaxed(high)
        smaller = [n for n, error in ranked.items() if n < high - 1 and error <= limit]
        larger = [n for n, error in ranked.items() if n > high and error > limit * (1 + AS_WELL)]
        for number in (*smaller[:1], *range(max(self.first, high - 1), self.last + 1)):
            difference = yield from self._judge(number)
            if sign_of(difference, self.mean) < 0 or len(self.judged) == _JUDGED:
                break
        for number in larger[:1]:
            yield from self._judge(number)

    def _relaxed(self, number: int) -> float:
        """The least relaxed error of a number."""
        if self.programme is None:
            return 0.0
        return float(self.programme.of_sets(self._sets(number, _FEW_LINES)).min())

    def _sets(self, number: int, lines: int) -> list[Times]:
        feasible = self.built.job.feasible(number)
        if not self.built.job.comparison.is_even:
            return [feasible.regular()]
        even = EvenSets(feasible)
        return [*even.of(even.lines(lines))]

    def _best_of(self, number: int) -> list[Times]:
        """The best evenly spaced sets of a number by the programme, or regular times."""
        most = most_if_exact(self.built.feasible) if self.built.evaluator.exact else _LOOKED
        if number not in self.ranked:
            sets = self._sets(number, _LINES)
            if self.programme is not None:
                order = np.argsort(self.programme.of_sets(sets), kind="stable")
                sets = [sets[place] for place in order.tolist()]
            self.ranked[number] = sets[:most]
        return self.ranked[number]

    def _look(self, number: int) -> Generator[WorkBatch, None, Estimate]:
        """How far the best set of a number lies above the plan's error, on separate draws."""
        built, sets = self.built, self._best_of(number)
        exact = built.evaluator.expected_mse(sets)
        if exact is not None:
            instants = len(sets) * (built.feasible.horizon + 1)
            self.session.count_exact(EVEN_PHASE, "scan", instants)
            differences = [*map(Estimate, (exact - self.mean).tolist())]
        else:
            errors = np.empty((self.draws, 1 + len(sets)))

            def learn(piece: FilterWork, result: Result) -> None:
                errors[slice(*piece.draws)] = result.mse

            seed = built.job.seed
            work = built.evaluator.work(
                [self.plan, *sets],
                stream_of("shortlist", seed, "numbers", "filter"),
                stream_of("shortlist", seed, "numbers", "draws"),
                (0, self.draws),
                settings_of(built).estimation,
            )
            yield WorkBatch(self.session, EVEN_PHASE, [work], None, learn, part="scan")
            differences = [*map(Estimate.of_mean, (errors[:, 1:] - errors[:, :1]).T)]
        values = [np.nan_to_num(each.value, nan=np.inf) for each in differences]
        best = int(np.argmin(values))
        self.sets[number], self.looked[number] = sets[best], differences[best]
        return differences[best]

    def _judge(self, number: int) -> Generator[WorkBatch, None, Estimate]:
        """How far the error of a number lies above the plan's, on the draws of the comparison."""
        if number not in self.looked:
            yield from self._look(number)
        is_exact = self.built.evaluator.exact
        self.judged[number] = (
            self.looked[number] if is_exact else (yield from self._judged(self.sets[number]))
        )
        return self.judged[number]

    def _judged(self, times: Times) -> Generator[WorkBatch, None, Estimate]:
        built, draws = self.built, len(self.errors)
        seed, purpose = built.job.seed, built.study.purpose
        even = np.empty(draws)

        def learn(piece: FilterWork, result: Result) -> None:
            errors = result.mse - result.control if piece.controlled else result.mse
            even[slice(*piece.draws)] = errors[:, 0]

        work = built.evaluator.work(
            [times],
            stream_of(purpose, seed, "filter", f"evenly spaced {len(times)}"),
            stream_of(purpose, seed, "draws"),
            (0, draws),
            built.comparing,
        )
        work = replace(work, controlled=bool(built.job.comparison.control))
        first = 0
        for last, confidence in ((min(self.draws, draws), _CLEAR), (draws, CONFIDENCE)):
            some = replace(work, draws=(first, last))
            yield WorkBatch(self.session, EVEN_PHASE, [some], None, learn, part="scan")
            apart = even[:last] - self.errors[:last]
            difference, first = Estimate.of_mean(apart[~np.isnan(apart)]), last
            if first == draws or sign_of(difference, self.mean, confidence):
                break
        return difference
