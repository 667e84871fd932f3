"""Draws that a rule measures: the tuning of the rule, and its errors on the comparison's draws.

The threshold depends on the particles, because few particles spread differently. So a rule is
tuned with the filter that judges it, on draws that no comparison uses. All rules share these draws
and the noise of their filters.
"""

import math
from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times
from pfdist.common.streams import stream_of
from pfdist.filters.estimate import Evaluation
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.one_filter import OneFilter
from pfdist.filters.work import FilterWork, Result
from pfdist.kernels.rules import Rule
from pfdist.problem.feasible import Feasible
from pfdist.results import Moments
from pfdist.runner.build import Built
from pfdist.runner.door import RunSession, WorkBatch
from pfdist.runner.row_formats import PER_DRAW
from pfdist.store import RULE_PHASE

TUNING_DRAWS = 3000
ONE_SIDED = 1.645
"""Standard errors by which the mean number of measurements stays below the budget: 95 %."""
_STEP, _STEPS = 1.002, 4096  # between two thresholds that are tried, and their number, 2^12
_EXPONENTS = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)
_FACTORS = (0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1)
_NEAR = ((-0.25, 0.0, 0.25), (0.95, 1.0, 1.05))  # steps of exponent and threshold at the end
# Factors of one sensor's threshold, with which the ratios of thresholds are searched. The last of
# the first round lets the sensor never measure.
_RATIOS = (0.25, 0.5, 2.0, 4.0, math.inf), (0.7, 1.4), (0.84, 1.2)
_FEW = 3  # of so many draws, one takes part in this search
_GUESSES = 200  # draws that show how large z is

Array = NDArray[np.float64]
Ratios = tuple[float, ...]


class RuleWork(FilterWork):
    """Draws with a rule; the second of two columns has what it spends: a number, or a price.

    So both are stored by the draw, as errors are. The sets are the points that may be measured.
    """

    def result(self, evaluator: Evaluator) -> Result:
        """The MSE of each draw, and what the rule spends for it, (D, 2)."""
        if evaluator.scenarios:
            return evaluator.filtered(self)
        draws = evaluator.draws(range(*self.draws), self.draws_stream)
        sets, ends, (stream, _) = self.measurement_times[:1], self.ends[:1], self.filter_streams
        found = evaluator.filter_sets(draws, sets, ends, stream, self.estimation)
        prices = self.estimation.prices[-found.measured.shape[1] :]
        values = np.column_stack([found.mse, found.measured @ np.array(prices)])
        return Result(values, degenerate=np.repeat(found.degenerate, 2, axis=1))


def budget_of(feasible: Feasible) -> float:
    """The budget of a rule: a number of measurements, or money."""
    number, money = feasible.measurement_budget, feasible.total_price
    return float(money or 0) if number is None else number


def prices_of(feasible: Feasible) -> tuple[float, ...]:
    """The price of each point; 1 if measurements are counted."""
    return tuple(map(float, feasible.price or (1,) * feasible.possible))


def apart_of(feasible: Feasible) -> Times:
    """For each instant, the first that may be measured after it; empty if nothing is too near."""
    points, spacing = feasible.points, feasible.spacing
    first = range(0, feasible.possible, points.ways)
    return () if spacing.is_free else tuple(points.instant(spacing.after(t)) for t in first)


def judged_work(built: Built, rule: Rule, draws: int) -> RuleWork:
    """The work of a rule on the first draws of the comparison."""
    return _work(built, rule, draws, built.study.purpose)


def _work(built: Built, rule: Rule, draws: int, purpose: str) -> RuleWork:
    evaluator, feasible = built.evaluator, built.feasible
    noise, of_draws = (
        stream_of(purpose, built.job.seed, *role) for role in (["filter", "rule"], ["draws"])
    )
    estimation = replace(
        built.comparing, rule=rule, apart=apart_of(feasible), prices=prices_of(feasible)
    )
    parts = feasible.allowed, noise, of_draws
    ids = [evaluator.id_of(estimation, *parts, what) for what in ("mse", "spent")]
    sets = [feasible.allowed] * 2
    work = evaluator.work(sets, noise, of_draws, (0, draws), estimation, ids=tuple(ids))
    return RuleWork(**vars(work))


