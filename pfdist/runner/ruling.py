"""Draws that a rule measures: the tuning of the rule, and its errors on the comparison's draws.

The threshold depends on the particles, because few particles spread differently. So a rule is
tuned with the filter that judges it, on draws that no comparison uses. All rules share these draws
and the noise of their filters.
"""

import math
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import replace
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times
from pfdist.common.streams import stream_of
from pfdist.filters.estimate import Evaluation
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.work import FilterWork, Result
from pfdist.kernels.rules import ROUNDING, Rule
from pfdist.problem.feasible import Feasible
from pfdist.results import Moments
from pfdist.runner.build import Built
from pfdist.runner.door import RunSession, WorkBatch
from pfdist.runner.row_formats import PER_DRAW
from pfdist.store import RULE_PHASE

TUNING_DRAWS = 3000
ONE_SIDED = 1.645
"""Standard errors by which the mean number of measurements stays below the budget: 95 %."""
_RANGE, _HALVINGS = 1.002**4096, 12  # of the thresholds that are tried: to 0.2 %
# Steps of the exponent, and factors of the threshold, that are tried with a hard limit
_HARD = (
    ((0.0, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0), (0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1)),
    ((-0.25, 0.0, 0.25), (0.95, 1.0, 1.05)),
)
# Factors of one sensor's threshold, with which the ratios of thresholds are searched. The last of
# the first round lets the sensor never measure.
_RATIOS = (0.25, 0.5, 2.0, 4.0, math.inf), (0.7, 1.4), (0.84, 1.2)
_FEW = 3  # of so many draws, one takes part in this search
_GUESSES = 200  # draws that show how large z is

Array = NDArray[np.float64]
Candidates = Callable[[Rule], Iterable[Rule]]


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
    return feasible.measurement_budget or float(feasible.total_price or 0)


def prices_of(feasible: Feasible) -> tuple[float, ...]:
    """The price of each point; 1 if measurements are counted."""
    return tuple(map(float, feasible.price or (1,) * feasible.possible))


def apart_of(feasible: Feasible) -> Times:
    """For each instant, the first that may be measured after it; empty if nothing is too near."""
    points, spacing = feasible.points, feasible.spacing
    first = range(0, feasible.possible, points.ways)
    return () if spacing.is_free else tuple(points.instant(spacing.after(t)) for t in first)


def work_of(built: Built, rule: Rule, draws: int, purpose: str = "") -> RuleWork:
    """The work of a rule on the first draws of a purpose, by default of the comparison."""
    purpose, evaluator, feasible = purpose or built.study.purpose, built.evaluator, built.feasible
    noise, of_draws = (
        stream_of(purpose, built.job.seed, *role) for role in (["filter", "rule"], ["draws"])
    )
    estimation = replace(
        built.comparing, rule=rule, apart=apart_of(feasible), prices=prices_of(feasible)
    )
    parts = feasible.allowed, noise, of_draws
    ids = tuple(evaluator.id_of(estimation, *parts, what) for what in ("mse", "spent"))
    work = evaluator.work([feasible.allowed] * 2, noise, of_draws, (0, draws), estimation, ids=ids)
    return RuleWork(**vars(work))


class RuledDraw(NamedTuple):
    """One draw that a rule measures; a measured instant comes twice, before and after it."""

    draw: int
    measured: list[int]
    instants: list[int]  # (K,)
    deviation: Array  # (K,): of the filter
    level: Array  # (K, sensors): of the rule


def followed(evaluator: Evaluator, work: RuleWork, draw: int) -> RuledDraw:
    """One draw of a work, with the spread that its filter sees before each measurement."""
    rule, (noise, _) = work.estimation.rule or Rule(()), work.filter_streams
    numbers = evaluator.scenarios_of(work.draws_stream, range(draw, draw + 1))
    own = evaluator if numbers is None else evaluator.of_scenarios[numbers[0]]
    draws, points = own.draws(range(draw, draw + 1), work.draws_stream), own.points
    (found,) = own.filter_each(draws, work.measurement_times[:1], [noise], work.estimation)
    chosen = (np.flatnonzero(found.measured) + points.first(own.start)).tolist()
    measured, estimation = [*points.instants(chosen)], replace(work.estimation, rule=None)
    ends, first = [*measured, own.horizon + 1], own.start
    sets = [tuple(p for p in chosen if points.instant(p) < end) for end in ends]
    path, variances, levels = list[int](), list[Array](), list[list[float]]()
    filters = replace(own, lag=0).filter_each(draws, sets, [noise] * len(sets), estimation)
    for times, end, each in zip(sets, ends, filters, strict=True):
        here = range(first, min(end, own.horizon) + 1)
        spent = sum(work.estimation.prices[point] for point in times)
        path, first = [*path, *here], end
        variances.append(each.variance[0, here.start - own.start : here.stop - own.start])
        levels += [rule.levels(own.horizon + 1 - t, spent) for t in here]
    deviation = np.sqrt(np.concatenate(variances).sum(axis=1))
    return RuledDraw(draw, measured, path, deviation, np.array(levels))


