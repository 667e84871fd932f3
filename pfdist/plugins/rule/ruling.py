"""Draws that a rule measures: the tuning of the rule, and its errors on the comparison's draws.

The threshold depends on the particles, because few particles spread differently. So a rule is
tuned with the filter that judges it, on draws that no comparison uses. All rules share these draws
and the noise of their filters.
"""

import math
from bisect import bisect_left
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from itertools import pairwise, product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times
from pfdist.common.streams import stream_of
from pfdist.constraints.apart import Apart
from pfdist.filters.estimate import Evaluation
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.interface import EACH_DRAW, weighed
from pfdist.filters.work import FilterWork, Result
from pfdist.kernels.follows import ROUNDING
from pfdist.kernels.left import Left
from pfdist.kernels.rules import ALWAYS, NEVER, Applied, Thresholds
from pfdist.plugins.rule.needs import RULES
from pfdist.plugins.rule.thresholds import (
    TURNS,
    Points,
    ThresholdSweep,
    Trial,
    Tried,
    at_price,
    point_groups,
)
from pfdist.problem.feasible import Feasible
from pfdist.results import Moments
from pfdist.results.stored_run import StoredRun, measured_of, provenance_of
from pfdist.runner.build import Built
from pfdist.runner.door import RunSession, WorkBatch
from pfdist.runner.driver import QuickLook
from pfdist.runner.row_formats import PER_DRAW
from pfdist.store import RULE_PHASE, Store, add_to_provenance

TUNING_DRAWS = 3000
ONE_SIDED = 1.645
"""Standard errors by which the mean number of measurements stays below the budget: 95 %."""
_RANGE, _HALVINGS = 1.002**4096, 12  # of the thresholds that are tried: to 0.2 %
# Steps of the exponent, and factors of the threshold, that are tried with a hard limit
_HARD = (
    ((0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0), (0.6, 0.8, 1.0)),
    ((-0.25, 0.0, 0.25), (0.95, 1.0, 1.05)),
)
# Factors of one sensor's threshold, with which the ratios of thresholds are searched. The last of
# the first round lets the sensor never measure.
_RATIOS = (0.25, 0.5, 2.0, 4.0, math.inf), (0.7, 1.4), (0.84, 1.2)
_FEW = 3  # of so many draws, one takes part in the search
_SWEEPS = (300, 1), (600, 1), (1000, 1), (1000, 2), (1000, 3)  # draws, and how many decide together
_FEW_PARTICLES, _LEAST_PARTICLES = 5, 100  # one of so many takes part in sweeps; and at least
_MOST_GROUPS = 64  # of points; longer horizons have thresholds for several instants
_LAST = 2  # so many sweeps give a rule each, between which errors decide
_LOOKED = 100, 300  # draws of a look that seek the threshold: fewest and most
_TRIALS_OF_LOOK = 2 + _HALVINGS + 2 * _FEW  # of so many draws each
_CLEARLY = 2.0  # standard errors by which a rule must be better than the plan
_AROUND, _NARROW = (0.4, 2.5), 8  # factors of thresholds: ends, halvings
# Ends of the prices of a measurement, in errors of one with constant thresholds:
_PRICES = 1 / 32, 4.0
_GAPS = 3  # a change of a sweep counts for so many mean distances between measurements
_GUESSES = 200  # draws that show how large z is

Array = NDArray[np.float64]
Candidates = Callable[[Thresholds], Iterable[Thresholds]]