class RuledDraw(NamedTuple):
    """One draw that a rule measures; a measured instant comes twice, before and after it."""

    draw: int
    z: Array  # (T+1, q)
    measured: list[int]
    instants: list[int]  # (K,)
    mean: Array  # (K, q): the filter's estimate
    variance: Array  # (K, q)
    level: Array  # (K, sensors): of the rule


def followed(evaluator: Evaluator, work: RuleWork, draw: int) -> RuledDraw:
    """One draw of a work, with the spread that its filter sees before each measurement."""
    here, rule = range(draw, draw + 1), work.estimation.rule or Rule(())
    numbers = evaluator.scenarios_of(work.draws_stream, here)
    own = evaluator if numbers is None else evaluator.of_scenarios[numbers[0]]
    draws, (noise, _) = own.draws(here, work.draws_stream), work.filter_streams
    (found,) = own.filter_each(draws, work.measurement_times[:1], [noise], work.estimation)
    bits = found.measured.reshape(draws.z.shape[1], -1)
    measured = (np.flatnonzero(bits.any(axis=1)) + own.start).tolist()
    paid = bits * np.reshape(work.estimation.prices[-bits.size :], bits.shape)
    spent = np.cumsum([0.0, *paid.sum(axis=1)])  # before each instant
    settings = replace(own.settings(work.estimation), rule=None, lag=0)
    filtering = OneFilter(own.believed, settings, noise, draw, own.computed_by.name)
    path, means, variances = list[int](), list[Array](), list[Array]()
    for number, t in enumerate([*measured, own.horizon]):
        _, mean, variance = filtering.at(t)
        path += range(filtering.t, t + 1)
        means, variances = [*means, mean], [*variances, variance]
        if number < len(measured):
            y = draws.y[0, t - own.start].copy()
            for part, is_made in zip(own.believed.parts, bits[t - own.start], strict=True):
                y[part.y] = y[part.y] if is_made else np.nan
            filtering, _, _ = filtering.at(t, y)
    levels = [rule.levels(own.horizon + 1 - t, spent[t - own.start]) for t in path]
    return RuledDraw(
        draw, draws.z[0], measured, path, np.concatenate(means), np.concatenate(variances),
        np.array(levels),
    )  # fmt: skip


def filtered_by(
    session: RunSession, works: Sequence[RuleWork]
) -> Generator[WorkBatch, None, list[Array]]:
    """For each rule (3, D): errors, what it spends, and which draws are degenerate.

    Finished draws are in the store.
    """
    found, reporter = {work.ids: np.empty((3, work.draws[1])) for work in works}, session.reporter

    def learn(piece: FilterWork, result: Result) -> None:
        here = slice(*piece.draws)
        found[piece.ids][:2, here], found[piece.ids][2, here] = (
            result.mse.T,
            result.degenerate[:, 0],
        )
        before, draws = reporter.progress, len(range(*piece.draws))
        reporter.reach(before.done + piece.steps, evaluations=before.evaluations + draws)

    yield WorkBatch(session, RULE_PHASE, works, PER_DRAW, learn, more_follows=True)
    return [found[work.ids] for work in works]


