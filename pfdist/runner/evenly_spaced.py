"""How many evenly spaced measurements do as well as the plan: a quick estimate."""

import math
from collections.abc import Generator
from dataclasses import replace

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from pfdist.common.estimate import CONFIDENCE, Estimate
from pfdist.common.measurement_times import EVEN, REGULAR, Times
from pfdist.common.streams import stream_of
from pfdist.filters.exact import exact_mse
from pfdist.filters.work import FilterWork, Result
from pfdist.problem.even_sets import even_sets
from pfdist.results import Run
from pfdist.results.evenly_spaced import AS_WELL, sign_of
from pfdist.results.moments import controlled_mse
from pfdist.results.stored_run import measured_of
from pfdist.runner.build import Built
from pfdist.runner.door import RunSession, WorkBatch
from pfdist.runner.opponent import EvenSearch, most_if_exact, settings_of
from pfdist.runner.progress import Detail
from pfdist.search.programme import Programme
from pfdist.store import EVEN_PHASE, schema

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
    problem, is_alone = built.job.problem, len(built.searches) == 1 and not built.job.amounts
    is_free = problem.feasible.counted and not problem.is_constrained
    return is_alone and is_free and problem.points.ways == 1 and built.job.criterion.is_mean


def compare_evenly_spaced(
    session: RunSession, run: Run, most_steps: float
) -> Generator[WorkBatch, None, None]:
    """Find how many evenly spaced measurements do as well, and write the table ``evenly_spaced``.

    Looks on separate draws bisect the numbers. On the draws of the comparison, the smallest number
    that does as well and the one below it are judged, each with independent filter noise, then
    larger numbers until one does as well. Nothing is written if the plan's error is not finite, or
    if the looks would take too long.
    """
    built, name = session.built, session.built.searches[0].name
    measured, feasible = measured_of(run), built.feasible
    session.reporter.begin("evenly spaced times")
    scale = _scale_of(built, most_steps)
    if scale < _LEAST:
        session.say(Detail(_TOO_LONG))
        return
    error = controlled_mse(run.table("comparison", _draws_of(built, scale)), name)
    exact = exact_mse(built.evaluator, [measured[name]])
    mean = float(np.nanmean(error) if exact is None else exact[0])
    if not math.isfinite(mean):
        return
    scan = _Scan(session, measured[name], error, mean, math.ceil(scale * _FEW))
    if (given := built.job.comparison.reference_name) in (EVEN, REGULAR):
        scan.given[feasible.measurements] = [measured[given]]
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
    table = pa.Table.from_pylist(rows, schema=schema("evenly_spaced"))
    session.store.renew("evenly_spaced", EVEN_PHASE, table)


def _draws_of(built: Built, scale: float) -> int:
    """The number of draws that judge a number: fewer with a control, whose variance is lower."""
    return math.ceil(scale * (_WITH_CONTROL if built.job.comparison.control else DRAWS))


def scan_steps(built: Built, most_steps: float) -> float:
    """The most particle-steps of `compare_evenly_spaced`; 0 if it is left out."""
    if not is_known(built) or built.evaluator.exact or _scale_of(built, most_steps) < _LEAST:
        return 0.0
    return min(_usual_steps(built), most_steps)


def _scale_of(built: Built, most_steps: float) -> float:
    """The share of the usual numbers of draws that the limit of work allows, at most 1."""
    return 1.0 if built.evaluator.exact else min(1.0, most_steps / _usual_steps(built))


def _usual_steps(built: Built) -> float:
    """The particle-steps with the usual numbers of draws, if none is judged early."""
    feasible, looking = built.feasible, settings_of(built).estimation
    looks = math.log2(2 + feasible.horizon - feasible.measurements) * (1 + _LOOKED) * _FEW
    judged = 2 * _draws_of(built, 1.0) * built.comparing.particles
    judged *= 1 + bool(built.job.comparison.control)
    return (looks * looking.steps_an_instant + judged) * (feasible.horizon + 1)


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
        self.given = dict[int, list[Times]]()  # the known best sets of a number
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
        even = even_sets(feasible)
        return [*even.sets_of(even.lines(lines))] or [feasible.regular()]  # on an uneven clock

    def _best_of(self, number: int) -> list[Times]:
        """The best evenly spaced sets of a number by the programme, or regular times."""
        if number in self.given:
            return self.given[number]
        most = most_if_exact(self.built.feasible) if self.built.evaluator.exact else _LOOKED
        sets = self._sets(number, _LINES)
        if self.programme is not None:
            order = np.argsort(self.programme.of_sets(sets), kind="stable")
            sets = [sets[place] for place in order.tolist()]
        return sets[:most]

    def _look(self, number: int) -> Generator[WorkBatch, None, Estimate]:
        """How far the best set of a number lies above the plan's error, on separate draws."""
        built, sets = self.built, self._best_of(number)
        exact = exact_mse(built.evaluator, sets)
        if exact is not None:
            instants = len(sets) * (built.feasible.horizon + 1)
            self.session.count_exact(EVEN_PHASE, "scan", instants)
            differences = [*map(Estimate, (exact - self.mean).tolist())]
        else:
            seed = built.job.seed
            work = built.evaluator.work(
                [self.plan, *sets],
                stream_of("shortlist", seed, "numbers", "filter"),
                stream_of("shortlist", seed, "numbers", "draws"),
                (0, self.draws),
                settings_of(built).estimation,
            )
            errors = yield from self._filtered(work)
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
        work = built.evaluator.work(
            [times],
            stream_of(purpose, seed, "filter", f"evenly spaced {len(times)}"),
            stream_of(purpose, seed, "draws"),
            (0, draws),
            built.comparing,
        )
        work = replace(work, controlled=bool(built.job.comparison.control))
        errors = np.empty((0, 1))
        for last, confidence in ((min(self.draws, draws), _CLEAR), (draws, CONFIDENCE)):
            more = yield from self._filtered(replace(work, draws=(len(errors), last)))
            errors = np.concatenate([errors, more])
            differences = errors[:, 0] - self.errors[:last]
            difference = Estimate.of_mean(differences[~np.isnan(differences)])
            if last == draws or sign_of(difference, self.mean, confidence):
                break
        return difference

    def _filtered(self, work: FilterWork) -> Generator[WorkBatch, None, NDArray[np.float64]]:
        """The error of each draw with each set, less its control if there is one, (D, S)."""
        first, last = work.draws
        errors = np.empty((last - first, len(work.measurement_times)))

        def learn(piece: FilterWork, result: Result) -> None:
            found = result.mse - result.control if piece.controlled else result.mse
            errors[piece.draws[0] - first : piece.draws[1] - first] = found

        yield WorkBatch(self.session, EVEN_PHASE, [work], None, learn, part="scan")
        return errors
