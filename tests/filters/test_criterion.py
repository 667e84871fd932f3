"""Criteria against closed forms, and one that the program does not know."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from scipy import stats

import pfdist
from oracles.in_turn import in_turn
from oracles.walks import SCENARIOS, WALK, WEIGHTS
from pfdist.common.estimate import Estimate
from pfdist.errors import JobError
from pfdist.filters import kalman
from pfdist.filters.criteria.information import GAP, LOWER_SIDE, Information
from pfdist.filters.criteria.quantile import Quantile
from pfdist.filters.criteria.worst_instant import WorstInstant
from pfdist.filters.criterion import (
    MEAN,
    Criterion,
    OtherCriterion,
    Sample,
    WorstScenario,
    criterion_named,
)
from pfdist.filters.estimate import Evaluation
from pfdist.filters.exact import exact_mse, exact_over_time
from pfdist.problem.job import Job
from pfdist.runner.bound_settings import BoundSettings
from pfdist.runner.build import build
from pfdist.runner.prover import Prover

RNG = np.random.default_rng(4)
MSE, OTHER = RNG.exponential(2.0, (2, 120))
NUMBERS = np.tile([0, 1, 2], 40)
WORST = WorstScenario(scenario_count=3)


def _evaluation(mse: Any, criterion: Criterion = MEAN, **others: Any) -> Evaluation:
    return Evaluation((1,), np.array(mse), criterion=criterion, **others)


def test_the_mean_and_its_paired_difference_have_the_errors_of_the_textbook() -> None:
    first, second = _evaluation(MSE), _evaluation(OTHER)
    assert first.estimate == Estimate(np.mean(MSE), pytest.approx(stats.sem(MSE)), 119)
    apart = first.difference(second)
    assert apart.value / apart.standard_error == pytest.approx(
        stats.ttest_rel(MSE, OTHER).statistic
    )


def test_clouds_alone_are_independent() -> None:
    """Draws of a cloud are alike: the error is that of the means of the clouds."""
    of_clouds = MSE.reshape(6, 20).mean(axis=1)
    clouds = _evaluation(MSE, clouds=6)
    assert clouds.estimate == Estimate(np.mean(MSE), pytest.approx(stats.sem(of_clouds)), 5)
    apart = clouds.difference(_evaluation(OTHER, clouds=6))
    others = OTHER.reshape(6, 20).mean(axis=1)
    assert apart.standard_error == pytest.approx(stats.sem(of_clouds - others))


@pytest.mark.parametrize("mse", [[], [math.nan, 1.0], [1.0, math.inf]])
def test_an_unknown_value_is_infinite_and_equals_another(mse: list[float]) -> None:
    assert _evaluation(mse).estimate == Estimate(math.inf, math.inf)
    assert _evaluation(mse).difference(_evaluation([math.inf])).value == 0.0
    assert _evaluation([1.0, 2.0]).difference(_evaluation(mse)).value == -math.inf


def test_the_worst_scenario_is_the_largest_mean_and_differences_are_paired_in_it() -> None:
    numbers = np.array([0, 1, 0, 1])
    first = _evaluation([1.0, 5.0, 3.0, 7.0], WorstScenario(scenario_count=2), scenarios=numbers)
    # of 5 and 7: sd sqrt(2), over sqrt(2)
    assert (first.expected_mse, first.standard_error) == (6.0, pytest.approx(1.0))
    apart = first.difference(replace(first, mse=np.array([1.0, 4.0, 3.0, 6.5])))
    assert (apart.value, apart.standard_error) == (0.75, pytest.approx(0.25))
    elsewhere = replace(first, mse=np.array([9.0, 1.0, 11.0, 3.0]))  # scenario 0 is its worst
    apart = first.difference(elsewhere)
    assert (apart.value, apart.standard_error) == (-4.0, pytest.approx(np.sqrt(2)))


def test_a_scenario_of_infinite_errors_is_the_worst() -> None:
    mse = np.where((NUMBERS == 1) & (np.arange(120) > 60), np.inf, MSE)
    assert _evaluation(mse, WORST, scenarios=NUMBERS).expected_mse == math.inf
    assert _evaluation(MSE, WORST, scenarios=NUMBERS).judged_by(MEAN).expected_mse == np.mean(MSE)


def test_exact_values_have_no_error_and_stay_if_another_criterion_judges() -> None:
    first, second = (Evaluation.exactly((1,), value, WORST) for value in (3.5, 1.25))
    assert (first.estimate, first.draws) == (Estimate(3.5), 0)
    assert first.difference(second) == Estimate(2.25)
    assert first.judged_by(MEAN).estimate == Estimate(3.5)
    assert (first.criterion.label, first.criterion.additive) == (WORST.label, False)


def test_exact_scenarios_give_the_weighted_mean_or_the_worst() -> None:
    scenarios = {"parameters": SCENARIOS, "weights": WEIGHTS, "filter": "told"}
    problem = pfdist.Problem(WALK, horizon=9, measurement_budget=3, engine="kalman")
    built = build(problem.with_changes(scenarios=scenarios).job())
    sets = [(0, 4, 9), (2,), ()]
    apart = np.array([
        kalman.expected_mse(WALK.with_parameters(each), 9, sets) for each in SCENARIOS
    ])  # fmt: skip
    mean, worst = (exact_mse(built.evaluator, sets, criterion=each) for each in (MEAN, WORST))
    np.testing.assert_allclose(mean, np.average(apart, axis=0, weights=WEIGHTS), rtol=1e-14)
    assert worst is not None
    assert worst.tolist() == apart.max(axis=0).tolist()
    for criterion, value in ((MEAN, mean), (WORST, worst)):
        over_time = exact_over_time(built.evaluator, sets[0], criterion)
        assert over_time is not None
        assert over_time.mean() == pytest.approx(value[0], rel=1e-14)


# --- quantiles of the MSE ------------------------------------------------------------------------

Q90 = criterion_named("quantile 0.9")
REPETITIONS = 200
# Intervals of 95 % hold at least so often, but for chance (once in a thousand).
LEAST = stats.binom.ppf(0.001, REPETITIONS, 0.95)


def _draws(*shape: int) -> Any:
    """Exponential variates of mean 1 in each repetition."""
    return np.random.default_rng(1).exponential(1.0, (REPETITIONS, *shape))


def _holds(judged: tuple[float, float, float], truth: float) -> bool:
    _, low, high = judged
    return low <= truth <= high


@pytest.mark.parametrize("share", [0.05, 0.5, 0.9, 0.99])
@pytest.mark.parametrize("count", [1, 20, 100, 1001])
def test_the_ends_are_order_statistics_with_95_percent_of_the_binomial_between(
    share: float, count: int
) -> None:
    """David and Nagaraja, section 7.1; the 0th is 0, and the one after the last infinite."""
    ranks = np.random.default_rng(1).permutation(np.arange(1.0, count + 1))
    value, *ends = Quantile(share=share).of_sample(Sample(ranks))
    low, high = (min(end, count + 1) for end in ends)
    below = stats.binom(count, share)
    assert below.cdf(high - 1) - below.cdf(low - 1) >= 0.95
    assert below.cdf(high - 2) - below.cdf(low) < 0.95  # neither end can be nearer
    assert value == math.ceil(share * count)


def test_the_interval_of_a_quantile_holds() -> None:
    draws, truth = _draws(100), -math.log(0.1)
    assert isinstance(Q90, OtherCriterion)
    assert sum(_holds(Q90.of_sample(Sample(mse)), truth) for mse in draws) >= LEAST


def test_the_paired_bootstrap_holds_for_a_known_difference() -> None:
    """Two gamma variates with a common part; one is a fifth lower."""
    own, other, common = np.moveaxis(_draws(200, 3), 2, 0)
    pairs = [*zip(0.8 * (own + common), other + common, strict=True)]
    assert isinstance(Q90, OtherCriterion)
    changes = [Q90.change(Sample(first), Sample(second)) for first, second in pairs]
    assert sum(_holds(each, 0.2) for each in changes) >= LEAST
    truth = -0.2 * stats.gamma(2).ppf(0.9)
    apart = [
        _evaluation(first, Q90).difference(_evaluation(second, Q90)) for first, second in pairs
    ]
    assert sum(abs(each.value - truth) < 1.96 * each.standard_error for each in apart) >= LEAST


def test_a_quantile_of_infinite_errors_is_infinite() -> None:
    mse = np.where(np.arange(120) < 20, math.inf, MSE)
    assert _evaluation(mse, Q90).estimate == Estimate(math.inf, math.inf)
    assert math.isfinite(_evaluation(mse, criterion_named("quantile 0.5")).expected_mse)


# --- the worst instant ----------------------------------------------------------------------------

WORST_INSTANT = WorstInstant()


def _of_groups(groups: Any) -> Evaluation:
    return Evaluation((1,), np.empty(0), groups=np.array(groups), criterion=WORST_INSTANT)


def test_limits_of_the_worst_instant_hold_where_instants_tie() -> None:
    """The maximum of estimates is too large, most of all where all instants have one error."""
    errors = _draws(400, 12)
    judged = [WORST_INSTANT.of_sample(_sample(each)) for each in errors]
    values = np.array([each.value for each in judged])
    assert np.mean(values) - 1.0 > 10 * stats.sem(values)
    assert sum(_holds(each, 1.0) for each in judged) >= LEAST
    pairs = zip(errors[1:], errors, strict=False)
    changes = [WORST_INSTANT.change(_sample(a), _sample(1.25 * b)) for a, b in pairs]
    assert sum(_holds(each, 0.2) for each in changes) >= LEAST


def _sample(errors: Any) -> Sample:
    return Sample(np.empty(0), errors.mean(axis=0), stats.sem(errors), len(errors) - 1)


def test_a_change_from_few_draws_has_no_end_beyond_what_errors_allow() -> None:
    """Limits from two draws lie below 0, and an error does not."""
    own, other = _sample(np.array([[0.5], [0.9]])), _sample(np.array([[0.8], [1.4]]))
    assert WORST_INSTANT.of_sample(own).low < 0.0
    value, low, high = WORST_INSTANT.change(own, other)
    assert (low, high) == (-math.inf, 1.0)
    assert value == pytest.approx(1 - 0.7 / 1.1)


def test_the_worst_instant_of_groups_and_its_jackknife() -> None:
    """If one instant is the worst of both sets, the jackknife is the paired test of its groups."""
    low, first, second = np.random.default_rng(1).normal(size=(3, 20, 1))
    first, second = (
        _of_groups(np.hstack([low, 9 + first])),
        _of_groups(np.hstack([9 + second, low])),
    )
    assert first.estimate == Estimate.of_mean(first.groups[:, 1])
    apart, pairs = first.difference(second), first.groups[:, 1] - second.groups[:, 0]
    assert apart.value == pytest.approx(pairs.mean())
    assert apart.standard_error == pytest.approx(stats.sem(pairs))
    assert apart.degrees == 19


def test_unknown_errors_of_instants_are_infinite_and_one_group_has_no_error() -> None:
    unknown = _of_groups([[1.0, math.nan], [1.0, 2.0]])
    assert (
        unknown.estimate == _evaluation(MSE, WORST_INSTANT).estimate == Estimate(math.inf, math.inf)
    )
    first, second = _of_groups([[1.0, 4.0]]), _of_groups([[3.0, 2.0]])
    assert first.difference(second).value == 1.0
    assert math.isnan(first.difference(second).standard_error)


# --- a new criterion is a new form, and nothing else ----------------------------------------------


@dataclass(frozen=True)
class LastInstant(OtherCriterion):
    """The expected error at the last instant."""

    by_instant: bool = True

    def of_instants(self, errors: Any) -> Any:
        """The last error of each set."""
        return errors[:, -1]


def test_a_criterion_of_instants_makes_the_exact_number_of_their_exact_errors() -> None:
    sets = [(0, 4, 9), (2,), ()]
    problem = pfdist.Problem(
        WALK, horizon=9, measurement_budget=3, engine="kalman", instant_weights=[1.0] * 9 + [0.0]
    )
    errors = kalman.expected_errors(WALK, 9, sets)
    numbers = exact_mse(build(problem.job()).evaluator, sets, criterion=LastInstant())
    assert numbers is not None
    np.testing.assert_allclose(numbers, errors[:, 8], rtol=1e-14)  # the last that has weight


@dataclass(frozen=True)
class Median(Criterion):
    """The median over draws; its standard error is that of a normal variate, roughly."""

    label: str = "median MSE"
    additive: bool = False
    bound: Literal["mean", "mixture", "none"] = "none"

    def value(self, errors: Evaluation) -> Estimate:
        """The median."""
        error = 1.25 * Estimate.of_mean(errors.mse).standard_error
        return Estimate(float(np.median(errors.mse)), error)


def test_a_search_minimises_a_criterion_that_no_other_module_knows(
    small_job: Job, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Job, "criterion", Median())
    changes = ["problem.horizon=6", "problem.measurement_budget=2", "comparison.draws=48"]
    section = {"method": "exhaustive", "evaluation": {"draws": 100}}
    job = small_job.with_changes(changes, sections={"search": [section]})
    run = pfdist.run(job, tmp_path / "run", figures=False)
    evaluations = run.table("evaluations").query("phase == 'exhaustive'").set_index("evaluation")
    medians = run.table("draws").groupby("evaluation")["mse"].median()[evaluations.index]
    assert evaluations["expected_mse"].tolist() == medians.tolist()
    with pytest.raises(JobError, match="no bound is known for the median MSE"):
        Prover(build(job), BoundSettings())
    found = pfdist.evaluate(job, {"a": [0, 3], "b": [1, 2]}, draws=50)
    assert [each.expected_mse for each in found.values()] == [
        np.median(each.mse) for each in found.values()
    ]


# --- information ----------------------------------------------------------------------------------

NATS = Information()


def test_an_upper_side_that_is_infinite_is_an_infinite_end() -> None:
    nats = np.random.default_rng(1).normal(2.0, 1.0, 50)
    infinite, none = np.where(np.arange(20) < 1, math.inf, 0.1), np.zeros(20)
    collapsed = Sample(nats, aspects={LOWER_SIDE: nats, GAP: infinite})
    value, low, high = NATS.of_sample(collapsed)
    assert low < value < high == math.inf
    other = Sample(nats, aspects={LOWER_SIDE: nats - 1.0, GAP: none})
    assert NATS.change(collapsed, other).high == math.inf
    assert NATS.change(other, collapsed).low == -math.inf


def test_the_upper_end_holds_if_both_sides_are_of_the_same_draws() -> None:
    """The sides have a correlation of 1, so their errors add up."""
    draws = _draws(200) - 1.0
    judged = [
        NATS.of_sample(Sample(each, aspects={LOWER_SIDE: 5.0 + each, GAP: 1.0 + each}))
        for each in draws
    ]
    for found, own in zip(judged, draws, strict=True):
        assert found.high == pytest.approx(Estimate.of_mean(6.0 + 2.0 * own).interval()[1])


@in_turn("draws", [1, 5, 24, 1000])
@in_turn("share", [0.05, 0.5, 0.9, 0.99])
def test_the_bootstrap_of_a_quantile_is_that_of_resampled_draws(draws: int, share: float) -> None:
    """The same values as with each resample written out, with ties and infinite errors, too."""
    criterion, mse = Quantile(share=share), np.random.default_rng(1).exponential(size=(3, draws))
    mse[1], mse[2, : draws // 3] = np.round(mse[1], 1), np.inf
    rng = np.random.default_rng(0)
    drawn = [mse[:, rng.integers(0, draws, draws)] for _ in range(100)]
    expected = np.stack([criterion._values(each) for each in drawn], axis=1)
    np.testing.assert_array_equal(criterion._again(mse, 100), expected)