def tuned(
    session: RunSession, *, is_hard: bool, draws: int = TUNING_DRAWS
) -> Generator[WorkBatch, None, Rule]:
    """The rule that spends most, but clearly at most the budget on average.

    With a hard limit, the rule of least error among those that never spend more.
    """
    built, budget, ways = (
        session.built,
        budget_of(session.built.feasible),
        session.built.feasible.points.ways,
    )
    ratio = (built.evaluator.horizon + 1 - built.evaluator.start) / budget
    ratios, few = (1.0,) * ways, max(2, draws // _FEW)
    first = _work(built, Rule(ratios), draws, "rule")
    built.evaluator.compile(first.estimation)  # before the first task, whose time is limited
    rounds = 1 + math.log2(_STEPS)
    hard = len(_EXPONENTS) * len(_FACTORS) + len(_NEAR[0]) * len(_NEAR[1])
    searched = (ways > 1) * ways * sum(map(len, _RATIOS)) / _FEW
    session.reporter.foresee(first.steps * (rounds * (1 + searched) + is_hard * hard))
    session.reporter.begin("rule")  # after the forecast: at 0 %

    def on_common_draws(
        rules: list[Rule], number: int = draws
    ) -> Generator[WorkBatch, None, list[Array]]:
        works = [_work(built, each, number, "rule") for each in rules]
        return (yield from filtered_by(session, works))

    def error(mse: Array) -> float:
        return built.job.criterion.value(Evaluation((), mse)).value

    def try_on(rule: Rule, number: int) -> Generator[WorkBatch, None, tuple[bool, float]]:
        """Whether a rule keeps the budget, and its error."""
        ((mse, spent, _),) = yield from on_common_draws([rule], number)
        mean = Moments.of_values(spent)
        return mean.mean + ONE_SIDED * mean.standard_error <= budget, error(mse)

    def lowest(ratios: Ratios, number: int) -> Generator[WorkBatch, None, tuple[float, float]]:
        """The error and the common factor of the lowest thresholds that keep the budget."""
        low, high, least = 0, _STEPS, math.inf
        while high - low > 1:  # the first is high enough, and the last is taken to be too low
            middle = (low + high) // 2
            rule = _rule(largest / _STEP**middle, ratios)
            is_kept, found = yield from try_on(rule, number)
            low, high, least = (middle, high, found) if is_kept else (low, middle, least)
        return least, _rounded(largest / _STEP**low)

    any_draws = (built.evaluator.of_scenarios or (built.evaluator,))[0]
    z = any_draws.draws(range(_GUESSES), first.draws_stream).z
    largest = 4.0 * float(np.sqrt(np.mean(np.var(z, axis=0).sum(axis=1)))) or 1.0
    while not (yield from try_on(_rule(largest, ratios), draws))[0]:
        largest *= 8.0  # a filter with another model may be more unsure than z varies
    if ways > 1:
        ratios = yield from _best_ratios(ways, lambda ratios: lowest(ratios, few))
    _, threshold = yield from lowest(ratios, draws)
    if not is_hard:
        return _rule(threshold, ratios)
    best = math.inf, threshold, 0.0
    for exponents, factors in ((_EXPONENTS, _FACTORS), _NEAR):
        _, threshold, exponent = best
        pairs = [
            (max(0.0, exponent + k * max(1.0, exponent)), factor * threshold * ratio**exponent)
            for k, factor in product(exponents, factors)
        ]
        tried = [(_rounded(c / ratio**k), k) for k, c in dict.fromkeys(pairs)]
        found_by = yield from on_common_draws([_rule(c, ratios, k, budget) for c, k in tried])
        errors = (error(mse) for mse, _, _ in found_by)
        best = min(best, *((e, *pair) for e, pair in zip(errors, tried, strict=True)))
    return _rule(best[1], ratios, best[2], budget)


def _best_ratios(
    ways: int, lowest: Callable[[Ratios], Generator[WorkBatch, None, tuple[float, float]]]
) -> Generator[WorkBatch, None, Ratios]:
    """The ratios of the sensors' thresholds of least error, the smallest 1, by coordinates."""
    best = (1.0,) * ways
    errors = {best: (yield from lowest(best))[0]}
    for factors, sensor in product(_RATIOS, range(ways)):
        around = best
        for factor in factors:
            changed = [r * factor if s == sensor else r for s, r in enumerate(around)]
            if math.isfinite(least := min(changed)):
                ratios = tuple(each / least for each in changed)
                if ratios not in errors:
                    errors[ratios], _ = yield from lowest(ratios)
                best = min(best, ratios, key=errors.__getitem__)
    return best


def _rule(threshold: float, ratios: Ratios, exponent: float = 0.0, limit: float = 0.0) -> Rule:
    return Rule(tuple(_rounded(threshold * ratio) for ratio in ratios), exponent, limit)


def _rounded(threshold: float) -> float:
    return float(f"{threshold:.4g}")
