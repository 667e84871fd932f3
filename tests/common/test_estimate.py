"""An estimate: its error, its intervals and its sums, against SciPy and closed forms."""

import math

import numpy as np
import pytest
from scipy import stats

from pfdist.common.estimate import Estimate, student_quantile, wilson_interval
from pfdist.results import Moments

VALUES = np.random.default_rng(5).normal(2.0, 1.0, 12)


def test_the_mean_of_values_has_the_standard_error_of_the_textbook() -> None:
    found = Estimate.of_mean(VALUES)
    assert (found.value, found.degrees) == (np.mean(VALUES), 11)
    assert found.standard_error == pytest.approx(stats.sem(VALUES), rel=1e-14)


@pytest.mark.parametrize("values", [[], [3.0], [3.0, math.inf]])
def test_the_error_of_too_few_or_infinite_values_is_unknown_everywhere(values: list[float]) -> None:
    moments = Moments()
    moments.add(np.array(values))
    for found in (Estimate.of_mean(np.array(values)), moments.estimate):
        assert np.isnan([found.standard_error, *found.interval(), found.at_most()]).all()
        assert not found.is_positive()
        assert not found.is_negative()


@pytest.mark.parametrize("confidence", [0.95, 0.99])
def test_the_limits_are_students(confidence: float) -> None:
    found = Estimate.of_mean(VALUES)
    test = stats.ttest_1samp(VALUES, 0.0)
    assert found.interval(confidence) == pytest.approx([*test.confidence_interval(confidence)])
    one_sided = stats.ttest_1samp(VALUES, 0.0, alternative="less").confidence_interval(confidence)
    assert found.at_most(confidence) == pytest.approx(one_sided.high, rel=1e-12)
    normal = Estimate(1.0, 2.0).interval(confidence)
    assert normal == pytest.approx(stats.norm.interval(confidence, 1.0, 2.0), rel=1e-14)


def test_an_exact_value_is_its_own_interval() -> None:
    assert Estimate(3.0).at_most() == 3.0
    assert Estimate(3.0).interval() == (3.0, 3.0)


def test_independent_estimates_add_their_variances_and_a_multiple_has_a_positive_error() -> None:
    assert Estimate(1.0, 3.0, 19).plus(Estimate(2.0, 4.0)) == Estimate(3.0, 5.0, 19)
    assert Estimate(1.0, 3.0, 19).times(-2.0) == Estimate(-2.0, 6.0, 19)


def test_clearly_is_more_than_four_standard_errors() -> None:
    assert Estimate(4.1, 1.0).is_positive()
    assert not Estimate(3.9, 1.0).is_positive()
    assert Estimate(-4.1, 1.0).is_negative()
    assert not Estimate(-3.9, 1.0).is_negative()
    assert Estimate(1.1, 1.0).is_positive(errors=1.0)


@pytest.mark.parametrize(("successes", "count"), [(0, 5), (5, 5), (3, 10), (812, 1000), (0, 1)])
def test_the_interval_of_a_share_is_that_of_scipy(successes: int, count: int) -> None:
    known = stats.binomtest(successes, count).proportion_ci(0.95, method="wilson")
    assert wilson_interval(successes, count) == pytest.approx((known.low, known.high), abs=1e-14)


@pytest.mark.parametrize("degrees", [1, 2, 19, 999, math.inf])
def test_the_quantiles_are_those_of_scipy(degrees: float) -> None:
    assert student_quantile(0.975, degrees) == pytest.approx(stats.t.ppf(0.975, degrees), rel=1e-14)
