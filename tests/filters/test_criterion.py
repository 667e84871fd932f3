"""Criteria against closed forms, and one that the program does not know."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from scipy import stats

import pfdist
from oracles.walks import SCENARIOS, WALK, WEIGHTS
from pfdist.common.estimate import Estimate
from pfdist.errors import JobError
from pfdist.filters import kalman
from pfdist.filters.criterion import MEAN, Criterion, WorstScenario
from pfdist.filters.estimate import Evaluation
from pfdist.problem.job import Job
from pfdist.runner.bound_settings import BoundSettings
from pfdist.runner.build import build
from pfdist.runner.prover import Prover

RNG = np.random.default_rng(4)
MSE, OTHER = RNG.exponential(2.0, (2, 120))
NUMBERS = np.tile([0, 1, 2], 40)
WORST = WorstScenario(apart=3)


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
    first = _evaluation([1.0, 5.0, 3.0, 7.0], WorstScenario(apart=2), scenarios=numbers)
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
    mean, worst = (built.evaluator.expected_mse(sets, criterion=each) for each in (MEAN, WORST))
    np.testing.assert_allclose(mean, np.average(apart, axis=0, weights=WEIGHTS), rtol=1e-14)
    assert worst is not None
    assert worst.tolist() == apart.max(axis=0).tolist()
    for criterion, value in ((MEAN, mean), (WORST, worst)):
        over_time = built.evaluator.exact_over_time(sets[0], criterion)
        assert over_time is not None
        assert over_time.mean() == pytest.approx(value[0], rel=1e-14)


# --- a new criterion is a new form, and nothing else ----------------------------------------------


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
