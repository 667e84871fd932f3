"""Draws that a rule measures: the tuning of the rule, and its errors on the comparison's draws.

The threshold depends on the particles, because few particles spread differently. So a rule is
tuned with the filter that judges it, on draws that no comparison uses. All rules share these draws
and the noise of their filters.
"""

import math
from collections.abc import Generator, Sequence
from dataclasses import replace
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pfdist.common.streams import stream_of
from pfdist.filters.evaluator import Evaluator
from pfdist.filters.one_filter import OneFilter
from pfdist.filters.work import FilterWork, Result
from pfdist.kernels.rules import Rule
from pfdist.results import Moments
from pfdist.runner.build import Built
from pfdist.runner.door import RunSession, WorkBatch
from pfdist.runner.row_formats import PER_DRAW
from pfdist.store import RULE_PHASE

TUNING_DRAWS = 3000
ONE_SIDED = 1.645
"""Standard errors by which the mean number of measurements stays below the budget: 95 %."""
_STEP, _STEPS = 1.002, 4096  # between two thresholds that are tried, and their number, 2^12
_EXPONENTS, _FACTORS = (0.0, 0.5, 1.0, 2.0, 4.0), (0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1)
_NEAR = ((-0.25, 0.0, 0.25), (0.95, 1.0, 1.05))  # steps of exponent and threshold at the end
_GUESSES = 200  # draws that show how large z is

Array = NDArray[np.float64]


class RuleWork(FilterWork):
    """Draws with a rule; the second of two columns has their numbers of measurements.

    So both are stored by the draw, as errors are. The sets are the instants that may be measured.
    """

    def result(self, evaluator: Evaluator) -> Result:
        """The MSE of each draw, and its number of measurements, (D, 2)."""
        if evaluator.scenarios:
            return evaluator.filtered(self)
        draws = evaluator.draws(range(*self.draws), self.draws_stream)
        sets, ends, (stream, _) = self.measurement_times[:1], self.ends[:1], self.filter_streams
        found = evaluator.filter_sets(draws, sets, ends, stream, self.estimation)
        values = np.column_stack([found.mse, found.measured.sum(axis=1)])
        return Result(values, degenerate=np.repeat(found.degenerate, 2, axis=1))


def judged_work(built: Built, rule: Rule, draws: int) -> RuleWork:
    """The work of a rule on the first draws of the comparison."""
    return _work(built, rule, draws, built.study.purpose)


def _work(built: Built, rule: Rule, draws: int, purpose: str) -> RuleWork:
    evaluator, candidates = built.evaluator, built.feasible.allowed
    noise, of_draws = (
        stream_of(purpose, built.job.seed, *role) for role in (["filter", "rule"], ["draws"])
    )
    spacing = built.feasible.spacing
    apart = () if spacing.is_free else spacing.successors
    estimation = replace(built.comparing, rule=rule, apart=apart)
    parts = candidates, noise, of_draws
    ids = [evaluator.id_of(estimation, *parts, what) for what in ("mse", "number")]
    sets = [candidates, candidates]
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
    level: Array  # (K,): of the rule


def followed(evaluator: Evaluator, work: RuleWork, draw: int) -> RuledDraw:
    """One draw of a work, with the spread that its filter sees before each measurement."""
    here, rule = range(draw, draw + 1), work.estimation.rule or Rule(math.inf)
    numbers = evaluator.scenarios_of(work.draws_stream, here)
    own = evaluator if numbers is None else evaluator.of_scenarios[numbers[0]]
    draws, (noise, _) = own.draws(here, work.draws_stream), work.filter_streams
    (found,) = own.filter_each(draws, work.measurement_times[:1], [noise], work.estimation)
    measured = (np.flatnonzero(found.measured[0]) + own.start).tolist()
    settings = replace(own.settings(work.estimation), rule=None, lag=0)
    filtering = OneFilter(own.believed, settings, noise, draw, own.computed_by.name)
    path, means, variances = list[tuple[int, float]](), list[Array](), list[Array]()
    for spent, t in enumerate([*measured, own.horizon]):
        _, mean, variance = filtering.at(t)
        ahead = range(filtering.t, t + 1)
        path += [(at, rule.level(own.horizon + 1 - at, spent)) for at in ahead]
        means, variances = [*means, mean], [*variances, variance]
        if spent < len(measured):
            filtering, _, _ = filtering.at(t, draws.y[0, t - own.start])
    instants, levels = zip(*path, strict=True)
    return RuledDraw(
        draw, draws.z[0], measured, [*instants], np.concatenate(means), np.concatenate(variances),
        np.array(levels),
    )  # fmt: skip


def filtered_by(
    session: RunSession, works: Sequence[RuleWork]
) -> Generator[WorkBatch, None, list[Array]]:
    """For each rule (3, D): errors, numbers of measurements, and which draws are degenerate.

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
    """The rule with the most measurements that are clearly at most N on average.

    With a hard limit, the rule of least error among those that never measure more than N times.
    """
    built, budget = session.built, session.built.feasible.total
    ratio = (built.evaluator.horizon + 1 - built.evaluator.start) / budget
    first = _work(built, Rule(math.inf), draws, "rule")
    built.evaluator.compile(first.estimation)  # before the first task, whose time is limited
    hard = len(_EXPONENTS) * len(_FACTORS) + len(_NEAR[0]) * len(_NEAR[1])
    session.reporter.foresee(first.steps * (1 + math.log2(_STEPS) + is_hard * hard))
    session.reporter.begin("rule")  # after the forecast: at 0 %

    def on_common_draws(rules: list[Rule]) -> Generator[WorkBatch, None, list[Array]]:
        works = [_work(built, each, draws, "rule") for each in rules]
        return (yield from filtered_by(session, works))

    def keeps_budget(threshold: float) -> Generator[WorkBatch, None, bool]:
        ((_, numbers, _),) = yield from on_common_draws([Rule(threshold)])
        mean = Moments.of_values(numbers)
        return mean.mean + ONE_SIDED * mean.standard_error <= budget

    any_draws = (built.evaluator.of_scenarios or (built.evaluator,))[0]
    z = any_draws.draws(range(_GUESSES), first.draws_stream).z
    largest = 4.0 * float(np.sqrt(np.mean(np.var(z, axis=0).sum(axis=1)))) or 1.0
    while not (yield from keeps_budget(_rounded(largest))):
        largest *= 8.0  # a filter with another model may be more unsure than z varies
    low, high = 0, _STEPS
    while high - low > 1:  # the first is high enough, and the last is taken to be too low
        middle = (low + high) // 2
        is_kept = yield from keeps_budget(_rounded(largest / _STEP**middle))
        low, high = (middle, high) if is_kept else (low, middle)
    threshold = _rounded(largest / _STEP**low)
    if not is_hard:
        return Rule(threshold)
    best = math.inf, Rule(threshold, 0.0, budget)
    for exponents, factors in ((_EXPONENTS, _FACTORS), _NEAR):
        rule = best[1]
        pairs = [
            (max(0.0, k + rule.exponent), factor * rule.threshold * ratio**rule.exponent)
            for k, factor in product(exponents, factors)
        ]
        rules = [Rule(_rounded(c / ratio**k), k, budget) for k, c in dict.fromkeys(pairs)]
        found_by = yield from on_common_draws(rules)
        errors = (float(np.mean(mse)) for mse, _, _ in found_by)
        best = min(best, *zip(errors, rules, strict=True))
    return best[1]


def _rounded(threshold: float) -> float:
    return float(f"{threshold:.4g}")