def filtered_by(session: RunSession, work: RuleWork) -> Generator[WorkBatch, None, Array]:
    """Errors, what the rule spends, and which draws are degenerate: (3, D).

    Finished draws are in the store.
    """
    found, reporter = np.empty((3, work.draws[1])), session.reporter

    def learn(piece: FilterWork, result: Result) -> None:
        here = slice(*piece.draws)
        found[:2, here], found[2, here] = result.mse.T, result.degenerate[:, 0]
        before, draws = reporter.progress, len(range(*piece.draws))
        reporter.reach(before.done + piece.steps, evaluations=before.evaluations + draws)

    yield WorkBatch(session, RULE_PHASE, [work], PER_DRAW, learn, more_follows=True, part="rule")
    return found


def tuned(
    session: RunSession, *, is_hard: bool, draws: int = TUNING_DRAWS
) -> Generator[WorkBatch, None, Rule]:
    """The rule that spends most, but clearly at most the budget on average.

    With a hard limit, the rule of least error among those that never spend more.
    """
    built, budget = session.built, budget_of(session.built.feasible)
    ways, few = built.feasible.points.ways, max(2, draws // _FEW)
    instants, even = built.evaluator.horizon + 1 - built.evaluator.start, Rule((1.0,) * ways)
    ratios = [partial(_with_ratios, sensor, factors)
              for factors, sensor in product(_RATIOS, range(ways if ways > 1 else 0))]  # fmt: skip
    around = [partial(_around, instants, *steps) for steps in _HARD]
    first = work_of(built, even, draws, "rule")
    built.evaluator.compile(first.estimation)  # before the first task, whose time is limited
    searched = (ways > 1) * ways * sum(map(len, _RATIOS)) / _FEW
    grid = is_hard * sum(len(steps) * len(factors) for steps, factors in _HARD)
    session.reporter.foresee(first.steps * ((1 + _HALVINGS) * (1 + searched) + grid))
    session.reporter.begin("rule")  # after the forecast: at 0 %

    def tried(rule: Rule, number: int) -> Generator[WorkBatch, None, tuple[float, bool]]:
        """The error on the first common draws, and whether a rule keeps the budget."""
        mse, spent, _ = yield from filtered_by(session, work_of(built, rule, number, "rule"))
        mean = Moments.of_values(spent)
        is_kept = mean.mean + ONE_SIDED * mean.standard_error <= budget * (1 + ROUNDING)
        return built.job.criterion.value(Evaluation((), mse)).value, is_kept

    def lowest(ratios: Rule, number: int) -> Generator[WorkBatch, None, tuple[float, Rule]]:
        """The lowest thresholds with some ratios that keep the budget, and their error."""
        low, high, error = largest / _RANGE, largest, math.inf  # the highest is high enough
        for _ in range(_HALVINGS):
            middle = math.sqrt(low * high)
            found, is_kept = yield from tried(_scaled(ratios, middle), number)
            low, high, error = (low, middle, found) if is_kept else (middle, high, error)
        return error, _scaled(ratios, high)

    def error_of(rule: Rule) -> Generator[WorkBatch, None, float]:
        """The error of a rule with a limit, or of ratios of thresholds."""
        found = yield from tried(rule, draws) if rule.limit else lowest(rule, few)
        return found[0]

    any_draws = (built.evaluator.of_scenarios or (built.evaluator,))[0]
    z = any_draws.draws(range(_GUESSES), first.draws_stream).z
    largest = 4.0 * float(np.sqrt(np.mean(np.var(z, axis=0).sum(axis=1)))) or 1.0
    while not (yield from tried(_scaled(even, largest), draws))[1]:
        largest *= 8.0  # a filter with another model may be more unsure than z varies
    best = yield from _least(even, ratios, error_of)
    _, best = yield from lowest(best, draws)
    return (yield from _least(best._replace(limit=budget), around, error_of)) if is_hard else best


def _least(
    rule: Rule,
    rounds: Iterable[Candidates],
    error: Callable[[Rule], Generator[WorkBatch, None, float]],
) -> Generator[WorkBatch, None, Rule]:
    """The rule of least error among the candidates of each round around the best so far."""
    errors = dict[Rule, float]()
    for candidates in rounds:
        for each in (rule, *candidates(rule)):
            if each not in errors:
                errors[each] = yield from error(each)
        rule = min(errors, key=errors.__getitem__)
    return rule


def _with_ratios(sensor: int, factors: Iterable[float], rule: Rule) -> Iterator[Rule]:
    """Rules with another threshold of a sensor, the smallest threshold 1."""
    for factor in factors:
        changed = [c * factor if s == sensor else c for s, c in enumerate(rule.thresholds)]
        if math.isfinite(min(changed)):
            yield Rule(tuple(c / min(changed) for c in changed))


def _around(
    instants: int, steps: Iterable[float], factors: Iterable[float], rule: Rule
) -> Iterator[Rule]:
    """Rules with other exponents, and about the same level at the beginning."""
    for step, factor in product(steps, factors):
        exponent = max(0.0, rule.exponent + step * max(1.0, rule.exponent))
        ratio = (instants / rule.limit) ** (rule.exponent - exponent)
        yield _scaled(rule._replace(exponent=exponent), factor * ratio)


def _scaled(rule: Rule, factor: float) -> Rule:
    return rule._replace(thresholds=tuple(float(f"{c * factor:.4g}") for c in rule.thresholds))