class RuleWork(FilterWork):
    """Draws with a rule: their errors, and what it spends for them, a number or a price.

    So all columns are stored by the draw, as errors are. The sets are the points that may be
    measured; the ends are those of the columns.
    """

    def result(self, evaluator: Evaluator) -> Result:
        """For E ends, the MSE of each draw, and what the rule spends for it: (D, 2 E)."""
        applied = self.estimation.rule
        if evaluator.scenarios or applied is None:
            return evaluator.filtered(self)
        draws = evaluator.draws(range(*self.draws), self.draws_stream)
        ends, wanted = self.ends[: len(self.ids) // 2], EACH_DRAW if len(self.ids) > 3 else ""
        largest = self.measurement_times[len(ends) - 1 : len(ends)], ends[-1:]
        given = *largest, self.filter_streams[0], self.estimation
        found = evaluator.filter_sets(draws, *given, wanted)
        columns, points, spent = [found.mse], evaluator.points, list[Array]()
        if wanted:
            sums = np.cumsum(weighed(found.errors[:, 0], draws.instant_weights), axis=1)
            columns = [sums[:, [end - evaluator.start for end in ends]] / sums.shape[1]]
        left = Left(applied.follows, points.ways, (), evaluator.horizon + 1, draws=len(found.mse))
        measured = [*enumerate(found.measured.T, points.first(evaluator.start))]
        for before, end in pairwise((-1, *ends)):
            for point, each in measured:
                if before < points.instant(point) <= end:
                    left.take(point, each > 0)
            spent.append(left.spent)
        columns += [np.transpose(spent), found.deviation]
        values = np.column_stack(columns[: 2 + (applied.flipped is not None)])
        return Result(values, degenerate=np.repeat(found.degenerate, len(self.ids), axis=1))


def work_of(
    built: Built,
    rule: Thresholds,
    draws: int,
    purpose: str = "",
    particles: int = 0,
    sweep: int | None = None,
    flipped: int | None = None,
    ends: Points = (),
) -> RuleWork:
    """The work of a rule on the first draws of a purpose, by default of the comparison.

    Each sweep has separate draws. With a flipped point, the deviations there are a column, too.
    Errors and measurements count up to each of some ends, by default the horizon.
    """
    purpose, evaluator, feasible = purpose or built.study.purpose, built.evaluator, built.feasible
    number = [] if sweep is None else [sweep]
    noise, of_draws = (
        stream_of(purpose, built.job.seed, *role, *number)
        for role in (["filter", "rule"], ["draws"])
    )
    estimation = replace(
        built.comparing, rule=Applied(rule, feasible.step_limits, flipped),
        particles=particles or built.comparing.particles,
    )  # fmt: skip
    parts = feasible.allowed, noise, of_draws
    # A work is stored or lacking as a whole, so no other work has one of its ids.
    own = [(*ends, end) for end in ends] or [()]
    columns = [(what, *end) for what in ("mse", "spent") for end in own]
    columns += [("deviation", *ends)] * (flipped is not None)
    ends = ends or (evaluator.horizon,)
    ids = tuple(evaluator.id_of(estimation, *parts, *what) for what in columns)
    of_columns = (*ends, *ends, ends[-1])[: len(columns)]
    firsts = [feasible.points.first(end + 1) for end in of_columns]
    sets = [feasible.allowed[: bisect_left(feasible.allowed, first)] for first in firsts]
    given = sets, noise, of_draws, (0, draws), estimation
    return RuleWork(**vars(evaluator.work(*given, ids=ids, ends=of_columns)))


class RuledDraw(NamedTuple):
    """One draw that a rule measures; a measured instant comes twice, before and after it."""

    draw: int
    measured: list[int]
    instants: list[int]  # (K,)
    deviation: Array  # (K,): of the filter
    level: Array  # (K, sensors): of the rule


def followed(evaluator: Evaluator, work: RuleWork, draw: int) -> RuledDraw:
    """One draw of a work, with the spread that its filter sees before each measurement."""
    rule, follows, _ = work.estimation.rule or Applied(Thresholds(()))
    noise, *_ = work.filter_streams
    numbers = evaluator.scenarios_of(work.draws_stream, range(draw, draw + 1))
    own = evaluator if numbers is None else evaluator.of_scenarios[numbers[0]]
    draws, points = own.draws(range(draw, draw + 1), work.draws_stream), own.points
    (found,) = own.filter_each(draws, work.measurement_times[:1], [noise], work.estimation)
    chosen = (np.flatnonzero(found.measured) + points.first(own.start)).tolist()
    arrive, estimation = [*points.instants(chosen)], replace(work.estimation, rule=None)
    ends, first, end = [*arrive, own.horizon + 1], own.start, own.horizon + 1
    sets = [tuple(p for p in chosen if points.instant(p) < end) for end in ends]
    path, variances, levels = list[int](), list[Array](), list[list[float]]()
    left, delays = Left(follows, points.ways, (), end), follows.delays
    made_at = [points.instant(p) - (delays[points.way(p)] if delays else 0) for p in chosen]
    filters = replace(own, lag=0).filter_each(draws, sets, [noise] * len(sets), estimation)
    for end, each in zip(ends, filters, strict=True):
        here = range(first, min(end, own.horizon) + 1)
        path, first = [*path, *here], end
        variances.append(each.variance[0, here.start - own.start : here.stop - own.start])
        for t in here:
            left.take([p for p, made in zip(chosen, made_at, strict=True) if made < t])
            levels.append(rule.levels(points.at(t), own.horizon + 1 - t, float(left.spent[0])))
    deviation = np.sqrt(np.concatenate(variances).sum(axis=1))
    return RuledDraw(draw, sorted({*made_at}), path, deviation, np.array(levels))


def filtered_by(
    session: RunSession, *works: RuleWork, phase: str = RULE_PHASE
) -> Generator[WorkBatch, None, list[Array]]:
    """The columns of each work, and which draws are degenerate: (3, D), or (4, D).

    Finished draws are in the store. A phase has its own files, so that few rows are read.
    """
    reporter = session.reporter
    found = {work.ids: np.empty((len(work.ids) + 1, work.draws[1])) for work in works}

    def learn(piece: FilterWork, result: Result) -> None:
        own, here = found[piece.ids], slice(*piece.draws)
        own[:-1, here], own[-1, here] = result.mse.T, result.degenerate[:, 0]
        before, draws = reporter.progress, len(range(*piece.draws))
        reporter.reach(before.done + piece.steps, evaluations=before.evaluations + draws)

    yield WorkBatch(session, phase, works, PER_DRAW, learn, more_follows=True, part="rule")
    return [found[work.ids] for work in works]


def settle_rules(store: Store) -> None:
    """Put the rows of rules into few files."""
    for table in ("draws", "timings"):
        for phase in store.phases_of(table, RULE_PHASE):
            store.settle(table, phase)


def look_work(built: Built, most: float) -> tuple[int, int]:
    """The number of draws of `look` that so many particle-steps allow, and its particle-steps.

    Both are 0 if they allow too few, or if the run has several plans or numbers of measurements.
    """
    if RULES.lacks(built.job, built.evaluator) or len(built.searches) > 1 or built.job.amounts:
        return 0, 0
    a_draw = _TRIALS_OF_LOOK * work_of(built, Thresholds((1.0,)), 1, "rule").steps
    fewest, largest = _LOOKED
    draws = min(largest, int(most / a_draw))
    return (draws, draws * a_draw) if draws >= fewest else (0, 0)


def look_at_a_rule(
    session: RunSession, run: StoredRun, most: float
) -> Generator[WorkBatch, None, None]:
    """Keep a sentence about what deciding on the way may win, for every answer of the run.

    It is empty unless one threshold for all instants is clearly better than the plan.
    """
    key, built, criterion = "on_the_way", session.built, session.built.job.criterion
    draws, steps = look_work(built, most)
    if not draws or key in provenance_of(run):
        return
    plan = measured_of(run)[built.searches[0].name]
    session.reporter.foresee(steps)
    search = _Search(session, _FEW * draws, len(plan), is_hard=False)
    session.reporter.begin("rule")
    _, rule = yield from search.constant(())
    pair = yield from search.compared(rule, rule_of_set(plan, built.feasible))
    sentence = ""
    if criterion.difference(*pair).is_negative(_CLEARLY):
        own, planned = (criterion.value(each).value for each in pair)
        sentence = (
            "Decided on the way, as many measurements have less error: about "
            f"{100 * (1 - own / planned):.0f} % less with a single threshold for all times (quick "
            "estimate; `pfdist rule` tunes one for each)."
        )
    session.commit()
    settle_rules(session.store)
    add_to_provenance(run.path, {key: sentence})


LOOK = QuickLook("rule", look_work, look_at_a_rule)


def tuned(
    session: RunSession, plan: Times, *, is_hard: bool, draws: int = TUNING_DRAWS
) -> Generator[WorkBatch, None, Thresholds]:
    """The rule of least error that spends at most the budget on average, or with a hard limit.

    The search starts with the best constant threshold of each sensor. If the criterion is the
    expected MSE, sweeps give each point its threshold, from the better of this and of the plan.
    The answer is the plan if no rule is clearly better, on draws that chose none.
    """
    search = _Search(session, draws, len(plan), is_hard=is_hard)
    search.foresee()
    planned = rule_of_set(plan, session.built.feasible)
    best = yield from search.best(planned)
    planned = planned._replace(limit=best.limit)
    pair = yield from search.compared(best, planned)
    difference = session.built.job.criterion.difference(*pair)
    return best if difference.is_negative(_CLEARLY) else planned


class _Search:
    """The search for a rule, on the first draws of the purpose "rule", and on those of sweeps."""

    def __init__(self, session: RunSession, draws: int, planned: int, *, is_hard: bool) -> None:
        self._session, self._built, self._draws = session, session.built, draws
        self._number = max(1, planned)
        feasible, evaluator = session.built.feasible, session.built.evaluator
        self._budget, self._is_hard = feasible.budget, is_hard
        self._few, self._every = max(2, draws // _FEW), range(feasible.possible)
        self._even = Thresholds((1.0,) * feasible.points.ways)
        self._sweeps = _SWEEPS if session.built.job.criterion.is_mean else ()
        self._groups = point_groups(feasible.optional, feasible.points.ways, _MOST_GROUPS)
        self._first = work_of(session.built, self._even, draws, "rule")
        evaluator.compile(self._first.estimation)  # before the first task, whose time is limited
        own = self._first.estimation.particles
        self._particles = max(own // _FEW_PARTICLES, min(own, _LEAST_PARTICLES))
        any_draws = (evaluator.of_scenarios or (evaluator,))[0]
        z = any_draws.draws(range(_GUESSES), self._first.draws_stream).z
        self._largest = 4.0 * float(np.sqrt(np.mean(np.var(z, axis=0).sum(axis=1)))) or 1.0

    def foresee(self) -> None:
        """Tell the reporter how much work the whole search has."""
        session, is_hard, first = self._session, self._is_hard, self._first
        ways = len(self._even.thresholds)
        ratios = sum(map(len, _RATIOS)) * ways * (ways > 1)
        grid = is_hard * sum(len(steps) * len(factors) for steps, factors in _HARD)
        trials = (1 + _HALVINGS) * (1 + ratios) + _NARROW * len(self._sweeps) + grid
        ends = self._ends(self._even)
        until_ends = float(np.mean(ends) + 1) / (max(ends) + 1)
        a_sweep = until_ends * len(self._groups) + TURNS + _NARROW
        sweeps = sum(number for number, _ in self._sweeps) * a_sweep
        of_all = sweeps * self._particles / first.estimation.particles / TUNING_DRAWS
        session.reporter.foresee(first.steps * (trials / _FEW + _NARROW + 4 + of_all))
        session.reporter.begin("rule")  # after the forecast: at 0 %

    def best(self, planned: Thresholds) -> Generator[WorkBatch, None, Thresholds]:
        """The rule of least error that keeps the budget, or the limit."""
        error, best = yield from self.constant(_RATIOS)
        self._sweeps = self._sweeps if math.isfinite(error) else ()
        found, constant = {best: error}, self._of_points(best)
        is_worse = self._sweeps and (yield from self._tried(planned, self._few))[0] >= error
        rule = constant if is_worse else planned
        changes: Mapping[Points, Any] = {}
        usual = price = error / self._budget
        for number in range(len(self._sweeps)):
            left = len(self._sweeps) - number
            if self._is_hard and left == _LAST:  # these sweeps know the limit
                error, best = yield from self._limited(min(found, key=found.__getitem__))
                found, rule, price, changes = {best: error}, self._of_points(best), 0.0, {}
            rule, price, changes = yield from self._swept(number, rule, price, usual, changes)
            if rule.limit:
                found[rule] = yield from self._error_of(rule)
            elif left <= _LAST + self._is_hard:
                error, each = yield from self._lowest(rule, self._few, _AROUND, _NARROW)
                found[each] = error
        order = sorted(found, key=found.__getitem__)
        if self._is_hard:
            return order[0] if self._sweeps else (yield from self._limited(order[0]))[1]
        for each in order:
            error, best = yield from self._lowest(each, self._draws, _AROUND, _NARROW + 2)
            if error < math.inf:
                break
        return best

    def compared(self, *rules: Thresholds) -> Generator[WorkBatch, None, list[Evaluation]]:
        """Evaluations of rules on separate draws."""
        works = (work_of(self._built, each, self._draws, "rule", sweep=-1)
                 for each in rules)  # fmt: skip
        values = yield from self._values(works, "choice")
        return [Evaluation((), each.mse[0]) for each in values]

    def constant(
        self, rounds: Iterable[Iterable[float]]
    ) -> Generator[WorkBatch, None, tuple[float, Thresholds]]:
        """The best threshold of each sensor for all instants, and its error.

        Each round has factors of the thresholds of single sensors; without any, these are equal.
        """
        while not (yield from self._tried(self._even.scaled(self._largest), self._few))[1]:
            self._largest *= 8.0  # a filter with another model may be more unsure than z varies
        sensors = range(len(self._even.thresholds) if len(self._even.thresholds) > 1 else 0)
        ratios = [partial(_with_ratios, sensor, factors)
                  for factors, sensor in product(rounds, sensors)]  # fmt: skip
        best = yield from _least(self._even, ratios, self._error_of)
        return (yield from self._lowest(best, self._few, self._wide, _HALVINGS))

    def _limited(self, rule: Thresholds) -> Generator[WorkBatch, None, tuple[float, Thresholds]]:
        """The best exponent with a hard limit, with the best multiple of the thresholds."""
        evaluator = self._built.evaluator
        instants = evaluator.horizon + 1 - evaluator.start
        around = [partial(_around, instants, *steps) for steps in _HARD]
        best = yield from _least(rule._replace(limit=self._budget), around, self._error_of)
        return (yield from self._error_of(best)), best

    @property
    def _wide(self) -> tuple[float, float]:
        return self._largest / _RANGE, self._largest

    def _of_points(self, rule: Thresholds) -> Thresholds:
        return rule._replace(thresholds=tuple(rule.thresholds_of(self._every).tolist()))

    def _values(
        self, works: Iterable[RuleWork], part: str
    ) -> Generator[WorkBatch, None, list[Tried]]:
        found = yield from filtered_by(self._session, *works, phase=f"{RULE_PHASE}.{part}")
        ends = [(len(each) - 1) // 2 for each in found]
        return [Tried(each[:number], each[number : 2 * number], each[-2])
                for each, number in zip(found, ends, strict=True)]  # fmt: skip

    def _tried(
        self, rule: Thresholds, number: int
    ) -> Generator[WorkBatch, None, tuple[float, bool]]:
        """The error on the first common draws, and whether a rule keeps the budget."""
        works = [work_of(self._built, rule, number, "rule")]
        # One phase for all numbers of draws, because its rows are unique: whether those of fewer
        # draws are found or computed again depends on when they were committed.
        (found,) = yield from self._values(works, "tuning")
        mean = Moments.of_values(found.spent[0])
        most = mean.mean + ONE_SIDED * mean.standard_error
        error = self._built.job.criterion.value(Evaluation((), found.mse[0])).value
        return error, most <= self._budget * (1 + ROUNDING)

    def _lowest(
        self, rule: Thresholds, number: int, ends: tuple[float, float], halvings: int
    ) -> Generator[WorkBatch, None, tuple[float, Thresholds]]:
        """The lowest multiple of the thresholds that keeps the budget, and its error."""
        low, high = ends
        error, is_kept = yield from self._tried(rule.scaled(high), number)
        if not is_kept:
            return math.inf, rule
        for _ in range(halvings):
            middle = math.sqrt(low * high)
            found, is_kept = yield from self._tried(rule.scaled(middle), number)
            low, high, error = (low, middle, found) if is_kept else (middle, high, error)
        return error, rule.scaled(high)

    def _error_of(self, rule: Thresholds) -> Generator[WorkBatch, None, float]:
        """The error of a rule with a limit, or of ratios of thresholds."""
        given = rule, self._few
        found = self._tried(*given) if rule.limit else self._lowest(*given, self._wide, _HALVINGS)
        return (yield from found)[0]

    def _on_draws(self, number: int, *trials: Trial) -> Generator[WorkBatch, None, list[Tried]]:
        """Results of trials on the separate draws of a sweep, with few particles."""
        draws = max(2, self._draws * self._sweeps[number][0] // TUNING_DRAWS)
        given = draws, "rule", self._particles, number
        works = (work_of(self._built, each.rule, *given, each.flipped, each.ends)
                 for each in trials)  # fmt: skip
        return (yield from self._values(works, f"sweep{number}"))

    def _swept(
        self,
        number: int,
        rule: Thresholds,
        price: float,
        usual: float,
        changes: Mapping[Points, Any],
    ) -> Generator[WorkBatch, None, tuple[Thresholds, float, Mapping[Points, Any]]]:
        """A rule after a sweep, its price, and all changes; a rule with a limit has no price."""
        *_, pooled = self._sweeps[number]
        sweep = ThresholdSweep(rule, self._groups, price, self._ends(rule), pooled, changes)
        state, rng = sweep.init(), np.random.default_rng([self._built.job.seed, number])
        while not sweep.done(state):
            state = sweep.ask(state, rng)
            state = sweep.tell(state, (yield from self._on_draws(number, *state.trials)))
        if rule.limit:
            return state.rule, price, state.changes
        low, high = (usual * factor for factor in _PRICES)
        for _ in range(_NARROW):
            middle = math.sqrt(low * high)
            trial = Trial(at_price(state.rule, state.changes, middle))
            (found,) = yield from self._on_draws(number, trial)
            low, high = (middle, high) if found.spent.mean() > self._budget else (low, middle)
        return at_price(state.rule, state.changes, high), high, state.changes

    def _ends(self, rule: Thresholds) -> list[int]:
        """For each point, the last instant whose error counts in a sweep.

        A limit leaves what is not spent to all later instants, as does a largest number or a price
        that is paid once; and a smoothed estimate uses later measurements.
        """
        evaluator, feasible = self._built.evaluator, self._built.feasible
        points, window = feasible.points, evaluator.horizon + 1
        lasts = any(step.kind != Apart.kind for step in feasible.steps)
        if not (rule.limit or evaluator.lag or lasts):
            window = math.ceil(_GAPS * (window - evaluator.start) / self._number)
        return [min(evaluator.horizon, points.instant(p) + window - 1) for p in self._every]


def rule_of_set(times: Times, feasible: Feasible) -> Thresholds:
    """The rule that always measures at the times of a set, and never elsewhere."""
    measured = np.isin(range(feasible.possible), times)
    return Thresholds(tuple(np.where(measured, ALWAYS, NEVER).tolist()))


def _least(
    rule: Thresholds,
    rounds: Iterable[Candidates],
    error: Callable[[Thresholds], Generator[WorkBatch, None, float]],
) -> Generator[WorkBatch, None, Thresholds]:
    """The rule of least error among the candidates of each round around the best so far."""
    errors = dict[Thresholds, float]()
    for candidates in rounds:
        for each in (rule, *candidates(rule)):
            if each not in errors:
                errors[each] = yield from error(each)
        rule = min(errors, key=errors.__getitem__)
    return rule


def _with_ratios(sensor: int, factors: Iterable[float], rule: Thresholds) -> Iterator[Thresholds]:
    """Rules with another threshold of a sensor, the smallest threshold 1."""
    for factor in factors:
        changed = [c * factor if s == sensor else c for s, c in enumerate(rule.thresholds)]
        if math.isfinite(min(changed)):
            yield Thresholds(tuple(c / min(changed) for c in changed))


def _around(
    instants: int, steps: Iterable[float], factors: Iterable[float], rule: Thresholds
) -> Iterator[Thresholds]:
    """Rules with other exponents, and about the same level at the beginning."""
    for step, factor in product(steps, factors):
        exponent = max(0.0, rule.exponent + step * max(1.0, rule.exponent))
        ratio = (instants / rule.limit) ** (rule.exponent - exponent)
        yield rule._replace(exponent=exponent).scaled(factor * ratio)
